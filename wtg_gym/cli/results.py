"""`wtg-gym results`: stored results computed again and compared."""

from pathlib import Path

from cyclopts import App

from wtg_gym.cli import output as out
from wtg_gym.cli.options import Entries, Threads, WorkerOptions

#: Differences that are printed.
_SHOWN = 20

app = App(name="results", help="Work with the stored results of 'wtg-gym evaluate' and 'wtg-gym leaderboard'.")


@app.command
def recompute(
    results: Path,
    /,
    *,
    entries: Entries = ("baselines",),
    threads: Threads = None,
    workers: WorkerOptions = WorkerOptions(),
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
    from wtg_gym.evaluation import Results
    from wtg_gym.evaluation.episodes import COLUMNS
    from wtg_gym.evaluation.recompute import departures
    from wtg_gym.evaluation.recompute import recompute as compute_again
    from wtg_gym.progress import Progress

    stored = Results.read(results)
    processes = scoring.chosen_workers(workers, threads)
    chosen = scoring.chosen_entries(entries, stored.suite)
    with Progress("episodes") as progress:
        comparison = compute_again(stored, chosen, n_threads=threads, workers=processes, on_progress=progress.update)
    for where, before, now in comparison.circumstances:
        out.note(f"{where} was {before}, is {now}")
    for text in departures(stored):
        out.note(f"not the benchmark's own: {text}")
    if not comparison.differences:
        out.say(f"identical: {len(COLUMNS) * len(stored.episodes)} values of {len(stored.episodes)} episodes")
        return 0
    shown = comparison.differences[:_SHOWN]
    out.say(f"not identical: {len(comparison.differences)} differences, the first {len(shown)}", "")
    out.print_table(("where", "stored", "now"), shown, left=(0, 1, 2))
    return 1
