"""`wtg-gym report`: one page about one entry."""

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from wtg_gym.cli.options import OutputFolder, PageFile, SeedOptions, Threads, Whole
from wtg_gym.cli.output import note, require_extra


def report(
    entry: str,
    /,
    *,
    output: PageFile = Path("report.html"),
    split: Literal["train", "validation", "test"] = "validation",
    scenarios: Whole | None = None,
    seed: Annotated[tuple[Whole, ...], Parameter(consume_multiple=1, negative="")] = (),
    results: OutputFolder = Path("results"),
    threads: Threads = None,
) -> int:
    """Write one page about one entry of version v1: what it does, where it fails, and why.

    The page has the score by stratum, cost over the reserve margin, bad runs against the reference at 100, the worst
    scenarios drawn, grid operators' tests, faults of sensors, energy, and the damping of the grid with the entry in the
    loop. HTML holds its pictures and loads nothing; Markdown, for a pull request, has them beside. Scores are read from
    stored results of the same policy, or played on scenarios of standard-v1.

    examples:
      wtg-gym report coordinated-tuned
      wtg-gym report my-policy --output my-policy.md
      wtg-gym report fast-droop --scenarios 30 --seed 10003 10017      a quick look, with two scenarios of your choice

    Args:
        entry: an entry, as for 'wtg-gym evaluate'; of several training seeds the first
        output: the page: .html or .md
        split: which seeds of the suite; the split test is for a policy that changes no more
        scenarios: play the first so many; default: all
        seed: scenarios to draw; default: the three that cost most
        results: folder that may have results of 'wtg-gym leaderboard'
    """
    for package in ("matplotlib", "markdown_it"):
        require_extra(package, "wtg-gym report")
    from wtg_gym.cli import scoring
    from wtg_gym.evaluation.evaluator import chosen_seeds, evaluate
    from wtg_gym.files import write_together
    from wtg_gym.plotting import report as page
    from wtg_gym.policies.entry import check_version
    from wtg_gym.progress import Progress
    from wtg_gym.scenarios import get_suite

    seeds = scoring.chosen_scenarios(page.SUITE, split, SeedOptions(scenarios=scenarios))["seeds"]
    drawn = chosen_seeds(page.SUITE, split, seed) if seed else ()
    chosen = scoring.chosen_entries([entry], page.SUITE)
    if len({each.name for each in chosen}) > 1:
        raise ValueError(f"a report is about one entry, {entry!r} are {len(chosen)}")
    check_version(chosen[:1], get_suite(page.SUITE))
    stored = page.stored_results(results, split, chosen[0]) if seeds is None else None
    how: dict[str, Any] = {"seeds": seeds, "n_threads": threads}
    with Progress("episodes") as progress:
        scores = stored or evaluate(chosen[0], page.SUITE, split, **how, on_progress=progress.update)
    made = page.Report(entry=chosen[0], spec=entry, results=scores, stored=bool(stored), drawn=drawn, n_threads=threads)
    files = page.report_files(made, output.stem)
    html = files.pop(f"{output.stem}.html")
    if output.suffix != ".md":
        files = {output.name: html}
    write_together({output.with_name(name): content for name, content in files.items()})
    note(f"wrote {', '.join(str(output.with_name(name)) for name in files)}")
    return 0
