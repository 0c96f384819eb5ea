"""Finished batches on disk, from which an interrupted evaluation goes on."""

import contextlib
import json
import logging
from pathlib import Path
from typing import Any

from wtg_gym import files
from wtg_gym.evaluation.circumstances import measurement_hash, versions
from wtg_gym.evaluation.episodes import Episode, episode_from_cells
from wtg_gym.policies import Entry
from wtg_gym.systems.compiled import source_hash

_log = logging.getLogger("wtg_gym")


class PartialStore:
    """A folder of finished batches, JSON-ready; one of another `context` is not found.

    None, or a folder that another user could change, stores nothing. A ValueError refuses a path to something else.
    """

    def __init__(self, folder: str | Path | None, context: Any) -> None:
        self._folder = None if folder is None else Path(folder)
        if self._folder is not None:
            if self._folder.exists() and not self._folder.is_dir():
                raise ValueError(f"partial must be a folder for finished batches, got the file {folder}")
            try:
                self._folder.parent.mkdir(parents=True, exist_ok=True)
                files.trusted_folder(self._folder, make=True)
            except OSError as error:
                _log.warning("finished batches are not stored in %s: %s", self._folder, files.one_line(error))
                self._folder = None
        self._context = [context, versions(), source_hash(), measurement_hash()]
        self._used: list[Path] = []

    def _path(self, entry: Entry, seeds: list[int]) -> Path | None:
        """Return the file of a batch; None where it cannot be stored: no folder, or an entry without identity."""
        if self._folder is None or entry.identity is None:
            return None
        return self._folder / f"{self._digest(entry, seeds)}.json"

    def _digest(self, entry: Entry, seeds: list[int], rows: Any = None) -> str:
        """Return a sha256 of what is asked for and, if given, of the rows that answer it."""
        data = [self._context, entry.to_dict(), seeds, rows]
        return files.sha256(json.dumps(data, sort_keys=True, allow_nan=False).encode())

    def load(self, entry: Entry, seeds: list[int]) -> list[Episode] | None:
        """Return a stored batch; None where there is none, another user could have written it, or it is another."""
        path = self._path(entry, seeds)
        if path is None or not path.exists():
            return None
        try:
            with files.interpreting(path, "finished batch"):
                data = files.parse_json(files.read_trusted(path, files.LARGEST_BYTES["finished batch"]).decode(), "it")
                episodes = [episode_from_cells(cells, str(path)) for cells in data["rows"]]
                played = [(*episode.run, episode.seed) for episode in episodes]
                expected = [(entry.name, entry.training_seed, seed) for seed in seeds]
                if data["sha256"] != self._digest(entry, seeds, data["rows"]) or played != expected:
                    raise ValueError("it is damaged, or of another entry, scenario, suite, split or version")
        except ValueError as error:
            _log.warning("%s is not used, and %s is played again: %s", path, entry.label, error)
            return None
        self._used.append(path)
        return episodes

    def save(self, entry: Entry, seeds: list[int], episodes: list[Episode]) -> None:
        """Store a batch."""
        path = self._path(entry, seeds)
        if path is not None:
            rows = [episode.cells() for episode in episodes]
            data = {"rows": rows, "sha256": self._digest(entry, seeds, rows)}
            files.write_trusted(path, files.to_json(data).encode())
            self._used.append(path)

    def clear(self) -> None:
        """Remove the batches this run has used, and the folder if nothing else is in it."""
        for path in self._used:
            path.unlink(missing_ok=True)
        if self._folder is not None:
            with contextlib.suppress(OSError):
                self._folder.rmdir()
