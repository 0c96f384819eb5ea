"""`wtg-gym submission new`, `check` and `score`: policies of others, which are only data."""

from __future__ import annotations

import argparse
import os
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from wtg_gym.cli import scoring
from wtg_gym.cli.output import check_output_folder, note, print_json, print_table, say
from wtg_gym.cli.parser import Commands, add_command, add_group, add_json_option
from wtg_gym.cli.suites_command import suite_name, suites_by_version
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.policies.conflicts import Conflict, conflicts
from wtg_gym.policies.gate import Report, check_submission
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE
from wtg_gym.policies.policy_process import CPU_S, MEMORY_BYTES, STEP_S
from wtg_gym.policies.submission_folder import FILES, parse_submission, read_files, write_template
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import BENCHMARKS, Benchmark


def _filled(text: str) -> str:
    """Return paragraphs with lines of equal length, whatever numbers were put in."""
    return "\n\n".join(textwrap.fill(paragraph, 120) for paragraph in text.split("\n\n"))


_LIMITS = (
    f"{MEMORY_BYTES // 2**20} MiB of memory, {CPU_S} s of processor time and {STEP_S:g} s a step for 256 scenarios"
)
_GATE = _filled(
    f"""\
A submission is a folder with entry.toml and policy.onnx, and a README.md if you like. Nothing in it is run but the
network in policy.onnx, at most {FILES[POLICY_FILE] // 1_000_000} MB with all weights in it. onnxruntime plays it one
scenario at a time, in a process that can only compute and answer, here and wherever it is played later. Random numbers
start alike in every scenario."""
)

WEAK_OPTION = "--weak-isolation"

_NEW = """\
Writes an entry.toml with comments to fill in, and copies a policy beside it. `python -m agents.export` writes both
files for a run of `python -m agents.train`."""

_CHECK = f"""\
Says of every check whether a submission passes it, and why not; exits with 1 if one is refused. Several folders are
checked together, and with --beside against existing entries: a name belongs to one entry, whose training seeds are
submitted together, and the same policy counts once, even if its files differ.

{_GATE}"""

_SCORE = _filled(
    f"""\
Checks submissions, plays each on the standard suite of the version that it is for, or on --suite, and prints their rows
of the leaderboard with those of both anchors. One that is refused, or whose policy crashes, takes too long or gives no
action in a scenario, is named with its reason and left out with all folders of its name; the others are ranked, and the
exit code is 1. Scenarios, simulation and score stay in this process; the policy's gets observations and gives actions.
Its limits: {_LIMITS}. With --results, an interrupted command goes on from its finished parts.

{_GATE}"""
)


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym submission` with its three commands."""
    own = add_group(commands, "submission", description=_GATE)
    parser = add_command(
        own,
        "new",
        _run_new,
        summary="write a template",
        description=_NEW,
        examples="  wtg-gym submission new my-policy\n  wtg-gym submission new my-policy --policy trained/policy.onnx",
    )
    parser.add_argument("folder", metavar="FOLDER", help="where to write; made if missing")
    parser.add_argument("--policy", metavar="FILE", help="an .onnx file to copy")
    parser = add_command(
        own,
        "check",
        _run_check,
        summary="say whether folders are accepted, and why not",
        description=_CHECK,
        examples="  wtg-gym submission check my-policy --beside agents/policies/*\n"
        "  wtg-gym submission check my-policy-* --json",
    )
    _add_common(parser)
    add_json_option(parser)
    parser = add_command(
        own,
        "score",
        _run_score,
        summary="check folders, then play them in isolation and rank them",
        description=_SCORE,
        examples="  wtg-gym submission score my-policy\n"
        "  wtg-gym submission score my-policy-* --suite low-wind --results my_results",
    )
    _add_common(parser)
    parser.add_argument(
        "--suite",
        type=suite_name,
        metavar="NAME",
        help=f"suite, of {suites_by_version()} (default: the standard suite of the version that a folder is for)",
    )
    scoring.add_split_options(parser, "test")
    scoring.add_run_options(parser)
    scoring.add_result_options(parser)


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", nargs="+", metavar="FOLDER", help=f"folder with {', '.join(FILES)}")
    parser.add_argument(
        "--beside",
        nargs="+",
        default=[],
        metavar="FOLDER",
        help="entries that are there already, to compare names and policies with; those given as FOLDER are left out",
    )
    parser.add_argument(
        WEAK_OPTION,
        action="store_true",
        help="continue where this system cannot keep a process from files, network, other processes, memory or time; "
        "for policies of people you trust",
    )


def _run_new(arguments: argparse.Namespace) -> int:
    folder = check_output_folder("FOLDER", arguments.folder)
    for path in write_template(folder, None if arguments.policy is None else Path(arguments.policy)):
        note(f"wrote {path}")
    return 0


def _run_check(arguments: argparse.Namespace) -> int:
    _check_there(arguments.folders)
    reports = _reports(arguments)
    wrong = _together(reports, arguments)
    if arguments.json:
        together = [conflict.reason for conflict in wrong]
        print_json({"submissions": [report.to_dict() for report in reports], "together": together})
    else:
        for report in reports:
            _print(report)
        for conflict in wrong:
            say(f"refused: {conflict.reason}")
    return int(bool(wrong) or not all(report.accepted for report in reports))


def _run_score(arguments: argparse.Namespace) -> int:
    folder = None if arguments.results is None else check_output_folder("--results", arguments.results)
    partial = scoring.kept_parts(folder, arguments) if folder is not None and arguments.resume else None
    _check_there(arguments.folders)
    planned = {suite: _scenarios(arguments, suite, folder) for suite in _suites(arguments)}
    options = {"n_threads": arguments.threads, "partial": partial}
    # Anchors first: errors of the arguments come before the work of the gate.
    for chosen in planned.values():
        scoring.run_evaluation([], **chosen, **options)
    reports = _reports(arguments)
    wrong = _together(reports, arguments) + _refused(reports) + _of_another_version(reports, planned)
    ranked = _ranked(reports, wrong)
    _name_left_out(ranked, reports, wrong)
    entries = [report.played(weak=arguments.weak_isolation) for report in ranked]
    codes = [int(bool(wrong))]
    for suite, chosen in planned.items():
        own = [entry for entry in entries if entry.environment == get_suite(suite).benchmark.env_id]
        results = scoring.run_evaluation(own, **chosen, **options)
        codes.append(scoring.finish(results, folder, as_json=arguments.json) if own else 0)
    return max(codes)


def _suites(arguments: argparse.Namespace) -> list[str]:
    """Return the suite that was asked for, or the standard suites of the versions that the folders are for."""
    if arguments.suite is not None:
        return [arguments.suite]
    said = [_said(Path(folder)) for folder in arguments.folders]
    suites = [EnvSettings(version=each.version).suite for each in BENCHMARKS.values() if each in said]
    if arguments.json and len(suites) > 1:
        raise ValueError(f"--json prints one suite, the folders are for those of {', '.join(suites)}: give --suite")
    return suites


def _said(folder: Path) -> Benchmark | None:
    """Return the version that a folder says it is for; None if it cannot be read, the gate says why."""
    try:
        return BENCHMARKS[parse_submission(read_files(folder)[ENTRY_FILE]).environment]
    except ValueError:
        return None


def _scenarios(arguments: argparse.Namespace, suite: str, folder: Path | None) -> dict[str, Any]:
    chosen = scoring.chosen_scenarios(argparse.Namespace(**{**vars(arguments), "suite": suite}))
    scoring.check_stored(folder, chosen)
    return chosen


def _check_there(folders: Sequence[str]) -> None:
    for folder in folders:
        if not os.path.lexists(folder):
            raise ValueError(f"there is no folder {folder}")


def _of_another_version(reports: Sequence[Report], suites: Iterable[str]) -> list[Conflict]:
    played = {get_suite(suite).benchmark.env_id: suite for suite in suites}
    return [
        Conflict(
            (report.folder,),
            f"{_shown(report.folder)}: entry.toml says environment {report.entry.environment}, "
            f"{', '.join(played.values())} is a suite of {', '.join(played)}: give another --suite, or none",
        )
        for report in reports
        if report.accepted and report.entry is not None and report.entry.environment not in played
    ]


def _refused(reports: Sequence[Report]) -> list[Conflict]:
    return [
        Conflict((report.folder,), f"{_shown(report.folder)}: {report.refusal.name}: {report.refusal.reason}")
        for report in reports
        if report.refusal is not None
    ]


def _name_left_out(ranked: Sequence[Report], reports: Sequence[Report], wrong: Sequence[Conflict]) -> None:
    for conflict in wrong:
        note(f"refused: {conflict.reason}")
    for report in reports:
        if report not in ranked and not any(report.folder in conflict.folders for conflict in wrong):
            note(f"left out: {_shown(report.folder)}, as another folder of its name is refused")


def _ranked(reports: Sequence[Report], wrong: Sequence[Conflict]) -> list[Report]:
    """Return the submissions of names without any refused folder: authors cannot choose the seeds of a row."""
    folders = {folder for conflict in wrong for folder in conflict.folders}
    names = {report.entry.name for report in reports if report.folder in folders and report.entry is not None}
    return [
        report
        for report in reports
        if report.folder not in folders and report.entry is not None and report.entry.name not in names
    ]


def _reports(arguments: argparse.Namespace) -> list[Report]:
    reports = [check_submission(Path(folder), weak=arguments.weak_isolation) for folder in arguments.folders]
    for text in dict.fromkeys(text for report in reports for text in report.notes):
        note(f"not isolated, as {WEAK_OPTION} allows: {text}")
    return reports


def _together(reports: list[Report], arguments: argparse.Namespace) -> list[Conflict]:
    """Return the conflicts of accepted submissions with each other and with those that are there."""
    accepted = [report for report in reports if report.accepted]
    own = {report.folder.resolve() for report in reports}
    beside = []
    for folder in map(Path, arguments.beside) if accepted else ():
        if folder.resolve() not in own:
            beside.append(check_submission(folder, weak=arguments.weak_isolation, rollout_only=True))
            refusal = beside[-1].refusal
            if refusal is not None:
                note(f"--beside {_shown(folder)}: compared as far as it can be read: {refusal.reason}")
    return conflicts(accepted, beside)


def _shown(folder: Path) -> str:
    # One line, and no command to a terminal.
    return ascii(str(folder))[1:-1]


def _print(report: Report) -> None:
    print_table(
        (_shown(report.folder), "verdict", "reason"),
        [(check.name, check.verdict, check.reason) for check in report.checks],
        left=(0, 1, 2),
    )
    accepted = f"accepted, sha256 {report.sha256}" if report.accepted else "refused"
    say(f"{_shown(report.folder)}: {accepted}", "")
