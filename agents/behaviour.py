"""`python -m agents.behaviour`: what trained policies do, and how fast they were learned, in figures and tables."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from agents.command import run_command
from agents.curves import curves_by_setup, read_csv, read_runs, to_csv
from agents.slopes import policy_slopes, slopes_csv, slopes_tables
from wtg_gym.cli.output import (
    FIGURE_FORMATS,
    check_output_folder,
    check_page,
    note,
    require_extra,
    update_page,
    write_and_say,
)
from wtg_gym.cli.parser import Parser
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.task import COST_TERMS
from wtg_gym.evaluation import Entry, load_entries
from wtg_gym.evaluation.recording import Recording, one_scenario, pooled, record
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.scenarios import SPLITS, SUITES, get_suite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVES_FILE, SLOPES_FILE = "learning_curves.csv", "slopes.csv"
#: Sections of the page: those that entries fill, and that of the learning curves.
ENTRY_SECTIONS, CURVE_SECTION = ("responses", "runs", "costs", "slopes"), "learning-curves"
_DEFAULT_SCENARIOS = 50

_DESCRIPTION = f"""\
Plays entries and the reference through scenarios of a suite and writes, as figures and tables,

  responses-NAME            k and τ in use over what the policy sees, beside the reference's
  run-NAME-SCENARIO         the paper's cases and a scenario of the suite over time, beside the reference
  costs                     what an episode costs, term by term
  {SLOPES_FILE}                how k and τ depend on each observation, by linear regression
  learning-curves           validation score against steps and wall time, and {CURVES_FILE}, which
                            draws them again when no runs are given

Entries of one name and several training seeds are one policy. With --page sections of a Markdown file are renewed,
each between <!-- NAME:start --> and <!-- NAME:end -->: {", ".join((*ENTRY_SECTIONS, CURVE_SECTION))}."""
_EXAMPLES = """\
examples:
  python -m agents.behaviour --entries agents/policies/ppo-0 --output docs/agents --page docs/agents.md
  python -m agents.behaviour --runs runs/ppo-* --output docs/agents --page docs/agents.md
  python -m agents.behaviour --entries agents/policies/ppo-0 mppt --suite gust --formats png --output pictures"""


@dataclass(frozen=True)
class _Picture:
    """A drawn figure: its file's name without suffix, the section it belongs to, and a caption of one sentence."""

    name: str
    section: str
    caption: str
    figure: Figure


@dataclass(frozen=True)
class _Played:
    """Scenarios, and the recordings of every entry in them by name, one per training seed; the reference first."""

    scenarios: Sequence[Scenario]
    recordings: Mapping[str, Sequence[Recording]]

    def one(self, index: int) -> dict[str, list[Recording]]:
        """Return the recordings of one scenario."""
        return {name: [one_scenario(each, index) for each in own] for name, own in self.recordings.items()}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.behaviour", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--entries", nargs="+", default=[], metavar="ENTRY", help="as for wtg-gym evaluate")
    parser.add_argument("--runs", nargs="+", default=[], metavar="FOLDER", help="folders of training runs")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="folder to write to")
    parser.add_argument("--page", metavar="FILE", help="Markdown file whose sections are renewed")
    parser.add_argument("--suite", choices=tuple(SUITES), default="standard", help="default: standard")
    parser.add_argument("--split", choices=SPLITS, default="test", help="its scenarios")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: 50, or all)")
    parser.add_argument("--show", type=int, metavar="SEED", help="which of them to draw over time (default: the first)")
    parser.add_argument("--formats", nargs="+", choices=FIGURE_FORMATS, default=["svg"], help="default: svg")
    return run_command(
        lambda: _behaviour(parser.parse_args(argv)), "what was written is complete; run the same command again"
    )


def _behaviour(given: argparse.Namespace) -> None:
    require_extra("matplotlib", "python -m agents.behaviour")
    folder = check_output_folder("--output", given.output)
    csv_file = folder / CURVES_FILE
    if not given.entries and not given.runs and not csv_file.is_file():
        raise ValueError(f"nothing to draw: give --entries or --runs, there is no {csv_file} either")
    # A pattern such as runs/* names logs beside the folders as well.
    runs = [path for path in map(Path, given.runs) if not path.is_file()]
    validations = read_runs(runs) if runs else read_csv(csv_file) if csv_file.is_file() else []
    entries = _entries(given.entries) if given.entries else []
    sections = (*(ENTRY_SECTIONS if entries else ()), *((CURVE_SECTION,) if validations else ()))
    page = check_page("--page", given.page, *sections)
    seeds = _seeds(given)
    texts: dict[str, str] = {}
    pictures: list[_Picture] = []
    if runs:
        write_and_say(csv_file, to_csv(validations))
    if entries:
        played, cases = _play(entries, given.suite, given.split, seeds), _play(entries, "paper", "test", [0, 1])
        pictures += _pictures(entries, played, cases, given)
        learned = dict.fromkeys(entry.name for entry in entries if entry.policy is not None)
        found = {name: policy_slopes(pooled(played.recordings[name])) for name in learned}
        # A policy that never acts has nothing to be explained.
        found = {name: actions for name, actions in found.items() if actions}
        write_and_say(folder / SLOPES_FILE, slopes_csv(found))
        texts["slopes"] = slopes_tables(found)
    if validations:
        from wtg_gym.plotting import plot_learning_curves

        caption = (
            "Validation score against environment steps and wall time: mean over the training seeds, band from the "
            "worst to the best."
        )
        curves = plot_learning_curves(curves_by_setup(validations))
        pictures.append(_Picture("learning-curves", CURVE_SECTION, caption, curves))
    _write(pictures, folder, given.formats)
    if page is not None:
        update_page(page, {**texts, **_galleries(pictures, sections, folder, page, given.formats)})


def _entries(specs: Sequence[str]) -> list[Entry]:
    """Return the entries with the reference before them."""
    reference = load_entries(REFERENCE_STRATEGY)[0]
    found = [entry for spec in specs for entry in load_entries(spec)]
    for entry in found:
        if entry.name == REFERENCE_STRATEGY and entry.identity != reference.identity:
            raise ValueError(f"the name {entry.name!r} is reserved for the strategy itself")
    entries = [reference, *(entry for entry in found if entry.name != REFERENCE_STRATEGY)]
    labels = [entry.label for entry in entries]
    doubled = sorted({label for label in labels if labels.count(label) > 1})
    if doubled:
        raise ValueError(f"entries must have different names or training seeds; given more than once: {doubled}")
    names = dict.fromkeys(entry.name for entry in entries)
    slugs = [_slug(name) for name in names]
    alike = [name for name, slug in zip(names, slugs, strict=True) if slugs.count(slug) > 1]
    if alike:
        raise ValueError(f"the names {alike} would give files of one name; they must differ in letters or digits")
    return entries


def _slug(name: str) -> str:
    """Return a name as part of a file name."""
    words = name.lower().replace("τ", "tau").replace("λ", "lambda").replace("ω", "omega")
    return re.sub(r"[^a-z0-9]+", "-", words).strip("-")


def _seeds(given: argparse.Namespace) -> list[int]:
    """Return the seeds of the scenarios to play, the one to draw over time first."""
    allowed = get_suite(given.suite).seeds(given.split)
    n = min(_DEFAULT_SCENARIOS, len(allowed)) if given.scenarios is None else given.scenarios
    largest = min(len(allowed), 10_000)
    if not 1 <= n <= largest:
        raise ValueError(f"--scenarios must be 1 … {largest} for {given.suite}/{given.split}, got {n}")
    seeds = list(allowed[:n])
    if given.show is not None and given.show not in seeds:
        raise ValueError(f"--show must be one of the seeds played, {seeds[0]} … {seeds[-1]}, got {given.show}")
    return seeds


def _play(entries: Sequence[Entry], suite: str, split: str, seeds: Sequence[int]) -> _Played:
    note(f"playing {len(entries)} entries in {len(seeds)} scenarios of {suite}")
    settings = EnvSettings(suite=suite, split=split)
    scenarios = get_suite(suite).scenarios(seeds)
    recordings: dict[str, list[Recording]] = {}
    for entry in entries:
        recordings.setdefault(entry.name, []).append(record(entry, settings, scenarios))
    return _Played(scenarios, recordings)


def _pictures(entries: Sequence[Entry], played: _Played, cases: _Played, given: argparse.Namespace) -> list[_Picture]:
    from wtg_gym.plotting import plot_costs, plot_responses, plot_runs, strategy_looks

    names = list(played.recordings)
    looks = strategy_looks(names)
    reference = played.recordings[REFERENCE_STRATEGY][0]
    where = f"{len(played.scenarios)} {given.split} scenarios of `{given.suite}`"
    pictures = []
    for name in dict.fromkeys(entry.name for entry in entries if entry.policy is not None):
        pictures.append(
            _Picture(
                f"responses-{_slug(name)}",
                "responses",
                f"{name} and the reference in {where}.",
                plot_responses(name, pooled(played.recordings[name]), reference, looks),
            )
        )
    shown = 0 if given.show is None else [scenario.seed for scenario in played.scenarios].index(given.show)
    for name in names:
        if name == REFERENCE_STRATEGY:
            continue
        for group, index in ((cases, 0), (cases, 1), (played, shown)):
            scenario = group.scenarios[index]
            runs = {key: own for key, own in group.one(index).items() if key in (REFERENCE_STRATEGY, name)}
            seeds = f", {len(runs[name])} training seeds" if len(runs[name]) > 1 else ""
            pictures.append(
                _Picture(
                    f"run-{_slug(name)}-{_slug(scenario.name)}",
                    "runs",
                    f"{name}{seeds} and the reference in `{scenario.name}`.",
                    plot_runs(scenario, runs, looks),
                )
            )
    means = {name: pooled(own).cost_terms.mean(axis=0).tolist() for name, own in played.recordings.items()}
    costs = {name: dict(zip(COST_TERMS, values, strict=True)) for name, values in means.items()}
    caption = f"Mean cost of an episode, total and term by term, in {where}."
    pictures.append(_Picture("costs", "costs", caption, plot_costs(costs, looks, f"{given.suite}/{given.split}")))
    return pictures


def _write(pictures: Sequence[_Picture], folder: Path, formats: Sequence[str]) -> None:
    from wtg_gym.plotting import save_figure

    for picture in pictures:
        save_figure(picture.figure, folder / picture.name, formats)
    note(f"wrote {len(pictures)} figures in {folder}")


def _galleries(
    pictures: Sequence[_Picture], sections: Sequence[str], folder: Path, page: Path, formats: Sequence[str]
) -> dict[str, str]:
    """Return the pictures of each section, with their captions, as Markdown."""
    suffix = "png" if "png" in formats else formats[0]
    where = Path(os.path.relpath(folder.resolve(), page.resolve().parent))
    return {
        section: "\n\n".join(
            f"![{picture.name}]({(where / picture.name).as_posix()}.{suffix})\n\n{picture.caption}"
            for picture in pictures
            if picture.section == section
        )
        for section in sections
        if section != "slopes"
    }


if __name__ == "__main__":
    sys.exit(main())
