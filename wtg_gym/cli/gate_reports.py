"""What `wtg-gym submission` says of folders: what the gate found, and which of them are not ranked."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

from wtg_gym.cli.output import note, print_table, say
from wtg_gym.cli.submission import WEAK_OPTION, GateOptions
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.policies.entry_folder import ENTRY_FILE, parse_submission, read_files
from wtg_gym.policies.gate import Conflict, Report, check_submission, conflicts, read_submission
from wtg_gym.tasks import TASKS


def suites(folders: Sequence[Path]) -> list[str]:
    """Return the standard suites of the versions that the folders say they are for."""
    said: set[str | None] = set()
    for folder in folders:
        # The gate says why one cannot be read.
        with contextlib.suppress(ValueError):
            said.add(parse_submission(read_files(folder)[ENTRY_FILE]).environment)
    return [EnvSettings(version=each.version).suite_name for each in TASKS.values() if each.env_id in said]


def why_left_out(reports: Sequence[Report], wrong: Sequence[Conflict]) -> dict[Path, str]:
    """Return why folders are not ranked: authors cannot choose the seeds of a row, so all of a name go together."""
    why = {folder: conflict.reason for conflict in wrong for folder in conflict.folders}
    for report in reports:
        if report.refusal is not None:
            why[report.folder] = f"{_shown(report.folder)}: {report.refusal.name}: {report.refusal.reason}"
    names = {report.entry.name for report in reports if report.folder in why and report.entry is not None}
    for report in reports:
        if report.entry is not None and report.entry.name in names:
            why.setdefault(report.folder, f"{_shown(report.folder)}, as another folder of its name is refused")
    return why


def reports(folders: Sequence[Path], gate: GateOptions) -> list[Report]:
    """Return what the gate finds in folders; what is not isolated is said."""
    found = [check_submission(folder, weak=gate.weak_isolation) for folder in folders]
    for text in dict.fromkeys(text for report in found for text in report.notes):
        note(f"not isolated, as {WEAK_OPTION} allows: {text}")
    return found


def together(reports: list[Report], gate: GateOptions) -> list[Conflict]:
    """Return the conflicts of accepted submissions with each other and with those that are there."""
    accepted = [report for report in reports if report.accepted]
    own = {report.folder.resolve() for report in reports}
    beside = []
    for folder in map(Path, gate.beside) if accepted else ():
        if folder.resolve() not in own:
            beside.append(read_submission(folder))
            refusal = beside[-1].refusal
            if refusal is not None:
                note(f"--beside {_shown(folder)}: compared as far as it can be read: {refusal.reason}")
    return conflicts(accepted, beside)


def _shown(folder: Path) -> str:
    # One line, and no command to a terminal.
    return ascii(str(folder))[1:-1]


def print_report(report: Report) -> None:
    """Print every check of a folder, and whether it is accepted."""
    print_table(
        (_shown(report.folder), "verdict", "reason"),
        [(check.name, check.verdict, check.reason) for check in report.checks],
        left=(0, 1, 2),
    )
    accepted = f"accepted, sha256 {report.sha256}" if report.accepted else "refused"
    say(f"{_shown(report.folder)}: {accepted}", "")
