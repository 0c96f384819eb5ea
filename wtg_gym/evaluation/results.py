"""The results of an evaluation: every episode, scores, what repeats it, their two files, the ranking for a page.

The files are a JSON that describes and a CSV with the table of episodes.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from wtg_gym.evaluation import metrics, statistics, summary
from wtg_gym.evaluation.adjusted import LEAST_SCENARIOS, Adjusted, ControlVariates, KnownMeans, known_means
from wtg_gym.evaluation.episodes import Episode, check_size, from_csv, to_csv
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.evaluation.score import NoScaleError, cost_offsets, gains, score_scale
from wtg_gym.evaluation.table import columns_of, markdown_table, notes_on_marks
from wtg_gym.files import interpreting, parse_json, read_text, sha256, to_json, write_together
from wtg_gym.names import check_name
from wtg_gym.policies.entry import KINDS, Entry, check_rows
from wtg_gym.ranges import ByName, require_count
from wtg_gym.scenarios import FROZEN_HASHES, get_suite
from wtg_gym.scenarios.suite import MOST_SCENARIOS
from wtg_gym.tasks import Task

Value = TypeVar("Value")
#: Version of the files; another number is another form.
FORMAT = 8
#: Keys of the description that are texts; types of all its values, and of those of an entry.
_TEXTS = ("suite", "split", "suite_hash", "source_hash")
_TYPES: Mapping[str, Any] = {
    **dict.fromkeys(_TEXTS, str),
    **dict.fromkeys(("seeds", "entries", "failed"), list),
    **dict.fromkeys(("environment", "settings", "versions", "metrics", "summary"), dict),
}
_ENTRY_TYPES: Mapping[str, Any] = {
    **dict.fromkeys(Entry(name="any").to_dict(), str),
    **dict.fromkeys(("environment", "sha256", "policy_sha256"), str | None),
    "training_seed": int | None,
    "strategy": dict,
    "per_group": bool,
}
#: Entries at most.
_MOST_ENTRIES = 1000
#: By how much a summary may differ from the sum of its table, relative, or absolute near zero.
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True, repr=False)
class Results:
    """Every episode of an evaluation, with what is needed to repeat it."""

    suite: str  # its name
    split: str
    suite_hash: str
    source_hash: str  # of the physics and environment that were run
    seeds: tuple[int, ...]  # of the scenarios
    environment: Mapping[str, str]  # its id, and a fingerprint of its outputs on this machine
    settings: Mapping[str, Any]  # of the environment, which all entries share
    versions: Mapping[str, str]  # of wtg_gym, Python and the packages that compute, and the type of processor
    entries: tuple[Mapping[str, Any], ...]  # data of every entry, including the references
    episodes: tuple[Episode, ...]  # one row per entry and scenario, in the order of `entries` and `seeds`
    #: Data of every entry that is left out, with the "reason": its own failure, or that of a training seed of its name.
    failed: tuple[Mapping[str, Any], ...] = ()
    parts: PartialStore | None = field(default=None, compare=False)  # finished batches, which :meth:`write` removes

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
    def scores(self) -> dict[str, statistics.Interval]:
        """Mean score of every entry with its 95 % interval, by its name; errors as of :attr:`summaries`."""
        return self._by_entry({row.name: row.score for row in self.summaries if row.score})

    @property
    def summaries(self) -> list[summary.EntrySummary]:
        """Summary of every entry; a NoScaleError if, in v0, the entry at 0 is not worse than the one at 100."""
        self._check_scale()
        return self._summaries

    @cached_property
    def _summaries(self) -> list[summary.EntrySummary]:
        """The :attr:`summaries`, without scores where there are none."""
        of_entries = self.entries, self.runs, self.pinned_costs, get_suite(self.suite), self.groups
        return summary.summaries(*of_entries, self._scoring, with_scores=not self.no_score)

    @cached_property
    def _scoring(self) -> statistics.Bootstrap | Adjusted:
        if self.task.scale is None:
            return statistics.Bootstrap(self._gains(self.task.zero))
        variates = None
        if not self.unadjusted:
            variates = ControlVariates(np.stack([*map(self._gains, self.task.variates)], axis=1), self._known_means)
        return Adjusted(self.task.scale, self.groups, variates)

    def _gains(self, law: str) -> statistics.Floats:
        hundred, offsets = self.pinned_costs[self.task.hundred][0], cost_offsets(self.groups, self.task)
        return np.asarray(gains(self.pinned_costs[law], hundred, offsets)[0])

    @cached_property
    def _known_means(self) -> dict[str, KnownMeans]:
        return known_means(get_suite(self.suite).name, self.suite_hash, self.settings, self.task.variates)

    @cached_property
    def unadjusted(self) -> str:
        """Why scores are not adjusted by the control variates of the version; "" where they are, or in v0."""
        reason = ""
        if not self.task.variates:
            return ""
        if not self._known_means:
            reason = "their mean gains are not known for this suite with these settings"
        elif missing := [name for name in self._known_means if name not in self.groups]:
            reason = f"none of the {len(self.seeds)} scenarios is of the stratum {missing[0]!r}"
        elif min(at.size for at in self.groups.values()) < LEAST_SCENARIOS:
            least = LEAST_SCENARIOS * len(self._known_means)
            reason = f"they need {LEAST_SCENARIOS} scenarios of each stratum, such as --scenarios {least}"
        return f"scored without control variates: {reason}" if reason else ""

    @property
    def notes(self) -> list[str]:
        """Notes on a ranking: a missing score, adjustments, and the meaning of the mark."""
        return [note for note in (self.no_score, self.unadjusted, *notes_on_marks(self.ranking)) if note]

    @property
    def ranking(self) -> list[summary.EntrySummary]:
        """The :attr:`summaries`, the best first, in v1 the marked ones before; without a score the least mean cost."""
        return summary.ranked(self._summaries)

    @cached_property
    def no_score(self) -> str:
        """Why scores are missing, and which number ranks instead; "" if there are scores."""
        try:
            self._check_scale()
        except NoScaleError as error:
            return f"ranked by mean cost, as there is no score: {error}"
        return ""

    def _check_scale(self) -> None:
        zero, hundred = (self.pinned_costs[name][0] for name in self.task.anchors)
        score_scale(zero, hundred, self.task, self.groups)

    @cached_property
    def pinned_costs(self) -> dict[str, statistics.Floats]:
        """Pinned costs by the entry's name, (n_runs, n_scenarios), in the order of training seeds and scenarios."""
        cap = None if self.task.failure_costs_whole_episode else float(self.settings["weights"]["cap"])
        return self._by_entry({name: summary.pinned_costs(runs, cap) for name, runs in self.runs.items()})

    @cached_property
    def runs(self) -> dict[str, summary.Runs]:
        """The episodes by the entry's name, one list per training seed.

        The KeyError of an unknown name lists entries, and how that one failed.
        """
        runs: dict[str, dict[int | None, list[Episode]]] = {}
        for episode in self.episodes:
            runs.setdefault(episode.entry, {}).setdefault(episode.training_seed, []).append(episode)
        return self._by_entry({name: list(by_seed.values()) for name, by_seed in runs.items()})

    @cached_property
    def groups(self) -> statistics.Groups:
        """The scenarios of each stratum that has some, as indices by its name; by "" where there are no strata."""
        suite = get_suite(self.suite)
        strata = np.array([suite.stratum(seed) for seed in self.seeds])
        return {name: np.flatnonzero(strata == name) for name in suite.strata or ("",) if name in strata}

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
        """Return the episodes of an entry, of all training seeds; errors as of :attr:`runs`."""
        return [episode for run in self.runs[name] for episode in run]

    def _by_entry(self, values: Mapping[str, Value]) -> dict[str, Value]:
        return ByName("entry", values, {entry["name"]: entry["reason"] for entry in self.failed})

    def without(self, reasons: Mapping[tuple[str, int | None], str]) -> "Results":
        """Return the results without all training seeds of entries that failed, by name and training seed."""
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
            "format": FORMAT,
            **{key: getattr(self, key) for key in _TEXTS},
            "seeds": list(self.seeds),
            **{key: dict(getattr(self, key)) for key in ("environment", "settings", "versions")},
            "entries": [dict(entry) for entry in self.entries],
            "failed": [dict(entry) for entry in self.failed],
            "metrics": {name: asdict(metric) for name, metric in metrics.METRICS.items()},
            "summary": {row.name: asdict(row) for row in self.ranking},
        }

    def write(self, folder: str | Path) -> tuple[Path, Path]:
        """Write `<suite>-<split>.json` and `.csv` into a folder, both or none, and remove the finished batches.

        The same results give the same bytes. It returns both paths; after an OSError the old files are still there.
        """
        json_path, csv_path = (Path(folder) / f"{self.name}.{ending}" for ending in ("json", "csv"))
        table = to_csv(self.episodes)
        data = {**self.to_dict(), "csv_sha256": sha256(table.encode())}
        data["sha256"] = sha256(to_json(data).encode())
        # The JSON last, so that it never describes a table that is not there yet.
        write_together({csv_path: table, json_path: to_json(data)})
        if self.parts is not None:
            # Not before: an interruption would lose what was played.
            self.parts.clear()
        return json_path, csv_path

    @classmethod
    def read(cls, path: str | Path) -> "Results":
        """Read the JSON file of :meth:`write`, with the CSV beside it.

        A ValueError that names file, key and what is expected says that a file is missing, cut short, of another
        version, or was edited.
        """
        with interpreting(Path(path), "description of the results"):
            data, episodes = _read(Path(path))
            results = cls(
                **{key: data[key] for key in (*_TEXTS, "environment", "settings", "versions")},
                seeds=tuple(data["seeds"]),
                entries=tuple(data["entries"]),
                episodes=tuple(episodes),
                failed=tuple(data["failed"]),
            )
            _check_summary(data["summary"], results.to_dict()["summary"], "summary")
        return results


def score_difference(results: Results, other: Results, name: str) -> statistics.Interval:
    """Return the score of an entry in results minus that in others of the same scenarios, paired, in version v1."""
    task, offsets = other.task, cost_offsets(other.groups, other.task)
    assert task.scale is not None
    costs = (each.pinned_costs[name] for each in (results, other))
    gained = (gains(cost, other.pinned_costs[task.hundred][0], offsets) for cost in costs)
    return Adjusted(task.scale, other.groups).score_difference(*gained)


def leaderboard_rows(results: Results) -> list[summary.EntrySummary]:
    """Return the entries' summaries, the best first, in v1 entries with ✓ first; a NoScaleError without a score."""
    return summary.ranked(results.summaries)


def markdown_section(results: Results, *, details: bool = False) -> str:
    """Return the ranking for a page: in detail, or with a sentence on the frequency and only down to the law at 0."""
    rows = results.ranking
    short = not details and results.task.version != "v0"
    # By Λ that law's score is 0, but for rounding.
    least = next((row.score.value for row in rows if row.name == results.task.zero and row.score), 0.0)
    below = [row for row in rows if short and row.score is not None and row.score.value < least]
    shown = [row for row in rows if row not in below]
    named = f"below {results.task.zero}: {', '.join(f'`{row.name}`' for row in below)}" if below else ""
    notes = " ".join(f"{note[0].upper()}{note[1:]}." for note in (*results.notes, named) if note)
    table = markdown_table(shown, columns_of("details", rows) if details else None)
    return "\n\n".join(part for part in (_frequency_sentence(results) if short else "", table, notes) if part)


def _frequency_sentence(results: Results) -> str:
    """Return what the anchors and the best learned entry without privileges do for the frequency [mHz]."""
    task, rows = results.task, results.ranking
    learned = next((row for row in rows if row.kind == "learned" and not row.privileged), None)
    labels = {task.zero: "the published law", task.hundred: "that law tuned to this grid"}
    if learned is not None:
        labels[learned.name] = f"`{learned.name}`, the learned entry that scores most"
    deviations = {row.name: row.median_deviation_mhz for row in rows}
    parts = ", ".join(f"{deviations[name]:.0f} mHz with {words}" for name, words in labels.items())
    scenarios = f"{len(results.seeds)} {results.split} scenarios"
    return f"Median over {scenarios} of the largest deviation of the frequency: {parts}."


def _read(json_path: Path) -> tuple[dict[str, Any], list[Episode]]:
    text = read_text(json_path, "description of the results")
    data = parse_json(text, "it")
    if data["format"] != FORMAT:
        raise ValueError(f"format must be {FORMAT}, that of this version, got {data['format']!r:.80}; evaluate again")
    content = {key: value for key, value in data.items() if key != "sha256"}
    if sha256(to_json(content).encode()) != data["sha256"] or to_json(data) != text:
        raise ValueError("it was edited or damaged: its sha256 does not fit its content")
    _check_description(data)
    csv_path = json_path.with_suffix(".csv")
    table = read_text(csv_path, "table of the results")
    if sha256(table.encode()) != data["csv_sha256"]:
        raise ValueError(f"{csv_path} is not its table: that was edited or belongs to another run")
    n_rows, n_lines = len(data["entries"]) * len(data["seeds"]), table.count("\n") - 1
    check_size((entry["name"] for entry in data["entries"]), len(data["seeds"]))
    expected = [(entry["name"], entry["training_seed"], seed) for entry in data["entries"] for seed in data["seeds"]]
    episodes = from_csv(table, csv_path) if n_lines == n_rows else []
    if n_lines != n_rows or [(*episode.run, episode.seed) for episode in episodes] != expected:
        raise ValueError(
            f"{csv_path}: expected one row per entry and seed, in the order of the JSON's entries and seeds "
            f"({n_rows} rows), got {n_lines} rows that differ"
        )
    return data, episodes


def _check_summary(stored: Any, summed: Any, where: str) -> None:
    """Raise a ValueError if a stored summary differs from the sum of its table by more than rounding."""
    if isinstance(stored, dict) and isinstance(summed, dict) and set(stored) == set(summed):
        for key in summed:
            _check_summary(stored[key], summed[key], f"{where}.{key}")
        return
    numbers = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in (stored, summed))
    if not (math.isclose(stored, summed, rel_tol=_ROUNDING, abs_tol=_ROUNDING) if numbers else stored == summed):
        raise ValueError(f"{where} is {str(stored)[:80]}, the table sums up to {str(summed)[:80]}; evaluate again")


def _check_types(where: str, data: Mapping[str, Any], types: Mapping[str, Any]) -> None:
    for key, expected in types.items():
        # Python takes true for a whole number.
        if not isinstance(data[key], expected) or (isinstance(data[key], bool) and expected is not bool):
            name = getattr(expected, "__name__", expected)
            raise ValueError(f"{where}{key} must be of the type {name}, got {data[key]!r:.80}")


def _check_description(data: dict[str, Any]) -> None:
    _check_types("", data, _TYPES)
    for key, types in (("entries", _ENTRY_TYPES), ("failed", {**_ENTRY_TYPES, "reason": str})):
        require_count(key, len(data[key]), _MOST_ENTRIES)
        for i, entry in enumerate(data[key]):
            if not isinstance(entry, dict) or set(entry) != set(types) or entry["kind"] not in KINDS:
                raise ValueError(f"an entry must have {', '.join(sorted(types))}, its kind one of {', '.join(KINDS)}")
            _check_types(f"{key}[{i}].", entry, types)
            # It goes into tables and pages as it is.
            check_name("the entry's name", entry["name"])
    check_rows((*data["entries"], *data["failed"]))
    if data["metrics"] != {name: asdict(metric) for name, metric in metrics.METRICS.items()}:
        raise ValueError("the metrics are not those of this version; evaluate again")
    if set(data["environment"]) != {"fingerprint", "id"} or "wtg_gym" not in dict(data["versions"]):
        raise ValueError("environment must have fingerprint and id, versions that of wtg_gym")
    require_count("seeds", len(data["seeds"]), MOST_SCENARIOS)
    allowed = get_suite(data["suite"]).seeds(data["split"])
    if not data["seeds"] or any(type(seed) is not int or seed not in allowed for seed in data["seeds"]):
        raise ValueError(f"seeds must be some of the split {data['split']!r}, {allowed.start} … {allowed.stop - 1}")
