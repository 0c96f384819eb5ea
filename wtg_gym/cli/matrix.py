"""`wtg-gym results matrix`: entries played on every suite of a version, and with other sensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from wtg_gym.cli import scoring
from wtg_gym.cli.options import Entries, Json, SuiteName, SuiteNames, Threads, Whole, WorkerOptions
from wtg_gym.cli.output import check_output_folder, check_page, note, print_json, print_table, say, update_page
from wtg_gym.cli.stored import stored_or_played
from wtg_gym.evaluation.matrix import PERTURBATIONS, matrix_of, score_text, suites_of, worst_text
from wtg_gym.policies.entry import check_version
from wtg_gym.policies.names import BASELINES
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import V1

#: Where `--page` puts the tables.
_SECTION = "matrix"


def matrix(
    *,
    entries: Entries = (BASELINES,),
    suites: SuiteNames = (),
    perturb: SuiteName = "standard-v1",
    split: Literal["validation", "test"] = "test",
    scenarios: Whole | None = None,
    results: Path = Path("results"),
    page: Path | None = None,
    threads: Threads = None,
    json: Json = False,
    workers: WorkerOptions = WorkerOptions(),
) -> int:
    """Play entries on every suite of a version, and on one of them with other sensors; show the scores side by side.

    The sensors are changed to be one and two control steps (0.1 s each) later, and to have twice the constant error of
    the wind. Prints the scores and the mean pinned cost of the worst tenth of the scenarios, one column for each set of
    scenarios. The laws that score 0 and 100 see no sensors, so that the scale remains that of the suite.

    Results are stored as by 'wtg-gym leaderboard' and used again; those with changed sensors lie in folders of their
    own there. 'wtg-gym results page' shows all of them as one table.

    examples:
      wtg-gym results matrix --entries baselines --split validation --scenarios 50 --results my_results
      wtg-gym results matrix --entries baselines policies --page docs/benchmark.md
      wtg-gym results matrix --suites standard-v1 gusty-v1 --json

    Args:
        suites: suites of one version with sensors; default: all of v1
        perturb: suite that is also played with changed sensors, where it is among the suites
        split: which seeds of each suite
        scenarios: the first so many of each suite's split; default: all
        results: folder of the results; made if missing
        page: Markdown file with the markers <!-- matrix:start --> and <!-- matrix:end --> for the tables
    """
    if page is not None:
        check_page("--page", page, _SECTION)
    check_output_folder("--results", results)
    names = suites or tuple(suites_of(V1.version))
    benchmark = get_suite(names[0]).benchmark
    if any(get_suite(name).benchmark is not benchmark for name in names):
        raise ValueError(f"--suites are of two versions of the benchmark: {', '.join(names)}")
    planned = list(_planned(results, names, perturb, split, scenarios))
    for place, each in planned:
        scoring.check_stored(place, each)
    processes = scoring.chosen_workers(workers, threads)
    played, code = [], 0
    with scoring.kept_parts(results) as partial:
        chosen = scoring.chosen_entries(entries, names[0])
        check_version(chosen, benchmark)
        for place, each in planned:
            note(f"{each['suite']} into {place}")
            found, kept = stored_or_played(
                chosen, place, fresh=False, partial=partial, workers=processes, n_threads=threads, **each
            )
            kept.write(place)
            code |= scoring.note_failures(found)
            played.append(found)
    table = matrix_of(played)
    if page is not None:
        update_page(page, {_SECTION: table.page()})
    if json:
        print_json(table.to_dict())
        return code
    say(f"Scores on {table.describe()}", "")
    print_table(table.header(), table.texts(score_text))
    say("", "Mean pinned cost of the worst tenth of the scenarios:", "")
    print_table(table.header(), table.texts(worst_text))
    return code


def _planned(
    folder: Path, suites: Sequence[str], perturb: str, split: str, n: int | None
) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield the folder of the results and the arguments of `evaluate` of each column."""
    for suite in suites:
        # A suite of fixed cases has fewer.
        most = len(get_suite(suite).seeds(split))
        seeds = None if n is None else scoring.first_seeds(suite, split, min(n, most))
        scenarios = {"suite": suite, "split": split, "seeds": seeds}
        yield folder, scenarios
        own = get_suite(suite).sensors
        if suite == perturb and own is not None:
            for name, change in PERTURBATIONS.items():
                yield folder / name, {**scenarios, "sensors": change(own)}
