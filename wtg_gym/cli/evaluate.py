"""`wtg-gym evaluate`, `leaderboard` and `results`: entries scored on scenarios of a suite, ranked, and scored again."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter

from wtg_gym.cli import options, output

#: Differences of results that are printed.
_SHOWN = 20

results_app = App(name="results", help="Work with the stored results of 'wtg-gym evaluate' and 'wtg-gym leaderboard'.")


def evaluate(
    *,
    entries: options.Entries = ("baselines",),
    suite: options.Suite = options.DEFAULT_SUITE,
    split: Literal["train", "validation", "test"] = "validation",
    duration: float | None = None,
    results: options.OutputFolder | None = None,
    threads: options.Threads = None,
    json: options.Json = False,
    seeds: options.SeedOptions = options.SeedOptions(),
    workers: options.WorkerOptions = options.WorkerOptions(),
) -> int:
    """Play entries through the scenarios of a suite, many at a time, and score them.

    In version v0 a score of 0 is maximum power point tracking (mppt) and 100 the paper's law (coordinated-piecewise).
    In v1, 0 is the paper's law and 100 the same law tuned to that grid (coordinated-tuned). Both are always played,
    because they fix the scale; in v1 coordinated-free too, whose known mean corrects for the draw. A policy plays in
    the version whose observations it takes. The default split is for choosing policies; 'wtg-gym leaderboard' and
    'wtg-gym submission score' play the test scenarios.

    With --results, every episode is written to <suite>-<split>.csv, description and summary to <suite>-<split>.json,
    and an interrupted evaluation continues from its finished parts. Earlier results of the same scenarios and settings
    are replaced. A folder with results of other settings or seeds is refused.

    An entry fails if its policy raises, ends, takes too long or gives no action, or if its law has no equilibrium in a
    scenario. It is named with the reason and left out with all training seeds of its name. The others are ranked, and
    the exit code is 1. A policy.onnx plays each scenario apart, in an isolated process.

    examples:
      wtg-gym evaluate --entries coordinated-piecewise fast-droop --suite standard-v1 --scenarios 20
      wtg-gym evaluate --entries my_package.controller:make_policy --split test --json
      wtg-gym evaluate --entries policies --backend dask --address tcp://head:8786 --results my_results

    Args:
        split: which seeds of the suite
        duration: length of an episode [s]; default: the suite's
        results: folder to write results to; made if missing
    """
    from wtg_gym.cli import scoring

    processes = scoring.chosen_workers(workers, threads)
    planned = {**scoring.chosen_scenarios(suite, split, seeds), "duration_s": duration}
    scoring.check_stored(results, planned)
    # Last, because it takes longest, and may run code.
    chosen = scoring.chosen_entries(entries, suite)
    scores = scoring.run_evaluation(chosen, results, **planned, n_threads=threads, workers=processes)
    return scoring.finish(scores, results, as_json=json)


def leaderboard(
    *,
    entries: options.Entries = ("baselines",),
    suite: options.Suite = options.DEFAULT_SUITE,
    results: options.OutputFolder = Path("results"),
    readme: Annotated[tuple[Path, ...], Parameter(consume_multiple=1, negative="", show_default=False)] = (),
    threads: options.Threads = None,
    json: options.Json = False,
    workers: options.WorkerOptions = options.WorkerOptions(),
) -> int:
    """Rank entries on all test scenarios of a suite: laws first, then all.

    Episodes are kept in the folder partial beside the results, so that the next call plays only new entries, and those
    whose policy, source code, packages or processor differ. An entry that fails is named with its reason and left out
    with all training seeds of its name; the exit code is then 1. If the entry at 100 is no better than the entry at 0,
    the mean cost ranks.

    examples:
      wtg-gym leaderboard --suite standard --results results --readme README.md
      wtg-gym leaderboard --suite paper --entries mppt my_law.toml coordinated-piecewise --json

    Args:
        results: folder of the results; made if missing
        readme: files to update: the table goes between <!-- leaderboard:SUITE:start --> and
            <!-- leaderboard:SUITE:end -->, a wider one between the same markers of leaderboard:SUITE:details
    """
    from wtg_gym.cli import scoring
    from wtg_gym.evaluation.results import markdown_section
    from wtg_gym.files import update_between_markers
    from wtg_gym.policies import OnnxPolicy
    from wtg_gym.policies.entry import check_version
    from wtg_gym.scenarios import get_suite

    sections = [f"leaderboard:{suite}", f"leaderboard:{suite}:details"]
    pages = [(page, output.check_page("--readme", page, sections)) for page in readme]
    processes = scoring.chosen_workers(workers, threads)
    chosen = scoring.chosen_entries(entries, suite)
    check_version(chosen, get_suite(suite))
    how: dict[str, Any] = {"suite": suite, "split": "test", "n_threads": threads, "workers": processes}
    laws = [entry for entry in chosen if not isinstance(entry.policy, OnnxPolicy)]
    if not json and laws and len(laws) < len(chosen):
        # They take seconds, the others minutes.
        scoring.print_ranking(scoring.run_evaluation(laws, results, **how))
        output.note(f"these are the laws; {len(chosen) - len(laws)} policies follow")
    ranking = scoring.run_evaluation(chosen, results, **how)
    # Without its parts, which would be removed once the results are written.
    code = scoring.finish(dataclasses.replace(ranking, parts=None), results, as_json=json)
    for page, section in pages:
        changed = update_between_markers(page, markdown_section(ranking, details=section == sections[1]), section)
        output.note(f"{page}: {'updated' if changed else 'already up to date'}")
    return code


@results_app.command
def recompute(
    results: Path,
    /,
    *,
    entries: options.Entries = ("baselines",),
    threads: options.Threads = None,
    workers: options.WorkerOptions = options.WorkerOptions(),
) -> int:
    """Compute results again, and say whether they are identical.

    Plays the same scenarios with the same settings, and compares every number of every episode to the last bit, the
    policies' sha256, kinds and laws, and the suite's hash. If anything differs, it is printed, and the exit code is 1.
    Other versions of source code or packages and other texts about an entry are printed but do not count as
    differences: laws give the same bits on one type of processor, a policy's last digits may depend on onnxruntime.
    Scenarios, lengths and weights that are not the benchmark's are printed too.

    examples:
      wtg-gym results recompute results/standard-test.json --entries baselines policies

    Args:
        results: JSON file of results, the CSV beside it
    """
    from wtg_gym.cli import scoring
    from wtg_gym.evaluation import Results, episodes, evaluator
    from wtg_gym.progress import Progress

    stored = Results.read(results)
    processes = scoring.chosen_workers(workers, threads)
    chosen = scoring.chosen_entries(entries, stored.suite)
    with Progress("episodes") as progress:
        comparison = evaluator.recompute(
            stored, chosen, n_threads=threads, workers=processes, on_progress=progress.update
        )
    for where, before, now in comparison.circumstances:
        output.note(f"{where} was {before}, is {now}")
    for text in evaluator.departures(stored):
        output.note(f"not the benchmark's own: {text}")
    if not comparison.differences:
        n_episodes = len(stored.episodes)
        output.say(f"identical: {len(episodes.COLUMNS) * n_episodes} values of {n_episodes} episodes")
        return 0
    shown = comparison.differences[:_SHOWN]
    output.say(f"not identical: {len(comparison.differences)} differences, the first {len(shown)}", "")
    output.print_table(("where", "stored", "now"), shown, left=(0, 1, 2))
    return 1
