"""`python -m agents.research.behaviour`: trained policies in figures and tables, and their learning curves."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from agents.command import (
    Parser,
    check_output_folder,
    check_page,
    chosen_entries,
    note,
    require_extra,
    run_command,
    suite_name,
    update_page,
    write_and_say,
)
from agents.research.learning_curves import anchors_of, curves_by_setup, read_csv, read_runs, to_csv
from agents.research.slopes import policy_slopes, slopes_csv, slopes_tables
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.evaluation import Entry
from wtg_gym.evaluation.recording import Recording, one_scenario, pooled, record
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.scenarios import DEFAULT_SUITE, SPLITS, SUITES, get_suite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVES_FILE, SLOPES_FILE = "learning_curves.csv", "slopes.csv"
#: Sections of the page: those that entries fill, and that of the learning curves.
ENTRY_SECTIONS, CURVE_SECTION = ("responses", "runs", "costs", "slopes"), "learning-curves"
_DEFAULT_SCENARIOS, _MOST_SCENARIOS = 50, 10_000

_DESCRIPTION = f"""\
Plays entries and the reference through scenarios of a suite and writes, as figures and tables,

  responses-NAME            k and τ over each observed quantity, beside the reference's
  run-NAME-SCENARIO         the paper's cases and the first scenario over time, beside the reference
  costs                     cost of an episode, term by term
  {SLOPES_FILE}                how k and τ depend on each observation, by linear regression
  learning-curves           validation score against steps and wall time; without --runs from {CURVES_FILE}
                            of the output folder, which --runs writes

Entries of one name and several training seeds are one policy. With --page sections of a Markdown file are renewed,
each between <!-- NAME:start --> and <!-- NAME:end -->: {", ".join((*ENTRY_SECTIONS, CURVE_SECTION))}."""
_EXAMPLES = """\
examples:
  python -m agents.research.behaviour --entries agents/policies/ppo-0 --output docs/agents --page docs/agents.md
  python -m agents.research.behaviour --runs runs/ppo-* --output docs/agents --page docs/agents.md
  python -m agents.research.behaviour --entries agents/policies/ppo-0 mppt --suite gust --output pictures"""


class _Picture(NamedTuple):
    name: str  # of the file, without suffix
    section: str  # of the page
    text: str  # that stands for the figure where it cannot be seen
    figure: Figure
    above: str = ""  # what the page says above it


class _Played(NamedTuple):
    """Scenarios, and the recordings of every entry in them by name, one per training seed; the reference first."""

    scenarios: Sequence[Scenario]
    recordings: Mapping[str, Sequence[Recording]]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.research.behaviour", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--entries", nargs="+", default=[], metavar="ENTRY", help="as for wtg-gym evaluate")
    parser.add_argument("--runs", nargs="+", default=[], metavar="FOLDER", help="folders of training runs")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="folder to write to")
    parser.add_argument("--page", metavar="FILE", help="Markdown file whose sections are renewed")
    parser.add_argument(
        "--suite", type=suite_name, choices=tuple(SUITES), default=DEFAULT_SUITE, help="(default: %(default)s)"
    )
    parser.add_argument("--split", choices=SPLITS, default="test", help="its scenarios")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: 50, or all)")
    return run_command(
        lambda: _behaviour(parser.parse_args(argv)), "what was written is complete; run the same command again"
    )


def _behaviour(given: argparse.Namespace) -> None:
    require_extra("matplotlib", "python -m agents.research.behaviour")
    folder = check_output_folder("--output", given.output)
    csv_file = folder / CURVES_FILE
    if not given.entries and not given.runs and not csv_file.is_file():
        raise ValueError(f"nothing to draw: give --entries or --runs, there is no {csv_file} either")
    # A pattern such as runs/* names logs beside the folders as well.
    runs = [path for path in map(Path, given.runs) if not path.is_file()]
    validations = read_runs(runs) if runs else read_csv(csv_file) if csv_file.is_file() else []
    anchors = anchors_of(validations)
    entries = _entries(given.entries, given.suite) if given.entries else []
    sections = (*(ENTRY_SECTIONS if entries else ()), *((CURVE_SECTION,) if validations else ()))
    page = check_page("--page", given.page, *sections)
    allowed = get_suite(given.suite).seeds(given.split)
    largest = min(len(allowed), _MOST_SCENARIOS)
    n = min(_DEFAULT_SCENARIOS, largest) if given.scenarios is None else given.scenarios
    if not 1 <= n <= largest:
        raise ValueError(f"--scenarios must be 1 … {largest} for {given.suite}/{given.split}, got {n}")
    texts: dict[str, str] = {}
    pictures: list[_Picture] = []
    if runs:
        write_and_say(csv_file, to_csv(validations))
    if entries:
        played = _play(entries, given.suite, given.split, list(allowed[:n]))
        paper = EnvSettings(suite="paper", version=get_suite(given.suite).benchmark.version).suite
        cases = _play(entries, paper, "test", [0, 1])
        policies = list(dict.fromkeys(entry.name for entry in entries if entry.policy is not None))
        pictures += _pictures(policies, played, cases, given.suite, given.split)
        found = {name: policy_slopes(pooled(played.recordings[name])) for name in policies}
        # A policy that never acts has nothing to be explained.
        found = {name: actions for name, actions in found.items() if actions}
        write_and_say(folder / SLOPES_FILE, slopes_csv(found))
        texts["slopes"] = slopes_tables(found)
    from wtg_gym.plotting import plot_learning_curves, save_figure

    if validations:
        curves = plot_learning_curves(curves_by_setup(validations), anchors)
        above = "Validation score: mean over the training seeds, band from the worst to the best."
        pictures.append(_Picture("learning-curves", CURVE_SECTION, "Learning curves", curves, above))
    for picture in pictures:
        save_figure(picture.figure, folder / picture.name, ["svg"])
    note(f"wrote {len(pictures)} figures in {folder}")
    if page is not None:
        where = Path(os.path.relpath(folder.resolve(), page.resolve().parent))
        for section in sections:
            lines = [
                line
                for each in pictures
                if each.section == section
                for line in (each.above, f"![{each.text}]({(where / each.name).as_posix()}.svg)")
                if line
            ]
            texts.setdefault(section, "\n\n".join(lines))
        update_page(page, texts)


def _entries(specs: Sequence[str], suite: str) -> list[Entry]:
    """Return the entries with the reference before them."""
    (reference,) = chosen_entries([REFERENCE_STRATEGY], suite)
    entries = [reference, *(entry for entry in chosen_entries(specs, suite) if entry.name != REFERENCE_STRATEGY)]
    names = list(dict.fromkeys(entry.name for entry in entries))
    slugs = [_slug(name) for name in names]
    alike = [name for name, slug in zip(names, slugs, strict=True) if slugs.count(slug) > 1]
    if alike:
        raise ValueError(f"the names {alike} would give files of one name; they must differ in letters or digits")
    return entries


def _slug(name: str) -> str:
    """Return a name as part of a file name."""
    words = name.lower().replace("τ", "tau").replace("λ", "lambda").replace("ω", "omega")
    return re.sub(r"[^a-z0-9]+", "-", words).strip("-")


def _play(entries: Sequence[Entry], suite: str, split: str, seeds: Sequence[int]) -> _Played:
    note(f"playing {len(entries)} entries in {len(seeds)} scenarios of {suite}")
    settings = EnvSettings(suite=suite, split=split)
    scenarios = get_suite(suite).scenarios(seeds)
    recordings: dict[str, list[Recording]] = {}
    for entry in entries:
        recordings.setdefault(entry.name, []).append(record(entry, settings, scenarios))
    return _Played(scenarios, recordings)


def _pictures(policies: Sequence[str], played: _Played, cases: _Played, suite: str, split: str) -> list[_Picture]:
    from wtg_gym.plotting import plot_costs, plot_responses, plot_runs, strategy_looks

    looks = strategy_looks(list(played.recordings))
    reference = played.recordings[REFERENCE_STRATEGY][0]
    where = f"{len(played.scenarios)} {split} scenarios of `{suite}`"
    overload = EnvSettings(suite=suite).plant().control.overload_limit_pu
    pictures = []
    for name in policies:
        figure = plot_responses(name, pooled(played.recordings[name]), reference, looks)
        pictures.append(_Picture(f"responses-{_slug(name)}", "responses", f"{name}: k and τ", figure, f"**{name}**"))
    for name in list(played.recordings)[1:]:
        seeds = len(played.recordings[name])
        above = f"**{name}**" + (f", {seeds} training seeds" if seeds > 1 else "")
        for group, index in ((cases, 0), (cases, 1), (played, 0)):
            scenario = group.scenarios[index]
            runs = {
                key: [one_scenario(each, index) for each in group.recordings[key]] for key in (REFERENCE_STRATEGY, name)
            }
            file, text = f"run-{_slug(name)}-{_slug(scenario.name)}", f"{name}: {scenario.name}"
            pictures.append(_Picture(file, "runs", text, plot_runs(scenario, runs, looks, overload), above))
            above = ""
    means = {name: pooled(own).cost_terms.mean(axis=0).tolist() for name, own in played.recordings.items()}
    costs = {name: dict(zip(COST_TERMS, values, strict=True)) for name, values in means.items()}
    above = f"Means of {where}:"
    pictures.append(_Picture("costs", "costs", "Cost by term", plot_costs(costs, looks, f"{suite}/{split}"), above))
    return pictures


if __name__ == "__main__":
    sys.exit(main())
