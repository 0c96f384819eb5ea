"""Conflicts of submissions, with each other and with entries that are there already: names, seeds and copies."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wtg_gym.policies.gate import COPY_TOLERANCE, Report, action_difference
from wtg_gym.policies.names import plain_name
from wtg_gym.policies.submission_folder import EntryFile

#: Keys on which folders of one name must agree; they share a row.
_SHARED = ("authors", "environment", "action_mode", "observation_mode", "strategy", "description", "trained_on")


@dataclass(frozen=True)
class Conflict:
    """Submissions that cannot all be accepted: their folders, and why."""

    folders: tuple[Path, ...]
    reason: str


def conflicts(reports: Sequence[Report], beside: Sequence[Report] = ()) -> list[Conflict]:
    """Return the conflicts of accepted submissions with each other and with entries that are there already.

    Each names the folders of `reports` it concerns; conflicts among those `beside` are not looked for.
    """
    found = []
    for one, other in itertools.combinations(reports, 2):
        reason = _same_place(one, other) or _not_one_row(one, other) or _found_as(one, other) or _copies(one, other)
        if reason:
            found.append(Conflict((one.folder, other.folder), reason))
    for new in reports:
        reasons = (
            _same_place(new, old) or _name_is_taken(new, old) or _found_as(new, old) or _copies(new, old)
            for old in beside
        )
        # One reason is enough, however many seeds have the name.
        found += [Conflict((new.folder,), reason) for reason in itertools.islice(filter(None, reasons), 1)]
    return found


def _same_place(one: Report, other: Report) -> str:
    """Two folders are one where capitals do not count, as on Windows and macOS."""
    first, second = one.folder.resolve().name, other.folder.resolve().name
    if first == second or first.casefold() != second.casefold():
        return ""
    return f"the names of the folders {one.folder} and {other.folder} differ in capitals alone"


def _look_alike(one: Report, other: Report) -> tuple[EntryFile, EntryFile] | None:
    if one.entry is None or other.entry is None or plain_name(one.entry.name) != plain_name(other.entry.name):
        return None
    return one.entry, other.entry


def _is_same_name_of_old(one: EntryFile, other: EntryFile, *, shipped: bool) -> bool:
    """Return whether the package has one maker's name in two versions, as it had before names were one's in both."""
    of_two = one.environment != other.environment
    return shipped and of_two and (one.name, one.authors) == (other.name, other.authors)


def _not_one_row(one: Report, other: Report) -> str:
    """Why two new folders with one name cannot be seeds of one entry."""
    entries = _look_alike(one, other)
    if entries is None:
        return ""
    first, second = entries
    if _is_same_name_of_old(first, second, shipped=one.shipped and other.shipped):
        return ""
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
    if entries is None or (new.shipped and old.shipped and not _not_one_row(new, old)):
        return ""
    return f"the name {entries[0].name} of {new.folder} is taken by {entries[1].name} of {old.folder}"


def _found_as(one: Report, other: Report) -> str:
    """A name finds a folder by the folder's name or the entry's: those of two entries may not look alike."""
    if _look_alike(one, other) is not None:
        return ""
    first, second = (
        {plain_name(name): name for name in (each.folder.resolve().name, *([each.entry.name] if each.entry else []))}
        for each in (one, other)
    )
    for plain in first.keys() & second.keys():
        return f"{first[plain]}, of {one.folder}, looks like {second[plain]}, of {other.folder}"
    return ""


def _copies(one: Report, other: Report) -> str:
    folders = f"{one.folder} and {other.folder}"
    if one.sha256 is not None and one.sha256 == other.sha256:
        return f"the same policy file is given twice: {folders}"
    if one.entry is None or other.entry is None or one.actions is None or other.actions is None:
        return ""
    # Actions on other laws mean something else, and another version has other scenarios.
    first, second = ((entry.environment, entry.strategy) for entry in (one.entry, other.entry))
    if first != second:
        return ""
    modes = one.entry.action_mode, other.entry.action_mode
    if action_difference(one.actions, other.actions, *modes) > COPY_TOLERANCE:
        return ""
    return (
        f"the policies are one policy, their actions in {one.actions.shape[1]} scenarios differ by less than "
        f"{COPY_TOLERANCE:g} (root mean square): {folders}"
    )
