"""The results of an evaluation: every episode, the scores, and what is needed to repeat it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from wtg_gym.evaluation import results_file
from wtg_gym.evaluation.episodes import Episode, to_csv
from wtg_gym.evaluation.leaderboard import html_table
from wtg_gym.evaluation.metrics import METRICS
from wtg_gym.evaluation.oracle import KnownOracle, known_oracle
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.evaluation.score import NoScaleError, log_gains, pinned
from wtg_gym.evaluation.statistics import Floats, Interval, mean
from wtg_gym.evaluation.summary import EntryMeasures, EntrySummary, entry_measures, ranked, summarise
from wtg_gym.extras import install_advice
from wtg_gym.ranges import ByName
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import Benchmark

if TYPE_CHECKING:
    from pandas import DataFrame

Value = TypeVar("Value")


@dataclass(frozen=True, kw_only=True, repr=False)
class Results:
    """Every episode of an evaluation, with what is needed to repeat it.

    Args:
        suite: name of the suite.
        split: which of its splits.
        suite_hash: the suite's own hash.
        source_hash: hash of the physics and environment that were run.
        seeds: seeds of the scenarios.
        draw: commit and sha256 of the secret that the seeds of the split "fresh" were drawn from; None for the others.
        environment: its id, and the fingerprint of what it answers on this machine.
        settings: settings of the environment that all entries share.
        versions: of wtg_gym, Python and the packages that compute, and the kind of processor.
        entries: data of every entry, the score's anchors among them.
        episodes: one row per entry and scenario, in the order of `entries` and `seeds`.
        failed: data of every entry that is left out, and "reason": how its policy failed, or that of another training
            seed of its name, as a row has all of them or none.
        parts: the finished batches that they were put together from, which :meth:`write` removes; None for none.
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
    parts: PartialStore | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return suite, split, number of scenarios and the ranking's scores in a line."""
        try:
            rows = ranked(self.summaries)
            entries = ", ".join(f"{row.name} {row.score.value:.1f}" for row in rows)
        except NoScaleError:
            entries = ", ".join(dict.fromkeys(entry["name"] for entry in self.entries)) + ", without a score"
        return f"<Results of {self.suite}, {self.split}, {len(self.seeds)} scenarios: {entries}>"

    def _repr_html_(self) -> str:
        """Return the ranking as a table, which notebooks show."""
        return html_table(self)

    @property
    def benchmark(self) -> Benchmark:
        """Version of the benchmark, with the names of the score's anchors."""
        return get_suite(self.suite).benchmark

    @property
    def scores(self) -> dict[str, Interval]:
        """Mean score of every entry with its 95 % interval, by its name; errors as of :attr:`summaries`."""
        return self._by_entry({row.name: row.score for row in self.summaries})

    @cached_property
    def summaries(self) -> list[EntrySummary]:
        """Summary of every entry, in the order of the entries.

        Raises:
            NoScaleError: on these scenarios the zero is not worse than the hundred, so that there is no score.
        """
        return summarise(self.measures, self.episodes, self._cap, self.benchmark)

    @cached_property
    def measures(self) -> list[EntryMeasures]:
        """What is measured of every entry, in the order of the entries; without a score there is this alone."""
        return entry_measures(self.entries, self.episodes, self._cap, self.oracle.costs, self.benchmark)

    @property
    def rows(self) -> list[EntryMeasures]:
        """The :attr:`summaries`, or the :attr:`measures` where there is no score."""
        return [*self.summaries] if self.has_scale else self.measures

    @property
    def has_scale(self) -> bool:
        """Whether the zero is worse than the hundred, so that there is a score."""
        return mean(self.log_gains[self.benchmark.zero]) < 0.0

    @cached_property
    def oracle(self) -> KnownOracle:
        """The lowest costs that are known for these scenarios, or why there are none."""
        hundred = {episode.seed: pinned(episode, self._cap) for episode in self.episodes_of(self.benchmark.hundred)}
        return known_oracle(self.suite, self.split, self.suite_hash, self.settings, hundred)

    @cached_property
    def pinned_costs(self) -> dict[str, Floats]:
        """Pinned costs by the entry's name, (n_runs, n_scenarios), in the order of training seeds and scenarios."""
        runs: dict[str, dict[int | None, list[float]]] = {}
        for episode in self.episodes:
            runs.setdefault(episode.entry, {}).setdefault(episode.training_seed, []).append(pinned(episode, self._cap))
        return self._by_entry({name: np.array(list(own.values())) for name, own in runs.items()})

    @property
    def log_gains(self) -> dict[str, Floats]:
        """Log gains over the hundred by the entry's name, (n_runs, n_scenarios)."""
        hundred = self.pinned_costs[self.benchmark.hundred][0]
        return self._by_entry({name: log_gains(costs, hundred) for name, costs in self.pinned_costs.items()})

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
            KeyError: the entry is unknown; the message lists the entries, and says how this one failed if it did.
        """
        found: dict[str, list[Episode]] = {}
        for episode in self.episodes:
            found.setdefault(episode.entry, []).append(episode)
        return self._by_entry(found)[name]

    def _by_entry(self, values: Mapping[str, Value]) -> dict[str, Value]:
        return ByName("entry", values, {entry["name"]: entry["reason"] for entry in self.failed})

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

    def to_pandas(self) -> DataFrame:
        """Return the episodes as a table of pandas, a row per entry and scenario.

        Columns are those of the CSV: entry, training_seed, seed, scenario, duration_s, failure, and every metric; and
        pinned_cost, whose mean the tables show: it differs from cost where the episode failed.

        Raises:
            ImportError: pandas, of the extra `data`, is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise ImportError(f"to_pandas() needs pandas; {install_advice('data')} ({error})") from error
        rows = [{**vars(each), **each.metrics, "pinned_cost": pinned(each, self._cap)} for each in self.episodes]
        # Most entries have no training seed, and some episodes not every metric.
        kinds = {"training_seed": "Int64", **dict.fromkeys(METRICS, "float64")}
        table: DataFrame = pandas.DataFrame(rows).drop(columns="metrics").astype(kinds)
        return table

    def to_dict(self) -> dict[str, Any]:
        """Return the description and the :attr:`rows` as JSON-ready data."""
        return {
            "format": results_file.FORMAT,
            **{key: getattr(self, key) for key in results_file.TEXTS},
            "seeds": list(self.seeds),
            "draw": None if self.draw is None else dict(self.draw),
            **{key: dict(getattr(self, key)) for key in ("environment", "settings", "versions")},
            "entries": [dict(entry) for entry in self.entries],
            "failed": [dict(entry) for entry in self.failed],
            "metrics": {name: asdict(metric) for name, metric in METRICS.items()},
            "summary": {row.name: asdict(row) for row in self.rows},
        }

    def write(self, folder: str | Path) -> tuple[Path, Path]:
        """Write `<suite>-<split>.json` and `.csv`, both or none, and remove the finished batches of an evaluation.

        The same results give the same bytes.

        Args:
            folder: where to; made if it is not there.

        Returns:
            the paths of the JSON and the CSV.

        Raises:
            OSError: a file cannot be written; the old ones are still there.
        """
        paths = results_file.write_pair(Path(folder) / self.name, self.to_dict(), to_csv(self.episodes))
        if self.parts is not None:
            # Not before: an interruption would lose what was played.
            self.parts.clear()
        return paths

    @classmethod
    def read(cls, path: str | Path) -> Results:
        """Read the files of :meth:`write`; the CSV lies beside the JSON.

        Args:
            path: the JSON file.

        Raises:
            ValueError: a file is missing, cut short, of another version, or was edited; the message names file, key
                and what is expected.
        """
        data, episodes = results_file.read_results(Path(path))
        results = cls(
            **{key: data[key] for key in (*results_file.TEXTS, "draw", "environment", "settings", "versions")},
            seeds=tuple(data["seeds"]),
            entries=tuple(data["entries"]),
            episodes=tuple(episodes),
            failed=tuple(data["failed"]),
        )
        if data["format"] == results_file.FORMAT:
            results_file.check_summary(data["summary"], results.to_dict()["summary"], f"{path}: summary")
        return results
