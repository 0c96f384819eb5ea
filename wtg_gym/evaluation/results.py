"""The results of an evaluation: every episode, the scores, what is needed to repeat it, and the ranking for a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from wtg_gym.evaluation import results_file, summary
from wtg_gym.evaluation.adjusted import LEAST_SCENARIOS, Adjusted, ControlVariates, KnownMeans, known_means
from wtg_gym.evaluation.episodes import Episode, to_csv
from wtg_gym.evaluation.metrics import METRICS
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.evaluation.score import NoScaleError, cost_offsets, gains, score_scales
from wtg_gym.evaluation.statistics import Bootstrap, Floats, Groups, Interval
from wtg_gym.evaluation.summary import EntrySummary, Runs, ranked
from wtg_gym.evaluation.table import columns_of, markdown_table, notes_on_marks
from wtg_gym.files import interpreting
from wtg_gym.ranges import ByName
from wtg_gym.scenarios import FROZEN_HASHES, get_suite
from wtg_gym.tasks import Task

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
    environment: Mapping[str, str]
    settings: Mapping[str, Any]
    versions: Mapping[str, str]
    entries: tuple[Mapping[str, Any], ...]
    episodes: tuple[Episode, ...]
    failed: tuple[Mapping[str, Any], ...] = ()
    parts: PartialStore | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return suite, split, number of scenarios and the ranking's scores in a line."""
        entries = ", ".join(
            f"{row.name} {row.score.value:.1f}" if row.score else f"{row.name} without a score" for row in self.ranking
        )
        return f"<Results of {self.suite}, {self.split}, {len(self.seeds)} scenarios: {entries}>"

    def _repr_markdown_(self) -> str:
        """Return the ranking as a table, which notebooks show."""
        scenarios = f"{self.suite}, {self.split}: {len(self.seeds)} scenarios"
        return f"{'; '.join([scenarios, *self.notes])}\n\n{markdown_table(self.ranking)}"

    @property
    def task(self) -> Task:
        """Version of the benchmark, with the names of the score's anchors."""
        return get_suite(self.suite).task

    @property
    def scores(self) -> dict[str, Interval]:
        """Mean score of every entry with its 95 % interval, by its name; errors as of :attr:`summaries`."""
        return self._by_entry({row.name: row.score for row in self.summaries if row.score})

    @cached_property
    def summaries(self) -> list[EntrySummary]:
        """Summary of every entry, in the order of the entries.

        Raises:
            NoScaleError: in v0, the zero is not worse than the hundred on these scenarios.
        """
        self._check_scale()
        runs, costs = self._runs, self.pinned_costs
        return summary.scored(self._measured, runs, costs, self.task, self.cost_offsets, self._scoring)

    @cached_property
    def _measured(self) -> list[EntrySummary]:
        costs, suite = self.pinned_costs, get_suite(self.suite)
        return summary.measured(self.entries, self._runs, costs, suite, self.groups, self._scoring)

    @cached_property
    def _scoring(self) -> Bootstrap | Adjusted:
        if self.task.scale is None:
            return Bootstrap(self._gains(self.task.zero))
        variates = None
        if not self.unadjusted:
            variates = ControlVariates(np.stack([*map(self._gains, self.task.variates)], axis=1), self._known_means)
        return Adjusted(self.task.scale, self.groups, variates)

    def _gains(self, law: str) -> Floats:
        hundred = self.pinned_costs[self.task.hundred][0]
        gained: Floats = gains(self.pinned_costs[law], hundred, self.cost_offsets)[0]
        return gained

    @cached_property
    def _known_means(self) -> dict[str, KnownMeans]:
        return known_means(get_suite(self.suite).name, self.suite_hash, self.settings, self.task.variates)

    @cached_property
    def unadjusted(self) -> str:
        """Why scores are not adjusted by the control variates of the version; "" where they are, or in v0."""
        why = ""
        if not self.task.variates:
            return ""
        if not self._known_means:
            why = "their mean gains are not known for this suite with these settings"
        elif missing := [name for name in self._known_means if name not in self.groups]:
            why = f"none of the {len(self.seeds)} scenarios is of the stratum {missing[0]!r}"
        elif min(at.size for at in self.groups.values()) < LEAST_SCENARIOS:
            why = f"they need {LEAST_SCENARIOS} scenarios of each stratum"
        return f"scored without control variates: {why}" if why else ""

    @property
    def notes(self) -> list[str]:
        """What a reader of the ranking has to know: why there is no score, how it was made, what its marks mean."""
        return [note for note in (self.no_score, self.unadjusted, *notes_on_marks(self.ranking)) if note]

    @property
    def ranking(self) -> list[EntrySummary]:
        """The :attr:`summaries`, the best first; where there is no score, the least mean cost first.

        In v1 the marked entries come first.
        """
        return ranked(self.summaries if self.has_scale else self._measured)

    @cached_property
    def no_score(self) -> str:
        """Why there is no score, and what ranks instead; "" where there is a score."""
        try:
            self._check_scale()
        except NoScaleError as error:
            return f"ranked by mean cost, as there is no score: {error}"
        return ""

    def _check_scale(self) -> None:
        zero, hundred = (self.pinned_costs[name][0] for name in self.task.anchors)
        score_scales(zero, hundred, self.task, self.groups)

    @property
    def has_scale(self) -> bool:
        """Whether there is a score: in v0, whether the zero is worse than the hundred."""
        return not self.no_score

    @cached_property
    def pinned_costs(self) -> dict[str, Floats]:
        """Pinned costs by the entry's name, (n_runs, n_scenarios), in the order of training seeds and scenarios."""
        return self._by_entry({name: summary.pinned_costs(runs, self._cap) for name, runs in self._runs.items()})

    @cached_property
    def _runs(self) -> dict[str, Runs]:
        return summary.runs_by_name(self.episodes)

    @cached_property
    def groups(self) -> Groups:
        """The scenarios of each stratum that has some, as indices by its name; by "" where there are no strata."""
        suite = get_suite(self.suite)
        own = np.array([suite.stratum(seed) for seed in self.seeds])
        return {name: np.flatnonzero(own == name) for name in suite.strata or ("",) if name in own}

    @property
    def cost_offsets(self) -> Floats:
        """J0 of every scenario, (n_scenarios,)."""
        return cost_offsets(self.groups, self.task)

    @property
    def _cap(self) -> float | None:
        return None if self.task.failure_costs_whole_episode else float(self.settings["weights"]["cap"])

    @property
    def name(self) -> str:
        """Return the files' name without ending."""
        return f"{get_suite(self.suite).name}-{self.split}"

    def check_suite(self) -> None:
        """Raise a ValueError if the suite has changed since: only results of the same suite are comparable."""
        now = FROZEN_HASHES.get(self.suite) or get_suite(self.suite).hash
        if self.suite_hash != now:
            raise ValueError(
                f"the results {self.name} are of the suite {self.suite!r} with the hash {self.suite_hash[:12]}, that "
                f"suite's hash is {now[:12]} here: evaluate again"
            )

    def episodes_of(self, name: str) -> list[Episode]:
        """Return the episodes of an entry.

        Raises:
            KeyError: the entry is unknown; the message lists the entries, and says how this one failed if it did.
        """
        return [episode for run in self._by_entry(self._runs)[name] for episode in run]

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

    def to_dict(self) -> dict[str, Any]:
        """Return the description and the :attr:`ranking` as JSON-ready data."""
        return {
            "format": results_file.FORMAT,
            **{key: getattr(self, key) for key in results_file.TEXTS},
            "seeds": list(self.seeds),
            **{key: dict(getattr(self, key)) for key in ("environment", "settings", "versions")},
            "entries": [dict(entry) for entry in self.entries],
            "failed": [dict(entry) for entry in self.failed],
            "metrics": {name: asdict(metric) for name, metric in METRICS.items()},
            "summary": {row.name: asdict(row) for row in self.ranking},
        }

    def write(self, folder: str | Path) -> tuple[Path, Path]:
        """Write `<suite>-<split>.json` and `.csv` into a folder, both or none, and remove the finished batches.

        The same results give the same bytes.

        Returns:
            the paths of the JSON and the CSV.

        Raises:
            OSError: a file cannot be written; the old ones are still there.
        """
        paths = results_file.write(Path(folder) / self.name, self.to_dict(), to_csv(self.episodes))
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
        with interpreting(Path(path), "description of the results"):
            data, episodes = results_file.read(Path(path))
            results = cls(
                **{key: data[key] for key in (*results_file.TEXTS, "environment", "settings", "versions")},
                seeds=tuple(data["seeds"]),
                entries=tuple(data["entries"]),
                episodes=tuple(episodes),
                failed=tuple(data["failed"]),
            )
            results_file.check_summary(data["summary"], results.to_dict()["summary"], "summary")
        return results


def leaderboard_rows(results: Results) -> list[EntrySummary]:
    """Return the entries' summaries, the best first, in v1 the marked ones, equal ones by name.

    Raises:
        NoScaleError: the results have no score, see :attr:`Results.summaries`.
    """
    return ranked(results.summaries)


def markdown_section(results: Results, *, details: bool = False) -> str:
    """Return the ranking for a Markdown page, in detail or in short.

    In short, since v1, a sentence on the frequency comes first, and entries below the entry at 0 are only named.
    """
    rows = results.ranking
    short = not details and results.task.version != "v0"
    least = min((row.score.value for row in rows if row.name == results.task.zero and row.score), default=0.0)
    below = [row for row in rows if short and row.score is not None and row.score.value < least]
    shown = [row for row in rows if row not in below]
    named = f"below {results.task.zero}: {', '.join(f'`{row.name}`' for row in below)}" if below else ""
    notes = " ".join(f"{note[0].upper()}{note[1:]}." for note in (*results.notes, named) if note)
    table = markdown_table(shown, columns_of("details", rows) if details else None)
    return "\n\n".join(part for part in (_frequency_sentence(results) if short else "", table, notes) if part)


def _frequency_sentence(results: Results) -> str:
    """Return what the anchors and the best learned entry do for the frequency [mHz]."""
    task, rows = results.task, results.ranking
    learned = next((row for row in rows if row.kind == "learned"), None)
    who = {task.zero: "the published law", task.hundred: "that law tuned to this grid"}
    if learned is not None:
        who[learned.name] = f"`{learned.name}`, the best learned entry"
    deviations = {row.name: row.median_deviation_mhz for row in rows}
    said = [f"{deviations[name]:.0f} mHz with {words}" for name, words in who.items()]
    return (
        f"Median over {len(results.seeds)} {results.split} scenarios of the largest deviation of the frequency: "
        f"{', '.join(said)}."
    )
