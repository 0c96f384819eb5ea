"""`wtg-gym submission new`, `check` and `score`: policies of others, which are only data."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter, validators

from wtg_gym.cli.options import Flag, Json, OutputFolder, SeedOptions, Threads, Words
from wtg_gym.cli.output import note, print_json, print_table, require_extra, say

if TYPE_CHECKING:
    from wtg_gym.evaluation import Entry, Results
    from wtg_gym.policies.gate import Conflict, Report

Folders = tuple[Annotated[Path, Parameter(validator=validators.Path(exists=True))], ...]

app = App(
    name="submission",
    help="""\
Policies of others: write a template, check folders, score them in isolation.

A submission is a folder with entry.toml and policy.onnx, and a README.md if you like. Nothing in it is run but the
network in policy.onnx, with all weights in it. onnxruntime plays each scenario apart, in a process that can only
compute and answer, here and wherever it is played later. Random numbers start alike in every scenario.""",
)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GateOptions:
    """How folders are checked."""

    beside: Words = ()
    """entries that are there already, to compare names and files with; those given as FOLDERS are left out"""
    weak_isolation: Flag = False
    """go on where this system cannot isolate a process; only for policies of people you trust"""


@app.command
def new(folder: OutputFolder, /) -> int:
    """Write an entry.toml with comments to fill in; policy.onnx belongs beside it.

    `python -m agents.export` writes both files for a run of `python -m agents.train`.

    examples:
      wtg-gym submission new my-policy

    Args:
        folder: where to write; made if missing
    """
    from wtg_gym.policies.entry_folder import write_template

    note(f"wrote {write_template(folder)}")
    return 0


@app.command
def check(folders: Folders, /, *, gate: GateOptions = GateOptions(), json: Json = False) -> int:
    """Run every check on folders, and print its verdict and reason; exits with 1 if a folder is refused.

    Several folders are checked together, and with --beside against existing entries: a name belongs to one entry, whose
    training seeds are submitted together, and no file is submitted twice.

    examples:
      wtg-gym submission check my-policy-* --beside agents/policies/*

    Args:
        folders: folders with entry.toml, policy.onnx and, if there is one, README.md
    """
    reports, clashes = _judged(folders, gate)
    if json:
        together = [conflict.reason for conflict in clashes]
        print_json({"submissions": [report.to_dict() for report in reports], "together": together})
    else:
        for report in reports:
            name, checks = _shown(report.folder), [(step.name, step.verdict, step.reason) for step in report.checks]
            print_table((name, "verdict", "reason"), checks, left=(0, 1, 2))
            say(f"{name}: {f'accepted, sha256 {report.sha256}' if report.accepted else 'refused'}", "")
        for conflict in clashes:
            say(f"refused: {conflict.reason}")
    return int(bool(clashes) or not all(report.accepted for report in reports))


@app.command
def score(
    folders: Folders,
    /,
    *,
    gate: GateOptions = GateOptions(),
    split: Literal["train", "validation", "test"] = "test",
    results: OutputFolder | None = None,
    cards: OutputFolder | None = None,
    threads: Threads = None,
    json: Json = False,
    seeds: SeedOptions = SeedOptions(),
) -> int:
    """Check folders, then play them in isolation and rank them.

    Checks submissions, plays each on the standard suite of the version that it is for, and prints their rows of the
    leaderboard with those of both reference laws. A submission that is refused, crashes, takes too long or gives no
    action is named with its reason and left out with all folders of its name. The others are ranked, and the exit code
    is 1. The policy runs in a process of its own that only gets observations and returns actions; docs/submissions.md
    lists its limits. With --results, an interrupted command continues from its finished parts. 'wtg-gym evaluate' plays
    other suites.

    examples:
      wtg-gym submission score my-policy
      wtg-gym submission score my-policy-* --split validation --results my_results
      wtg-gym submission score my-policy --cards my_cards

    Args:
        folders: folders with entry.toml, policy.onnx and, if there is one, README.md
        split: which seeds of the suite
        results: folder to write results to; made if missing
        cards: folder for a page in HTML and Markdown on each entry of v1, as of 'wtg-gym report'; made if missing
    """
    from wtg_gym.cli import scoring
    from wtg_gym.scenarios import get_suite

    for package in ("matplotlib", "markdown_it") if cards is not None else ():
        require_extra(package, "--cards")
    planned = {suite: scoring.chosen_scenarios(suite, split, seeds) for suite in _suites(folders)}
    if json and len(planned) > 1:
        raise ValueError(f"--json prints one suite, the folders are for those of {', '.join(planned)}")
    for scenarios in planned.values():
        scoring.check_stored(results, scenarios)
    reports, clashes = _judged(folders, gate)
    why = _why_left_out(reports, clashes)
    for reason in dict.fromkeys(why.values()):
        note(f"left out: {reason}")
    entries = {report.folder: report.entry for report in reports if report.folder not in why and report.entry}
    codes = [int(bool(why))]
    for name, scenarios in planned.items():
        env_id = get_suite(name).env_id
        if of_suite := {folder: entry for folder, entry in entries.items() if entry.environment == env_id}:
            played = scoring.run_evaluation([*of_suite.values()], results, n_threads=threads, **scenarios)
            codes.append(scoring.finish(played, results, as_json=json))
            if cards is not None:
                _write_cards(cards, of_suite, played, threads)
    return max(codes)


def _write_cards(folder: Path, entries: "Mapping[Path, Entry]", played: "Results", n_threads: int | None) -> None:
    """Write the pages about entries that were played, of each name about the first, if they are of the page's suite."""
    from wtg_gym.files import write_together
    from wtg_gym.plotting import report as page

    if played.suite != page.SUITE:
        return
    first = {entry.name: path for path, entry in reversed(list(entries.items()))}
    for path, entry in entries.items():
        results = page.part_of_entry(played, entry)
        if results is None or path != first[entry.name]:
            continue
        made = page.Report(entry=entry, spec=_shown(path), results=results, stored=True, n_threads=n_threads)
        try:
            files = page.report_files(made, path.name)
        except ValueError as error:
            note(f"no page about {entry.name}: {error}")
            continue
        write_together({folder / name: content for name, content in files.items()})
        note(f"wrote {folder / path.name}.html and .md")


def _suites(folders: Sequence[Path]) -> list[str]:
    """Return the standard suites of the versions that the folders say they are for."""
    from wtg_gym.envs.settings import EnvSettings
    from wtg_gym.policies.entry_folder import ENTRY_FILE, parse_submission, read_files
    from wtg_gym.tasks import TASKS

    environments: set[str | None] = set()
    for folder in folders:
        # The gate says why one cannot be read.
        with contextlib.suppress(ValueError):
            environments.add(parse_submission(read_files(folder)[ENTRY_FILE]).environment)
    return [EnvSettings(version=task.version).suite_name for task in TASKS.values() if task.env_id in environments]


def _judged(folders: Sequence[Path], gate: GateOptions) -> "tuple[list[Report], list[Conflict]]":
    """Return the gate's reports, and conflicts of accepted submissions with each other and with those there are."""
    from wtg_gym.policies.gate import check_submission, conflicts, read_submission

    reports, beside = [check_submission(folder, weak=gate.weak_isolation) for folder in folders], []
    for text in dict.fromkeys(text for report in reports for text in report.notes):
        note(f"not isolated, as --weak-isolation allows: {text}")
    accepted, resolved = [report for report in reports if report.accepted], [path.resolve() for path in folders]
    for folder in map(Path, gate.beside) if accepted else ():
        if folder.resolve() not in resolved:
            beside.append(read_submission(folder))
            if refusal := beside[-1].refusal:
                note(f"--beside {_shown(folder)}: compared as far as it can be read: {refusal.reason}")
    return reports, conflicts(accepted, beside)


def _why_left_out(reports: "Sequence[Report]", clashes: "Sequence[Conflict]") -> dict[Path, str]:
    """Return why folders are not ranked: authors cannot choose the seeds of a row, so all of a name go together."""
    reason = {folder: conflict.reason for conflict in clashes for folder in conflict.folders}
    for report in reports:
        if report.refusal is not None:
            reason[report.folder] = f"{_shown(report.folder)}: {report.refusal.name}: {report.refusal.reason}"
    names = {report.entry.name for report in reports if report.folder in reason and report.entry is not None}
    for report in reports:
        if report.entry is not None and report.entry.name in names:
            reason.setdefault(report.folder, f"{_shown(report.folder)}, as another folder of its name is refused")
    return reason


def _shown(folder: Path) -> str:
    # One line, and no command to a terminal.
    return ascii(str(folder))[1:-1]
