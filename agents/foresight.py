"""The oracle of a suite: every scenario searched with foresight, in chunks that are kept as they are finished."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cma
import numpy as np
import numpy.typing as npt

from agents import evolution, rollouts
from agents.evolution import N_KNOTS, POPULATION, search_with_foresight
from agents.rollouts import Rollouts
from wtg_gym.cli.output import Progress, note
from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.envs.task import N_LOCAL
from wtg_gym.evaluation import ANCHORS, Entry, Results, evaluate
from wtg_gym.evaluation.oracle import OracleCosts
from wtg_gym.files import read_json, sha256, to_json, write_atomically
from wtg_gym.scenarios import get_suite

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Search:
    """What is searched, and how.

    Args:
        suite, split: which scenarios.
        n_scenarios: how many of them, the first ones; None for all.
        action_mode: what the actions modulate.
        generations: of every scenario's search.
        chunk: scenarios that are searched side by side, and kept together.
        seed: of the searches.
        gains: of a linear feedback to search on top of as well, (n_action, N_LOCAL + 1); None: without.

    Raises:
        ValueError: a value is unknown or out of range.
    """

    suite: str = "standard"
    split: str = "test"
    n_scenarios: int | None = None
    action_mode: str = "k+tau"
    generations: int = 150
    chunk: int = 25
    seed: int = 0
    gains: tuple[tuple[float, ...], ...] | None = None

    def __post_init__(self) -> None:
        n = len(get_suite(self.suite).seeds(self.split))
        limits = {"scenarios": (self.n_scenarios, 1, n), "generations": (self.generations, 1, 100_000)}
        limits |= {"chunk": (self.chunk, 1, 1000), "seed": (self.seed, 0, 2**32 - 1)}
        for name, (value, low, high) in limits.items():
            if value is not None and not low <= value <= high:
                raise ValueError(f"--{name} = {value} is outside the allowed range {low} … {high}")

    @property
    def seeds(self) -> list[int]:
        """Return the seeds of the scenarios."""
        return list(get_suite(self.suite).seeds(self.split)[: self.n_scenarios])

    def to_dict(self) -> dict[str, Any]:
        """Return how the search is made, as JSON-ready data."""
        return {
            "action_mode": self.action_mode,
            "generations": self.generations,
            "population": POPULATION,
            "knots": N_KNOTS,
            "chunk": self.chunk,
            "seed": self.seed,
            "gains": None if self.gains is None else [list(row) for row in self.gains],
            "versions": {"cma": str(cma.__version__), "numpy": np.__version__},
        }


def read_gains(path: Path, action_mode: str) -> tuple[tuple[float, ...], ...]:
    """Return the gains (n_action, N_LOCAL + 1) in a file that `linear` wrote.

    Raises:
        ValueError: the file cannot be read, or its gains are not those of this action mode.
    """
    data = read_json(path, "gains")
    shape = sum(ACTION_MODES[action_mode]), N_LOCAL + 1
    try:
        mode, gains = data["action_mode"], np.array(data["gains"], dtype=np.float64)
    except (TypeError, KeyError, ValueError) as error:
        raise ValueError(f"{path} is no result of `linear`: it must hold action_mode and gains") from error
    if mode != action_mode or gains.shape != shape or not np.isfinite(gains).all():
        raise ValueError(
            f"{path} must hold finite gains of shape {shape} for the action mode {action_mode!r}, "
            f"got shape {gains.shape} for {mode!r}"
        )
    return tuple(tuple(row) for row in gains.tolist())


@cache
def _code_hash() -> str:
    """Another search's results are not this one's."""
    return sha256(b"".join(Path(str(module.__file__)).read_bytes() for module in (evolution, rollouts)))


class _Parts:
    """A folder of finished chunks, one file for each form of search."""

    def __init__(self, folder: Path, search: Search, results: Results) -> None:
        self._folder = folder
        how = {key: value for key, value in search.to_dict().items() if key not in ("chunk", "gains")}
        suite = [results.suite, results.split, results.suite_hash, results.source_hash]
        self._context = [suite, dict(results.settings), how, _code_hash()]

    def path(self, gains: Any, seeds: Sequence[int]) -> Path:
        """Return the file of a chunk."""
        key = to_json([self._context, gains, list(seeds)])
        path = self._folder / f"{sha256(key.encode())}.json"
        if path.exists() and not path.is_file():
            raise ValueError(f"{path} must be the file of a finished chunk, it is something else; remove it")
        return path

    @staticmethod
    def load(path: Path, n_scenarios: int) -> tuple[float, ...] | None:
        """Return a stored chunk's costs; None where there is none, or it is damaged and has to be searched again."""
        try:
            data = read_json(path, "finished chunk")
            costs = tuple(float(cost) for cost in data["costs"])
            intact = sha256(to_json(data["costs"]).encode()) == data["sha256"] and len(costs) == n_scenarios
            return costs if intact and np.isfinite(costs).all() else None
        except (ValueError, KeyError, TypeError, OverflowError):
            return None

    @staticmethod
    def save(path: Path, costs: Sequence[float]) -> None:
        """Store a chunk's costs."""
        write_atomically(path, to_json({"costs": list(costs), "sha256": sha256(to_json(list(costs)).encode())}))


@dataclass(frozen=True)
class _Chunk:
    """A form of search over some scenarios, and the file that it is kept in."""

    form: str
    gains: Floats | None
    seeds: list[int]
    path: Path


def find_oracle(search: Search, entries: Sequence[Entry], parts: Path, n_threads: int | None = None) -> OracleCosts:
    """Search every scenario, going on from what is finished.

    Args:
        search: what and how.
        entries: known policies: one that is cheaper on a scenario than all that was found counts there.
        parts: folder of the finished chunks; they stay there.
        n_threads: threads to step with; None for one per processor.

    Raises:
        ValueError: entries have the same name, or one does not fit the environment.
    """
    seeds = search.seeds
    with Progress("episodes") as progress:
        results = evaluate(
            entries, search.suite, search.split, seeds=seeds, n_threads=n_threads, on_progress=progress.update
        )
    costs = results.pinned_costs
    store = _Parts(parts, search, results)
    found = _searched(search, list(_chunks(search, store)), n_threads)
    if entries:
        tried = np.concatenate([costs[entry.name] for entry in entries])
        found["entries"] = tuple(tried.min(axis=0).tolist())
    return OracleCosts(
        suite=search.suite,
        split=search.split,
        suite_hash=results.suite_hash,
        source_hash=results.source_hash,
        settings=results.settings,
        search=search.to_dict(),
        entries=[{key: entry.to_dict()[key] for key in ("name", "training_seed", "sha256")} for entry in entries],
        seeds=tuple(seeds),
        reference=tuple(costs[ANCHORS[1]][0].tolist()),
        found=found,
    )


def _chunks(search: Search, store: _Parts) -> Iterator[_Chunk]:
    forms: dict[str, Any] = {"course": None}
    if search.gains is not None:
        forms["course_and_feedback"] = [list(row) for row in search.gains]
    for first in range(0, len(search.seeds), search.chunk):
        seeds = search.seeds[first : first + search.chunk]
        for form, gains in forms.items():
            yield _Chunk(form, None if gains is None else np.array(gains), seeds, store.path(gains, seeds))


def _searched(search: Search, chunks: Sequence[_Chunk], n_threads: int | None) -> dict[str, tuple[float, ...]]:
    """The costs that every form found, searched or stored."""
    stored = {chunk.path: _Parts.load(chunk.path, len(chunk.seeds)) for chunk in chunks}
    missing = [chunk for chunk in chunks if stored[chunk.path] is None]
    n_missing = sum(len(chunk.seeds) for chunk in missing)
    if len(missing) < len(chunks):
        note(f"{sum(len(chunk.seeds) for chunk in chunks) - n_missing} searches are stored, {n_missing} are left")
    done = 0
    # Only what is left counts, so that the remaining time is that of this run's own pace.
    with Progress("searches") as progress:
        for chunk in missing:
            n = len(chunk.seeds)

            def tell(generation: int, cost: float, chunk: _Chunk = chunk, done: int = done, n: int = n) -> None:
                name = f"seeds {chunk.seeds[0]} … {chunk.seeds[-1]}, {chunk.form}, mean cost {cost:.2f}"
                progress.update(name, done + n * generation / search.generations, n_missing)

            found = _search_chunk(search, chunk, n_threads, tell)
            _Parts.save(chunk.path, found)
            stored[chunk.path] = found
            done += n
    by_form: dict[str, tuple[float, ...]] = {}
    for chunk in chunks:
        by_form[chunk.form] = by_form.get(chunk.form, ()) + (stored[chunk.path] or ())
    return by_form


def _search_chunk(
    search: Search, chunk: _Chunk, n_threads: int | None, tell: evolution.OnGeneration
) -> tuple[float, ...]:
    played = Rollouts(search.suite, search.split, chunk.seeds, POPULATION, n_threads, action_mode=search.action_mode)
    try:
        costs = search_with_foresight(played, chunk.seeds, chunk.gains, search.generations, tell, search.seed)
    finally:
        played.close()
    return tuple(costs.tolist())


__all__ = ["Search", "find_oracle", "read_gains"]
