"""Conflicts of submissions, with each other and with entries that are there already: names, seeds and copies."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wtg_gym.policies.gate import Report
from wtg_gym.policies.onnx_policy import Floats
from wtg_gym.policies.submission_folder import EntryFile
from wtg_gym.policies.submission_texts import plain_name

#: Two policies whose actions, [-1, 1], differ by no more than this (root mean square over the rollout) are copies. The
#: shipped training seeds that are most alike differ by more than seven times as much.
COPY_TOLERANCE = 5e-3
#: Keys on which folders of one name must agree; they share a row.
_SHARED = ("authors", "action_mode", "observation_mode", "strategy", "description", "trained_on")


@dataclass(frozen=True)
class Conflict:
    """Submissions that cannot all be accepted: their folders, and why."""

    folders: tuple[Path, ...]
    reason: str


def conflicts(reports: Sequence[Report], beside: Sequence[Report] = ()) -> list[Conflict]:
    """Return the conflicts of accepted submissions with each other and with entries that are there already.

    Args:
        reports: of the submissions.
        beside: of the entries that are there already; conflicts among them are not looked for.

    Returns:
        the conflicts, each with the folders of `reports` it concerns.
    """
    found = []
    for one, other in itertools.combinations(reports, 2):
        reason = _same_place(one, other) or _not_one_row(one, other) or _copies(one, other)
        if reason:
            found.append(Conflict((one.folder, other.folder), reason))
    for new in reports:
        reasons = (_same_place(new, old) or _name_is_taken(new, old) or _copies(new, old) for old in beside)
        # One reason is enough, however many seeds have the name.
        found += [Conflict((new.folder,), reason) for reason in itertools.islice(filter(None, reasons), 1)]
    return found


def action_difference(one: Floats, other: Floats) -> float:
    """Return the root mean square of the difference of two rollouts' actions, over the steps that both have."""
    steps = min(len(one), len(other))
    return float(np.sqrt(np.mean(np.square(one[:steps] - other[:steps], dtype=np.float64))))


def _same_place(one: Report, other: Report) -> str:
    """Two folders are one where capitals do not count, as on Windows and macOS."""
    first, second = one.folder.resolve().name, other.folder.resolve().name
    if first == second or first.casefold() != second.casefold():
        return ""
    return f"the names of the folders {one.folder} and {other.folder} differ in capitals alone"


def _look_alike(one: Report, other: Report) -> tuple[EntryFile, EntryFile] | None:
    if one.entry is None or other.entry is None or plain_name(one.entry.name) != plain_name(other.entry.name):
        return None
    # They are never in one table.
    if one.entry.environment != other.entry.environment:
        return None
    return one.entry, other.entry


def _not_one_row(one: Report, other: Report) -> str:
    """Why two new folders with one name cannot be seeds of one entry."""
    entries = _look_alike(one, other)
    if entries is None:
        return ""
    first, second = entries
    folders = f"{one.folder} and {other.folder}"
    if first.name != second.name:
        return f"the names {first.name} and {second.name} look alike: {folders}"
    if first.training_seed == second.training_seed:
        return f"{first.name}, training seed {first.training_seed} is given twice: {folders}"
    differing = [key for key in _SHARED if getattr(first, key) != getattr(second, key)]
    return f"folders of one name are one entry and must agree on {', '.join(differing)}: {folders}" if differing else ""


def _name_is_taken(new: Report, old: Report) -> str:
    """All seeds of a row come together: a row that is there does not change."""
    entries = _look_alike(new, old)
    if entries is None:
        return ""
    return f"the name {entries[0].name} of {new.folder} is taken by {entries[1].name} of {old.folder}"


def _copies(one: Report, other: Report) -> str:
    folders = f"{one.folder} and {other.folder}"
    if one.sha256 is not None and one.sha256 == other.sha256:
        return f"the same policy file is given twice: {folders}"
    if one.entry is None or other.entry is None or one.actions is None or other.actions is None:
        return ""
    # Actions of other modes or on other laws mean something else, and another version has other scenarios.
    entries = one.entry, other.entry
    first, second = ((entry.action_mode, entry.environment, entry.strategy) for entry in entries)
    if first != second or action_difference(one.actions, other.actions) > COPY_TOLERANCE:
        return ""
    return (
        f"the policies are one policy, their actions in {one.actions.shape[1]} scenarios differ by less than "
        f"{COPY_TOLERANCE:g} (root mean square): {folders}"
    )
