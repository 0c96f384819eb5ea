"""Several submissions together, and beside those that are there already: who has the name, and who is a copy."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wtg_gym.evaluation.onnx_policy import Floats
from wtg_gym.submissions import limits
from wtg_gym.submissions.folder import EntryFile
from wtg_gym.submissions.gate import Report
from wtg_gym.submissions.texts import plain_name

#: What folders of one name must say alike; they share a row.
_SHARED = ("authors", "action_mode", "observation_mode", "description", "trained_on")


@dataclass(frozen=True)
class Conflict:
    """Submissions that cannot all be accepted: their folders, and why."""

    folders: tuple[Path, ...]
    reason: str


def conflicts(reports: Sequence[Report], beside: Sequence[Report] = ()) -> list[Conflict]:
    """Return what is wrong with accepted submissions together.

    Args:
        reports: of the submissions.
        beside: of the entries that are there already; what is wrong among them is not looked for.

    Returns:
        the conflicts, each with the folders of `reports` it concerns.
    """
    found = []
    for one, other in itertools.combinations(reports, 2):
        reason = _same_place(one, other) or _row_mates(one, other) or _copies(one, other)
        if reason:
            found.append(Conflict((one.folder, other.folder), reason))
    for new in reports:
        reasons = (_same_place(new, old) or _taken(new, old) or _copies(new, old) for old in beside)
        # One reason is enough, however many seeds have the name.
        found += [Conflict((new.folder,), reason) for reason in itertools.islice(filter(None, reasons), 1)]
    return found


def action_difference(one: Floats, other: Floats) -> float:
    """Return the root mean square of the difference of two rollouts' actions, over the steps that both have."""
    steps = min(len(one), len(other))
    return float(np.sqrt(np.mean(np.square(one[:steps] - other[:steps], dtype=np.float64))))


def _entries(one: Report, other: Report) -> tuple[EntryFile, EntryFile] | None:
    return None if one.entry is None or other.entry is None else (one.entry, other.entry)


def _same_place(one: Report, other: Report) -> str:
    """Return that two folders are one where capitals do not count, as on Windows and macOS; else nothing."""
    first, second = one.folder.resolve().name, other.folder.resolve().name
    if first == second or first.casefold() != second.casefold():
        return ""
    return f"the names of the folders {one.folder} and {other.folder} differ in capitals alone"


def _row_mates(one: Report, other: Report) -> str:
    """Return why two new folders cannot be seeds of one entry, if they say they are; else nothing."""
    entries = _entries(one, other)
    if entries is None or plain_name(entries[0].name) != plain_name(entries[1].name):
        return ""
    first, second = entries
    folders = f"{one.folder} and {other.folder}"
    if first.name != second.name:
        return f"the names {first.name} and {second.name} look alike: {folders}"
    if first.training_seed == second.training_seed:
        return f"{first.name}, training seed {first.training_seed} is given twice: {folders}"
    differing = [key for key in _SHARED if getattr(first, key) != getattr(second, key)]
    if differing:
        return f"folders of one name are one entry and must agree on {', '.join(differing)}: {folders}"
    return ""


def _taken(new: Report, old: Report) -> str:
    """Return why a new folder cannot have its name beside an entry that is there; else nothing."""
    entries = _entries(new, old)
    if entries is None or plain_name(entries[0].name) != plain_name(entries[1].name):
        return ""
    # All its seeds came together: a row that is there does not change.
    return f"the name {entries[0].name} of {new.folder} is taken by {entries[1].name} of {old.folder}"


def _copies(one: Report, other: Report) -> str:
    """Return that two folders hold one policy, if they do; else nothing."""
    folders = f"{one.folder} and {other.folder}"
    if one.sha256 is not None and one.sha256 == other.sha256:
        return f"the same policy file is given twice: {folders}"
    entries = _entries(one, other)
    if entries is None or one.actions is None or other.actions is None:
        return ""
    # Actions of other modes mean something else.
    if entries[0].action_mode != entries[1].action_mode:
        return ""
    if action_difference(one.actions, other.actions) > limits.COPY_TOLERANCE:
        return ""
    return (
        f"the policies are one policy, their actions in {one.actions.shape[1]} scenarios differ by less than "
        f"{limits.COPY_TOLERANCE:g} (root mean square): {folders}"
    )


__all__ = ["Conflict", "action_difference", "conflicts"]
