"""Stored results of entries used again where they would come out the same today, and all others played."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wtg_gym.cli.output import note
from wtg_gym.cli.scoring import run_evaluation
from wtg_gym.evaluation import Entry, Results, Workers
from wtg_gym.policies.entry import row_conflict

#: Name and training seed of an entry.
_Run = tuple[str, int | None]


def stored_or_played(
    entries: Sequence[Entry],
    folder: Path,
    *,
    fresh: bool,
    partial: Path | None,
    workers: Workers | None,
    **scenarios: Any,
) -> tuple[Results, Results]:
    """Return the entries' results, and these with all other stored ones, which is what to write.

    Args:
        scenarios: suite, split and further arguments of :func:`~wtg_gym.evaluation.evaluate`.
    """
    anchors = run_evaluation([], **scenarios)
    stored = None if fresh else _stored(folder / f"{anchors.name}.json", anchors)
    missing = [entry for entry in entries if stored is None or not _is_in(entry, stored)]
    if stored is not None:
        note(f"{len(entries) - len(missing)} of {len(entries)} entries are stored in {folder}")
    new = run_evaluation(missing, partial=partial, workers=workers, **scenarios) if missing else anchors
    return _merged(entries, new, stored)


def _stored(path: Path, anchors: Results) -> Results | None:
    """Return stored results if they would come out the same today, else None with a note why not."""
    if not path.exists():
        return None
    try:
        stored = Results.read(path)
    except ValueError as error:
        note(f"not used: {error}")
        return None
    for key in ("suite_hash", "source_hash", "environment", "split", "seeds", "settings", "versions"):
        if getattr(stored, key) != getattr(anchors, key):
            note(f"not used: {path} is of another {key.replace('_', ' ')}; evaluating everything")
            return None
    names = anchors.benchmark.anchors
    if any(stored.episodes_of(name) != anchors.episodes_of(name) for name in names):
        note(f"not used: {path} is not reproduced by a replay of {' and '.join(names)}; evaluating everything")
        return None
    return stored


def _is_in(entry: Entry, stored: Results) -> bool:
    """Return whether an entry's episodes are stored, whatever texts about it were stored with them."""
    # Without an identity the policy may have changed.
    played = {(data["name"], data["training_seed"], data["sha256"]) for data in stored.entries}
    return entry.identity is not None and (entry.name, entry.training_seed, entry.identity) in played


def _merged(entries: Sequence[Entry], new: Results, stored: Results | None) -> tuple[Results, Results]:
    """Return the entries' results with the anchors', out of new and stored ones; and these with all other stored ones.

    A stored entry that cannot share the row of a given one, as it is another method of that name, is dropped.
    """
    sources = [new] if stored is None else [stored, new]
    described = {_key(data): data for source in sources for data in source.entries}
    wanted = {(entry.name, entry.training_seed): entry.to_dict() for entry in entries}
    for name in new.benchmark.anchors:
        wanted.setdefault((name, None), dict(described[name, None]))
    others = {
        key: dict(data)
        for key, data in described.items()
        if key not in wanted and not any(row_conflict(data, own) for (name, _), own in wanted.items() if name == key[0])
    }
    failed = [] if stored is None else [data for data in stored.failed if data["name"] not in dict([*wanted, *others])]
    episodes = {}
    for source in sources:
        for key in (*wanted, *others):
            own = [episode for episode in source.episodes if episode.run == key]
            if own:
                episodes[key] = own
    # Stored training seeds of a name are left out with the one that has failed now.
    reasons = {_key(data): data["reason"] for data in new.failed}

    def results_of(data: Mapping[_Run, Mapping[str, Any]], failed: Sequence[Mapping[str, Any]]) -> Results:
        rows = tuple(episode for key in data for episode in episodes.get(key, ()))
        every = dataclasses.replace(new, entries=tuple(data.values()), episodes=rows, failed=tuple(failed))
        return every.without(reasons)

    return results_of(wanted, ()), results_of({**wanted, **others}, failed)


def _key(data: Mapping[str, Any]) -> _Run:
    return data["name"], data["training_seed"]
