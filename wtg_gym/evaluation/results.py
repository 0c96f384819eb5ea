"""The outcome of an evaluation, and its two files: a JSON that describes and sums up, a CSV of the episodes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.checks import check_description
from wtg_gym.evaluation.entries import ANCHORS
from wtg_gym.evaluation.episodes import Episode, from_csv, to_csv
from wtg_gym.evaluation.metrics import METRICS
from wtg_gym.evaluation.oracle import KnownOracle, known_oracle
from wtg_gym.evaluation.statistics import Floats, NoScaleError
from wtg_gym.evaluation.summary import EntrySummary, pinned, summarise
from wtg_gym.files import parse_json, read_text, sha256, to_json, write_atomically

#: Version of the files; another number is another form.
FORMAT = 3
#: By how much a summary may differ from what its table sums up to, relative, or absolute where it is next to nothing.
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True)
class Results:
    """Every episode of an evaluation, with what is needed to repeat it.

    Args:
        suite: name of the suite.
        split: which of its splits.
        suite_hash: the suite's own hash.
        source_hash: hash of the physics and environment that were run.
        seeds: seeds of the scenarios.
        draw: commit and sha256 of the secret that the seeds of the split "verification" were drawn from; None for the
            others.
        environment: its id, and the fingerprint of what it answers on this machine.
        settings: settings of the environment that all entries share.
        versions: of wtg_gym, Python and the packages that compute, and the kind of processor.
        entries: data of every entry, the score's anchors among them.
        episodes: one row per entry and scenario, in the order of `entries` and `seeds`.
        failed: data of every entry that is left out, and "reason": how its policy failed, or that of another training
            seed of its name, as a row has all of them or none.
    """

    suite: str
    split: str
    suite_hash: str
    source_hash: str
    seeds: tuple[int, ...]
    draw: Mapping[str, str] | None
    environment: Mapping[str, str]
    settings: Mapping[str, Any]
    versions: Mapping[str, str]
    entries: tuple[Mapping[str, Any], ...]
    episodes: tuple[Episode, ...]
    failed: tuple[Mapping[str, Any], ...] = ()

    @cached_property
    def summaries(self) -> list[EntrySummary]:
        """Summary of every entry, in the order of the entries.

        Raises:
            NoScaleError: on these scenarios MPPT is not worse than the reference, so that there is no score.
        """
        return summarise(self.entries, self.episodes, self._cap, self.oracle.costs)

    @cached_property
    def oracle(self) -> KnownOracle:
        """What is known to be the cheapest in these scenarios, if anything is, and why not."""
        reference = {episode.seed: pinned(episode, self._cap) for episode in self.episodes_of(ANCHORS[1])}
        return known_oracle(self.suite, self.split, self.suite_hash, self.settings, reference)

    @cached_property
    def pinned_costs(self) -> dict[str, Floats]:
        """Pinned costs by the entry's name, (n_runs, n_scenarios), in the order of training seeds and scenarios."""
        runs: dict[str, dict[int | None, list[float]]] = {}
        for episode in self.episodes:
            runs.setdefault(episode.entry, {}).setdefault(episode.training_seed, []).append(pinned(episode, self._cap))
        return {name: np.array(list(own.values())) for name, own in runs.items()}

    @property
    def log_gains(self) -> dict[str, Floats]:
        """Log gains over the reference by the entry's name, (n_runs, n_scenarios)."""
        reference = self.pinned_costs[ANCHORS[1]][0]
        return {name: statistics.log_gains(costs, reference) for name, costs in self.pinned_costs.items()}

    @property
    def _cap(self) -> float:
        return float(self.settings["weights"]["cap"])

    @property
    def name(self) -> str:
        """Return the files' name without ending."""
        return f"{self.suite}-{self.split}"

    def episodes_of(self, name: str) -> list[Episode]:
        """Return the episodes of an entry.

        Raises:
            ValueError: there is no such entry; the message lists those there are.
        """
        found = [episode for episode in self.episodes if episode.entry == name]
        if not found:
            reasons = [f": {entry['reason']}" for entry in self.failed if entry["name"] == name]
            names = dict.fromkeys(episode.entry for episode in self.episodes)
            raise ValueError(f"no entry {name!r} in these results{''.join(reasons[:1])}; entries: {', '.join(names)}")
        return found

    def without(self, reasons: Mapping[tuple[str, int | None], str]) -> Results:
        """Return the results without entries that failed, and without all training seeds of their names.

        Args:
            reasons: how an entry failed, by its name and training seed.
        """
        if not reasons:
            return self
        first = {name: reason for (name, _), reason in reversed(list(reasons.items()))}
        left_out = [
            {**entry, "reason": reasons.get((entry["name"], entry["training_seed"]), first[entry["name"]])}
            for entry in self.entries
            if entry["name"] in first
        ]
        return replace(
            self,
            entries=tuple(entry for entry in self.entries if entry["name"] not in first),
            episodes=tuple(episode for episode in self.episodes if episode.entry not in first),
            failed=(*self.failed, *left_out),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the episodes as JSON-ready data; `summary` is empty where there is no score."""
        try:
            summary = {row.name: row.to_dict() for row in self.summaries}
        except NoScaleError:
            summary = {}
        return {
            "format": FORMAT,
            "suite": self.suite,
            "split": self.split,
            "suite_hash": self.suite_hash,
            "source_hash": self.source_hash,
            "seeds": list(self.seeds),
            "draw": None if self.draw is None else dict(self.draw),
            "environment": dict(self.environment),
            "settings": dict(self.settings),
            "versions": dict(self.versions),
            "entries": [dict(entry) for entry in self.entries],
            "failed": [dict(entry) for entry in self.failed],
            "metrics": {name: asdict(metric) for name, metric in METRICS.items()},
            "summary": summary,
        }

    def write(self, folder: str | Path) -> tuple[Path, Path]:
        """Write `<suite>-<split>.json` and `.csv`, each in one go; the same results give the same bytes.

        Args:
            folder: where to; made if it is not there.

        Returns:
            the paths of the JSON and the CSV.

        Raises:
            OSError: the folder cannot be written to.
        """
        json_path, csv_path = (Path(folder) / f"{self.name}.{ending}" for ending in ("json", "csv"))
        table = to_csv(self.episodes)
        data = {**self.to_dict(), "csv_sha256": sha256(table.encode())}
        data["sha256"] = sha256(to_json(data).encode())
        write_atomically(csv_path, table)
        # Last, so that a JSON never describes a table that is not there yet.
        write_atomically(json_path, to_json(data))
        return json_path, csv_path

    @classmethod
    def read(cls, path: str | Path) -> Results:
        """Read what :meth:`write` wrote; the CSV lies beside the JSON.

        Args:
            path: the JSON file.

        Raises:
            ValueError: a file is missing, cut short, of another version, or was edited; the message names file, key
                and what is expected.
        """
        json_path = Path(path)
        csv_path = json_path.with_suffix(".csv")
        text = read_text(json_path, "results file")
        data = parse_json(text, f"the results file {json_path}")
        check_description(data, json_path, FORMAT)
        _require_intact(text, data, json_path)
        table = read_text(csv_path, "table of episodes")
        episodes = from_csv(table, csv_path)
        if sha256(table.encode()) != data["csv_sha256"]:
            raise ValueError(
                f"{csv_path} is not the table that {json_path} describes (csv_sha256): it was edited or belongs to "
                "another run; evaluate again"
            )
        _require_complete(data, episodes, csv_path)
        results = cls(
            suite=data["suite"],
            split=data["split"],
            suite_hash=data["suite_hash"],
            source_hash=data["source_hash"],
            seeds=tuple(data["seeds"]),
            draw=data["draw"],
            environment=data["environment"],
            settings=data["settings"],
            versions=data["versions"],
            entries=tuple(data["entries"]),
            episodes=tuple(episodes),
            failed=tuple(data["failed"]),
        )
        _require_summed_up(data["summary"], results.to_dict()["summary"], f"{json_path}: summary")
        return results


def _require_intact(text: str, data: dict[str, Any], path: Path) -> None:
    """The checksum holds for the data, and the text is the one way of writing them."""
    content = {key: value for key, value in data.items() if key != "sha256"}
    if sha256(to_json(content).encode()) != data["sha256"] or to_json(data) != text:
        raise ValueError(f"{path} was edited or damaged: its sha256 does not fit its content; evaluate again")


def _require_summed_up(stored: Any, summed: Any, where: str) -> None:
    """What the summary says is what the table sums up to, but for the rounding of another machine."""
    if isinstance(stored, dict) and isinstance(summed, dict) and set(stored) == set(summed):
        for key in summed:
            _require_summed_up(stored[key], summed[key], f"{where}.{key}")
        return
    numbers = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in (stored, summed))
    if not (math.isclose(stored, summed, rel_tol=_ROUNDING, abs_tol=_ROUNDING) if numbers else stored == summed):
        raise ValueError(f"{where} is {str(stored)[:80]}, the table sums up to {str(summed)[:80]}; evaluate again")


def _require_complete(data: dict[str, Any], episodes: list[Episode], path: Path) -> None:
    names = [entry["name"] for entry in data["entries"]]
    missing = [name for name in ANCHORS if name not in names]
    if missing:
        raise ValueError(f"{path}: the score's anchors {missing} are missing from the entries {names}")
    expected = [(entry["name"], entry["training_seed"], seed) for entry in data["entries"] for seed in data["seeds"]]
    if [(*episode.run, episode.seed) for episode in episodes] != expected:
        raise ValueError(
            f"{path}: expected one row per entry and seed, in the order of the JSON's entries and seeds "
            f"({len(expected)} rows), got {len(episodes)} rows that differ"
        )


__all__ = ["FORMAT", "Results"]
