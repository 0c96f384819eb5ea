"""The oracle of docs/benchmark.md: the lowest cost known for each scenario, found with foresight.

For each scenario CMA-ES searches a course of actions, by itself and on top of a linear feedback whose gains it may
change; the oracle is the cheapest of these and of known entries. It is no bound: a longer search may find less.
Finished chunks stay in a folder, from where the next call goes on. `conditions.py` calls it for v1.

The figures of v0 were found by the same search: `find_oracle` with the 200 test scenarios of standard, 100
generations, and every entry of v0.
"""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cma
import numpy as np
import rollouts
from rollouts import Rollouts, course, linear_feedback, time_left

from agents import evolution
from agents.evolution import Search
from wtg_gym.evaluation import Results, load_entries
from wtg_gym.files import sha256, to_json, write_atomically
from wtg_gym.physics.layout import Floats
from wtg_gym.progress import Progress

#: Candidates per generation, knots per action, and scenarios that are searched side by side.
POPULATION, N_KNOTS, CHUNK = 24, 16, 15


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Scenarios and length of the search."""

    suite: str
    split: str
    strategy: str  # law that the actions modulate
    feedback: str = "agents/policies/linear-feedback-v1"  # to search on top of; without it from zero gains on
    generations: int = 100
    seed: int = 0


def gains_of(folder: str, n_action: int, n_local: int) -> Floats:
    """Return the gains (n_action, n_local + 1) of the linear feedback in a folder of agents/policies."""
    if not Path(folder).is_dir():
        return np.zeros((n_action, n_local + 1))
    (entry,) = load_entries(folder)
    # One number of the first group's observation after the other, so small that no action is clipped.
    seen = np.zeros((n_local + 1, entry.policy.widths[0]), dtype=np.float32)
    np.fill_diagonal(seen[1:], 0.01)
    answers = entry.policy.predict(seen)[0][:, :n_action].astype(np.float64)
    return np.hstack([(answers[1:] - answers[0]).T / 0.01, answers[0][:, None]])


def searched(effort: Effort, seeds: list[int], with_feedback: bool) -> list[float]:
    """Return the smallest pinned cost found for each of some scenarios, searched side by side."""
    with (
        closing(Rollouts(effort.suite, effort.split, seeds, POPULATION, strategy=effort.strategy)) as many,
        closing(many.with_candidates(1)) as alone,
        Progress("generations") as progress,
    ):
        knots = N_KNOTS, many.n_wtg, many.n_action
        n_course = int(np.prod(knots))
        gains = gains_of(effort.feedback, many.n_action, many.n_local)
        start = np.concatenate([np.zeros(n_course), gains.ravel()]) if with_feedback else np.zeros(n_course)
        # Every scenario's search draws from a generator of its own.
        searches = [Search(start, 0.3, POPULATION, effort.seed, seed, int(with_feedback)) for seed in seeds]

        def played(on: Rollouts, asked: Floats) -> Floats:
            act = course(asked[..., :n_course].reshape(*asked.shape[:2], *knots), on.n_steps)
            if not with_feedback:
                return on.play(act)
            fed_back = linear_feedback(asked[..., n_course:].reshape(*asked.shape[:2], *gains.shape))
            return on.play(lambda step, own: act(step, own) + fed_back(step, own))

        best = np.full(len(seeds), np.inf)
        for generation in range(effort.generations):
            asked = np.array([search.ask() for search in searches])
            terms = played(many, asked)
            told = terms.sum(axis=-1) + time_left(many.lanes).reshape(many.shape)
            for search, candidates, cost in zip(searches, asked, told, strict=True):
                search.tell(candidates, cost)
            best = np.minimum(best, many.pinned(terms).min(axis=1))
            progress.update(f"mean pinned cost {best.mean():.2f}", generation + 1, effort.generations)
        means = np.array([[search.mean] for search in searches])
        return np.minimum(best, alone.pinned(played(alone, means))[:, 0]).tolist()


def _hashes(effort: Effort) -> list[str]:
    """Return the hashes of what the search follows from beside the package: its own files and the feedback's."""
    paths = [*(Path(module.__file__) for module in (rollouts, evolution)), Path(__file__)]
    return [sha256(path.read_bytes()) for path in (*paths, *sorted(Path(effort.feedback).glob("*.onnx")))]


def find_oracle(effort: Effort, known: Results, parts: Path) -> dict[str, Any]:
    """Search every scenario of known results, going on from the chunks that are finished, which stay in `parts`.

    Returns:
        JSON-ready data: how the search was made, and for each of the "seeds" the pinned costs of the cheapest of each
        form and of the known "entries", and of the "oracle", the least of them all.
    """
    seeds = list(known.seeds)
    versions = {"cma": str(cma.__version__), "numpy": np.__version__}
    search = {
        **asdict(effort),
        "population": POPULATION,
        "knots": N_KNOTS,
        "versions": versions,
        "files": _hashes(effort),
    }
    found = {"entries": np.concatenate(list(known.pinned_costs.values())).min(axis=0).tolist()}
    for form in ("course", "course_and_feedback"):
        found[form] = []
        for first in range(0, len(seeds), CHUNK):
            own = seeds[first : first + CHUNK]
            # Its name follows from everything that the costs depend on.
            part = parts / f"{sha256(to_json([search, form, own, known.suite_hash, known.source_hash]).encode())}.json"
            if not part.exists():
                write_atomically(part, to_json(searched(effort, own, form != "course")))
            found[form] += json.loads(part.read_text())
    return {
        "suite_hash": known.suite_hash,
        "source_hash": known.source_hash,
        "settings": dict(known.settings),
        "search": search,
        "tried": [{key: entry[key] for key in ("name", "training_seed", "sha256")} for entry in known.entries],
        "seeds": seeds,
        **found,
        "oracle": np.min(list(found.values()), axis=0).tolist(),
    }
