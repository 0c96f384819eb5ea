"""Conflicts of submissions, with each other and with entries that are there already: names, seeds and copied files."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wtg_gym.names import plain_name
from wtg_gym.policies.entry import Entry, row_conflict
from wtg_gym.policies.gate import Report


@dataclass(frozen=True)
class Conflict:
    """Submissions that cannot all be accepted: their folders, and why."""

    folders: tuple[Path, ...]
    reason: str


def conflicts(reports: Sequence[Report], beside: Sequence[Report] = ()) -> list[Conflict]:
    """Return the conflicts of accepted submissions with each other and with entries that are there already.

    Each names the folders of `reports` it concerns; conflicts among those `beside`, and among folders that come with
    the package, are not looked for.
    """
    found = []
    for one, other in itertools.combinations(reports, 2):
        if reason := _why_not_both(one, other, taken=False):
            found.append(Conflict((one.folder, other.folder), reason))
    for new in reports:
        reasons = filter(None, (_why_not_both(new, old, taken=True) for old in beside))
        # One reason is enough, however many seeds have the name.
        found += [Conflict((new.folder,), reason) for reason in itertools.islice(reasons, 1)]
    return found


def _why_not_both(one: Report, other: Report, *, taken: bool) -> str:
    """Return why two folders cannot both be accepted, or the first not if the other one is there; "" if they can."""
    if one.shipped and other.shipped:
        return ""
    if one.entry and other.entry and plain_name(one.entry.name) == plain_name(other.entry.name):
        named = _not_one_row(one, other, one.entry, other.entry, taken)
    else:
        named = _found_as(one, other)
    return _same_place(one, other) or named or _same_file(one, other)


def _same_place(one: Report, other: Report) -> str:
    """Two folders are one where capitals do not count, as on Windows and macOS."""
    first, second = one.folder.resolve().name, other.folder.resolve().name
    if first == second or first.casefold() != second.casefold():
        return ""
    return f"the names of the folders {one.folder} and {other.folder} differ in capitals alone"


def _not_one_row(one: Report, other: Report, new: Entry, old: Entry, taken: bool) -> str:
    """Folders with one name must be seeds of one entry, which come together: a row that is there does not change."""
    if taken:
        return f"the name {new.name} of {one.folder} is taken by {old.name} of {other.folder}"
    folders = f"{one.folder} and {other.folder}"
    if new.name != old.name:
        return f"the names {new.name} and {old.name} look alike: {folders}"
    reason = row_conflict(new.to_dict(), old.to_dict())
    return reason and f"{reason}: {folders}"


def _found_as(one: Report, other: Report) -> str:
    """A name finds a folder by the folder's name or the entry's: those of two entries may not look alike."""
    first, second = (
        {plain_name(name): name for name in (each.folder.resolve().name, *([each.entry.name] if each.entry else []))}
        for each in (one, other)
    )
    for plain in first.keys() & second.keys():
        return f"{first[plain]}, of {one.folder}, looks like {second[plain]}, of {other.folder}"
    return ""


def _same_file(one: Report, other: Report) -> str:
    if one.sha256 is None or one.sha256 != other.sha256:
        return ""
    return f"the same policy file is given twice: {one.folder} and {other.folder}"
