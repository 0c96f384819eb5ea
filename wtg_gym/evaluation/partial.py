"""Finished batches on disk, from which an interrupted evaluation goes on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from wtg_gym import __version__
from wtg_gym.evaluation.circumstances import measurement_hash
from wtg_gym.evaluation.episodes import Episode, episode_from_cells
from wtg_gym.files import read_json, sha256, to_json, write_atomically
from wtg_gym.physics.compiled import source_hash


class PartialStore:
    """A folder of finished batches.

    Args:
        folder: where they lie; None stores nothing.
        context: data that all batches share, JSON-ready; a batch of another context is not found.
    """

    def __init__(self, folder: Path | None, context: Any) -> None:
        self._folder = folder
        self._context = [context, __version__, source_hash(), measurement_hash()]
        self._used: list[Path] = []

    def path(self, entry: dict[str, Any], seeds: list[int]) -> Path | None:
        """Return the file of a batch; None where it cannot be stored: no folder, or an entry without identity.

        Args:
            entry: the entry's data, with its identity as "sha256".
            seeds: seeds of the batch's scenarios.

        Raises:
            ValueError: something that is not a file stands in its place, so that the batch could not be stored.
        """
        if self._folder is None or entry["sha256"] is None:
            return None
        key = json.dumps([self._context, entry, seeds], sort_keys=True, allow_nan=False)
        path = self._folder / f"{sha256(key.encode())}.json"
        if path.exists() and not path.is_file():
            raise ValueError(f"{path} must be the file of a finished part, it is something else; remove it")
        self._used.append(path)
        return path

    def load(self, path: Path | None, n_episodes: int) -> list[Episode] | None:
        """Return a stored batch; None where there is none, or it is damaged, which costs the time to play it again."""
        if path is None:
            return None
        try:
            data = read_json(path, "partial result")
            if sha256(to_json(data["rows"]).encode()) != data["sha256"] or len(data["rows"]) != n_episodes:
                return None
            return [episode_from_cells(cells, str(path)) for cells in data["rows"]]
        except (ValueError, KeyError, TypeError, AttributeError):
            return None

    def save(self, path: Path | None, episodes: list[Episode]) -> None:
        """Store a batch."""
        if path is not None:
            rows = [episode.cells() for episode in episodes]
            write_atomically(path, to_json({"rows": rows, "sha256": sha256(to_json(rows).encode())}))

    def clear(self) -> None:
        """Remove the batches this run has used."""
        for path in self._used:
            path.unlink(missing_ok=True)
