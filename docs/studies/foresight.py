"""`python docs/studies/foresight.py`: the oracle of a suite, every scenario searched on its own with foresight."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cma
import evolution
import numpy as np
import rollouts
from evolution import N_KNOTS, POPULATION, Search, add_search_options, search_of, search_with_foresight
from rollouts import difference_percent

from agents.command import Parser, Progress, check_output_folder, note, print_table, run_command, say
from wtg_gym.envs.observation import N_LOCAL, N_MEASURED
from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.evaluation import Entry, evaluate, load_entries
from wtg_gym.evaluation.oracle import OracleCosts
from wtg_gym.files import read_json, sha256, to_json, write_atomically
from wtg_gym.scenarios import get_suite

Costs = tuple[float, ...]

_DESCRIPTION = """\
Searches the cheapest course of actions (knots, linear in between) for each scenario, with full knowledge of it. With
--gains it also searches a course on top of a linear feedback, whose gains it may change. The oracle's cost of a
scenario is the least of these, of the reference's, and of the given entries'. It is no bound: a longer search may find
a lower cost.

Written are <suite>-<split>.csv with a row per scenario, and <suite>-<split>.json with suite, settings and search. The
leaderboard's share of the gap that an entry closes comes from such files in wtg_gym/evaluation/oracle_costs.

Finished searches are kept in the folder --parts, chunk by chunk. After an interruption the same command continues, and
on the same machine writes the same files as without one. A command with more scenarios or entries searches only those
that are missing. A change of the physics, the cost or the search makes the parts stale."""
_EXAMPLES = """\
examples:
  python docs/studies/foresight.py --split validation --scenarios 24 --output results
  python docs/studies/foresight.py --gains docs/studies/linear_feedback_gains.json \\
      --entries policies --output wtg_gym/evaluation/oracle_costs"""


def read_gains(path: Path, action_mode: str, suite: str) -> list[list[float]]:
    """Return the gains (n_action, n_local + 1) in a file that :mod:`linear` wrote.

    Raises:
        ValueError: the file cannot be read, or its gains are not those of this action mode and suite.
    """
    data = read_json(path, "gains")
    n_local = N_MEASURED if get_suite(suite).benchmark.sensed else N_LOCAL
    shape = sum(ACTION_MODES[action_mode]), n_local + 1
    try:
        mode, gains = data["action_mode"], np.array(data["gains"], dtype=np.float64)
    except (TypeError, KeyError, ValueError) as error:
        raise ValueError(f"{path} must hold action_mode and gains, as docs/studies/linear.py writes them") from error
    if mode != action_mode or gains.shape != shape or not np.isfinite(gains).all():
        raise ValueError(
            f"{path} must hold finite gains of shape {shape} for the action mode {action_mode!r}, "
            f"got shape {gains.shape} for {mode!r}"
        )
    found: list[list[float]] = gains.tolist()
    return found


@dataclass(frozen=True)
class _Chunk:
    """Scenarios that are searched side by side in one form, and the file that keeps their costs."""

    form: str
    gains: list[list[float]] | None
    seeds: list[int]
    path: Path

    def load(self) -> Costs | None:
        """Return the stored costs; None where there are none, or they are damaged and have to be searched again."""
        try:
            data = read_json(self.path, "finished chunk")
            costs = tuple(float(cost) for cost in data["costs"])
            intact = sha256(to_json(data["costs"]).encode()) == data["sha256"] and len(costs) == len(self.seeds)
            return costs if intact and np.isfinite(costs).all() else None
        except (ValueError, KeyError, TypeError, OverflowError):
            return None

    def save(self, costs: Costs) -> None:
        """Store costs."""
        write_atomically(self.path, to_json({"costs": list(costs), "sha256": sha256(to_json(list(costs)).encode())}))


def find_oracle(
    search: Search,
    entries: Sequence[Entry],
    parts: Path,
    *,
    gains: list[list[float]] | None = None,
    chunk: int = 25,
    n_threads: int | None = None,
) -> OracleCosts:
    """Search every scenario, going on from the chunks that are finished.

    Args:
        entries: known policies; one that is cheaper on a scenario than all that was found counts there.
        parts: folder of the finished chunks; they stay there.
        gains: of a linear feedback to search on top of as well, (n_action, n_local + 1); None: without.
        chunk: scenarios that are searched side by side, and kept together.

    Raises:
        ValueError: `chunk` is out of range, entries have the same name, or one does not fit the environment.
    """
    if not 1 <= chunk <= 1000:
        raise ValueError(f"--chunk = {chunk} is outside the allowed range 1 … 1000")
    seeds = search.scenario_seeds
    with Progress("episodes") as progress:
        results = evaluate(
            entries, search.suite, search.split, seeds=seeds, n_threads=n_threads, on_progress=progress.update
        )
    effort = _effort(search)
    code = b"".join(Path(str(module.__file__)).read_bytes() for module in (evolution, rollouts))
    suite = [results.suite, results.split, results.suite_hash, results.source_hash]
    context = [suite, dict(results.settings), effort, sha256(code)]
    forms = {"course": None} if gains is None else {"course": None, "course_and_feedback": gains}
    chunks = [
        _Chunk(form, start, own, _part(parts, [context, start, own]))
        for own in (seeds[first : first + chunk] for first in range(0, len(seeds), chunk))
        for form, start in forms.items()
    ]
    costs = results.pinned_costs
    found = _searched(search, chunks, n_threads)
    if entries:
        tried = np.concatenate([costs[entry.name] for entry in entries])
        found["entries"] = tuple(tried.min(axis=0).tolist())
    return OracleCosts(
        suite=search.suite,
        split=search.split,
        suite_hash=results.suite_hash,
        source_hash=results.source_hash,
        settings=results.settings,
        search={**effort, "chunk": chunk, "gains": gains},
        entries=[{key: entry.to_dict()[key] for key in ("name", "training_seed", "sha256")} for entry in entries],
        seeds=tuple(seeds),
        reference=tuple(costs[results.benchmark.hundred][0].tolist()),
        found=found,
    )


def _effort(search: Search) -> dict[str, Any]:
    return {
        "action_mode": search.action_mode,
        "generations": search.generations,
        "population": POPULATION,
        "knots": N_KNOTS,
        "seed": search.seed,
        "versions": {"cma": str(cma.__version__), "numpy": np.__version__},
    }


def _part(folder: Path, key: Any) -> Path:
    """Return the file of a chunk, whose name follows from everything that its costs depend on."""
    path = folder / f"{sha256(to_json(key).encode())}.json"
    if path.exists() and not path.is_file():
        raise ValueError(f"{path} must be the file of a finished chunk, it is something else; remove it")
    return path


def _searched(search: Search, chunks: Sequence[_Chunk], n_threads: int | None) -> dict[str, Costs]:
    """The costs that every form found, searched or stored."""
    stored = [chunk.load() for chunk in chunks]
    n_all = sum(len(chunk.seeds) for chunk in chunks)
    n_missing = sum(len(chunk.seeds) for chunk, costs in zip(chunks, stored, strict=True) if costs is None)
    if n_missing < n_all:
        note(f"{n_all - n_missing} searches are stored, {n_missing} are left")
    by_form: dict[str, Costs] = {}
    done = 0
    # Only what is left counts, so that the remaining time is that of this run's own pace.
    with Progress("searches") as progress:
        for chunk, costs in zip(chunks, stored, strict=True):
            if costs is None:
                n = len(chunk.seeds)

                def tell(generation: int, cost: float, chunk: _Chunk = chunk, done: int = done, n: int = n) -> None:
                    name = f"seeds {chunk.seeds[0]} … {chunk.seeds[-1]}, {chunk.form}, mean cost {cost:.2f}"
                    progress.update(name, done + n * generation / search.generations, n_missing)

                start = None if chunk.gains is None else np.array(chunk.gains)
                with closing(search.rollouts(chunk.seeds, n_threads)) as played:
                    least = search_with_foresight(played, chunk.seeds, start, search.generations, tell, search.seed)
                costs = tuple(least.tolist())
                chunk.save(costs)
                done += n
            by_form[chunk.form] = by_form.get(chunk.form, ()) + costs
    return by_form


def _print(costs: OracleCosts) -> None:
    """Print mean costs, and in how many scenarios nothing was cheaper; the reference first, the oracle last."""
    columns: Mapping[str, Sequence[float]] = {"reference": costs.reference, **costs.found, "oracle": costs.oracle}
    reference = float(np.mean(costs.reference))
    say(f"suite {costs.suite} ({costs.suite_hash[:12]}), {costs.split}: {len(costs.seeds)} scenarios", "")
    rows: list[tuple[str, ...]] = []
    for name, values in columns.items():
        mean, cheapest = float(np.mean(values)), int(np.sum(np.array(values) <= np.array(costs.oracle)))
        rows.append((name.replace("_", " "), f"{mean:.2f}", difference_percent(mean, reference), str(cheapest)))
    print_table(("costs", "mean", "difference [%]", "cheapest in"), rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python docs/studies/foresight.py", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--output", required=True, metavar="FOLDER", help="folder of the result; made if missing")
    parser.add_argument("--split", choices=("validation", "test"), default="test", help="(default: test)")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: all)")
    parser.add_argument("--gains", metavar="FILE", help="a file of docs/studies/linear.py: search on top of it as well")
    parser.add_argument(
        "--entries", nargs="+", default=[], metavar="SPEC", help="policies that the oracle must not be worse than"
    )
    parser.add_argument(
        "--chunk", type=int, default=25, metavar="N", help="scenarios searched and kept together (default: 25)"
    )
    default_parts = "results/oracle-parts"
    parser.add_argument(
        "--parts", default=default_parts, metavar="FOLDER", help=f"for finished chunks (default: {default_parts})"
    )
    add_search_options(parser)

    def work() -> None:
        given = parser.parse_args(argv)
        output = check_output_folder("--output", given.output)
        parts = check_output_folder("--parts", given.parts)
        search = search_of(given, given.split)
        gains = None if given.gains is None else read_gains(Path(given.gains), given.action_mode, given.suite)
        benchmark = get_suite(given.suite).benchmark
        entries = [entry for spec in given.entries for entry in load_entries(spec, benchmark=benchmark)]
        costs = find_oracle(search, entries, parts, gains=gains, chunk=given.chunk, n_threads=given.threads)
        for path in costs.write(output):
            note(f"wrote {path}")
        _print(costs)

    return run_command(work, "the same command goes on from the searches that are finished")


if __name__ == "__main__":
    sys.exit(main())
