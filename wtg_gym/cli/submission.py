"""`wtg-gym submission new`, `check` and `score`: policies of others, which are only data."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
from pathlib import Path

from wtg_gym.cli.draw import add_split_options, chosen_draw
from wtg_gym.cli.output import check_output_folder, note, print_json, print_table
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.scores import chosen_seeds, finish, run_evaluation
from wtg_gym.scenarios import SUITES, get_suite
from wtg_gym.submissions import limits
from wtg_gym.submissions.folder import FILES
from wtg_gym.submissions.gate import REFUSED, Report, as_json, check_submission, doubled
from wtg_gym.submissions.isolation import WEAK_OPTION
from wtg_gym.submissions.template import write_template

_OPSETS = f"{limits.OPSETS.start} … {limits.OPSETS.stop - 1}"
_GATE = f"""\
A submission is a folder with entry.toml and policy.onnx, and a README.md if you like; nothing in it is run but the
network in policy.onnx, by onnxruntime, in a process without network that can give no file any content. Before, the file
is parsed and refused unless it is plain: at most {limits.MODEL_BYTES // 1_000_000} MB and {limits.PARAMETERS:,}
numbers, opset {_OPSETS}, operators from a list (feed-forward and recurrent layers; no loops, branches, random numbers
or functions), all weights in the file, and every shape known beforehand with the lanes of a batch apart."""

_NEW = """\
Writes an entry.toml with comments to fill in, and copies a policy beside it. `python -m agents.export` writes both
files for a run of `python -m agents.train`."""

_CHECK = f"""\
Says of every check whether a submission passes it, and why not; exits with 1 if one is refused.

{_GATE}"""

_PROCESS = (
    f"{limits.MEMORY_BYTES // 2**20} MiB of memory, {limits.CPU_S} s of processor time, {limits.CALL_S:g} s a step"
)
_SCORE = f"""\
Checks submissions, plays them on a suite and prints their rows of the leaderboard with those of both anchors; exits
with 1 if one is refused. Scenarios, simulation and score stay in this process; the policy's gets observations and
gives actions. Its limits: {_PROCESS}.

{_GATE}"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym submission` with its three commands."""
    parser = commands.add_parser(
        "submission",
        help="policies of others: write a template, check a folder, score it in isolation",
        description=_GATE,
    )
    own = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
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
        examples="  wtg-gym submission check my-policy\n  wtg-gym submission check my-policy-* --json",
    )
    _add_common(parser)
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
        "--suite", default="standard", metavar="NAME", help=f"suite: {', '.join(SUITES)} (default: standard)"
    )
    add_split_options(parser)
    parser.add_argument(
        "--seeds", nargs="+", metavar="A:B", help="seeds of the split, N or A:B with B left out (default: all)"
    )
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")
    parser.add_argument("--results", metavar="DIR", help="folder to write results to; made if missing (default: none)")


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", nargs="+", metavar="FOLDER", help=f"folder with {', '.join(FILES)}")
    parser.add_argument(
        WEAK_OPTION,
        action="store_true",
        help="go on where this system cannot take network, memory and time from a process; for policies you trust",
    )
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, on stdout")


def _run_new(arguments: argparse.Namespace) -> int:
    folder = check_output_folder("FOLDER", arguments.folder)
    for path in write_template(folder, None if arguments.policy is None else Path(arguments.policy)):
        note(f"wrote {path}")
    return 0


def _run_check(arguments: argparse.Namespace) -> int:
    reports = _reports(arguments)
    wrong = _together(reports)
    if arguments.json:
        print_json({"submissions": [as_json(report) for report in reports], "together": wrong})
    else:
        for report in reports:
            _print(report)
        for line in wrong:
            print(f"refused: {line}")
    return int(bool(wrong) or not all(report.accepted for report in reports))


def _run_score(arguments: argparse.Namespace) -> int:
    results_folder = None if arguments.results is None else check_output_folder("--results", arguments.results)
    get_suite(arguments.suite)
    seeds = None if arguments.seeds is None else chosen_seeds(arguments.seeds)
    draw = chosen_draw(arguments)
    reports = _reports(arguments)
    wrong = _together(reports)
    refused = [report for report in reports if not report.accepted]
    for report in refused:
        (check,) = (check for check in report.checks if check.verdict == REFUSED)
        wrong.append(f"{_shown(report.folder)}: {check.name}: {check.reason}")
    if wrong:
        for line in wrong:
            note(f"refused: {line}")
        return 1
    with contextlib.ExitStack() as stack:
        entries = []
        for report in reports:
            entry, policy = report.open(weak=arguments.weak_isolation)
            stack.enter_context(policy)
            entries.append(entry)
        results = run_evaluation(entries, arguments, split=arguments.split, partial=None, seeds=seeds, draw=draw)
    finish(results, results_folder, as_json=arguments.json)
    return 0


def _reports(arguments: argparse.Namespace) -> list[Report]:
    for package in ("onnx", "onnxruntime"):
        if importlib.util.find_spec(package) is None:
            raise ValueError(f"submissions need {package} of the agents extra: pip install 'wtg-gym[agents]'")
    reports = [check_submission(Path(folder), weak=arguments.weak_isolation) for folder in arguments.folders]
    for text in dict.fromkeys(text for report in reports for text in report.notes):
        note(f"not isolated, as {WEAK_OPTION} allows: {text}")
    return reports


def _together(reports: list[Report]) -> list[str]:
    return doubled([report for report in reports if report.accepted])


def _shown(folder: Path) -> str:
    # Whatever it is called, it is one line and no command to a terminal.
    return ascii(str(folder))[1:-1]


def _print(report: Report) -> None:
    print_table(
        (_shown(report.folder), "verdict", "reason"),
        [(check.name, check.verdict, check.reason) for check in report.checks],
        left=(0, 1, 2),
    )
    accepted = f"accepted, sha256 {report.sha256}" if report.accepted else "refused"
    print(f"{_shown(report.folder)}: {accepted}\n")
