"""The oracle: the lowest cost known for each scenario, found with foresight and frozen in files of the package.

Two files for a split of a suite: `<suite>-<split>.csv` has a row per scenario, `<suite>-<split>.json` describes the
search. All costs are pinned ones, see :mod:`wtg_gym.evaluation.score`.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wtg_gym.files import parse_json, read_text, sha256, to_json, write_together

#: Version of the files; another number is another form.
FORMAT = 1
#: Where the frozen files lie.
FOLDER = Path(__file__).parent / "oracle_costs"
#: Columns of the table: the reference's cost, the lowest cost that each form of search found, that of the cheapest
#: entry (empty: there was no such search or entry), and the lowest of them all, the oracle's.
FORMS = ("course", "course_and_feedback", "entries")
COLUMNS = ("seed", "reference", *FORMS, "oracle")
#: How far the reference's costs may be from those that the oracle was found beside, relative: other processors round
#: otherwise.
REFERENCE_TOLERANCE = 1e-6
#: Keys of the description that are arguments of :class:`OracleCosts`.
_DESCRIBED = ("suite", "split", "suite_hash", "source_hash", "settings", "search", "entries")


@dataclass(frozen=True, kw_only=True)
class OracleCosts:
    """The lowest costs that are known of some scenarios of a split.

    Raises:
        ValueError: seeds are not different, or a cost is missing, negative or not finite.
    """

    #: suite, split: which scenarios.
    suite: str
    split: str
    suite_hash: str
    source_hash: str  # hash of the physics and environment that were searched
    settings: Mapping[str, Any]  # of the environment, as in :class:`wtg_gym.evaluation.Results`
    search: Mapping[str, Any]  # options of the search
    entries: Sequence[Mapping[str, Any]]  # name, training seed and sha256 of the entries that were tried as well
    seeds: tuple[int, ...]  # of the scenarios
    reference: tuple[float, ...]  # the reference's costs, one per seed
    #: Costs by the name of the form, see :data:`FORMS`, one per seed; a form not tried is left out.
    found: Mapping[str, tuple[float, ...]]

    def __post_init__(self) -> None:
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"an oracle needs scenarios, each once; got {len(self.seeds)} seeds")
        unknown = sorted(set(self.found) - set(FORMS))
        if unknown:
            raise ValueError(f"unknown forms {unknown}; known forms: {', '.join(FORMS)}")
        for name, costs in {"reference": self.reference, **self.found}.items():
            if len(costs) != len(self.seeds):
                raise ValueError(f"{name} must have one cost per scenario ({len(self.seeds)}), got {len(costs)}")
            wrong = [cost for cost in costs if not (math.isfinite(cost) and cost >= 0.0)]
            if wrong:
                raise ValueError(f"costs must be finite and not negative, got {wrong[0]} in {name}")

    @property
    def oracle(self) -> tuple[float, ...]:
        """The least cost of each scenario, the reference's included."""
        return tuple(min(costs) for costs in zip(self.reference, *self.found.values(), strict=True))

    def write(self, folder: str | Path) -> tuple[Path, Path]:
        """Write `<suite>-<split>.csv` and `.json`, both or none; the same costs give the same bytes.

        Returns:
            the paths of the JSON and the CSV.

        Raises:
            OSError: a file cannot be written; the old ones are still there.
        """
        json_path, csv_path = (Path(folder) / f"{self.suite}-{self.split}.{ending}" for ending in ("json", "csv"))
        table = self._to_csv()
        data = {
            "format": FORMAT,
            **{key: getattr(self, key) for key in _DESCRIBED},
            "csv_sha256": sha256(table.encode()),
        }
        data["sha256"] = sha256(to_json(data).encode())
        # The JSON last, so that it never describes a table that is not there yet.
        write_together({csv_path: table, json_path: to_json(data)})
        return json_path, csv_path

    def _to_csv(self) -> str:
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(COLUMNS)
        for i, (seed, reference, oracle) in enumerate(zip(self.seeds, self.reference, self.oracle, strict=True)):
            forms = [repr(float(self.found[form][i])) if form in self.found else "" for form in FORMS]
            writer.writerow([str(seed), repr(float(reference)), *forms, repr(float(oracle))])
        return buffer.getvalue()

    @classmethod
    def read(cls, path: str | Path) -> OracleCosts:
        """Read the files of :meth:`write`; the CSV lies beside the JSON.

        Args:
            path: the JSON file.

        Raises:
            ValueError: a file is missing, cut short, of another version, or was edited; the message names the file.
        """
        json_path, csv_path = Path(path), Path(path).with_suffix(".csv")
        text = read_text(json_path, "description of the oracle")
        data = parse_json(text, f"the description of the oracle {json_path}")
        keys = {"format", *_DESCRIBED, "csv_sha256", "sha256"}
        if not isinstance(data, dict) or set(data) != keys:
            got = sorted(data) if isinstance(data, dict) else type(data).__name__
            raise ValueError(f"{json_path}: expected an object with the keys {', '.join(sorted(keys))}, got {got}")
        if data["format"] != FORMAT:
            raise ValueError(f"{json_path}: format must be {FORMAT}, that of this version, got {data['format']}")
        content = {key: value for key, value in data.items() if key != "sha256"}
        if sha256(to_json(content).encode()) != data["sha256"] or to_json(data) != text:
            raise ValueError(f"{json_path} was edited or damaged: its sha256 does not fit its content; search again")
        table = read_text(csv_path, "table of the oracle")
        if sha256(table.encode()) != data["csv_sha256"]:
            raise ValueError(f"{csv_path} is not the table that {json_path} describes: it was edited; search again")
        try:
            seeds, columns = _from_csv(table)
            forms = {form: columns[form] for form in FORMS if not all(map(math.isnan, columns[form]))}
            described = {key: data[key] for key in _DESCRIBED}
            costs = cls(**described, seeds=seeds, reference=columns["reference"], found=forms)
            if costs.oracle != columns["oracle"]:
                raise ValueError("the oracle's costs are not the least of each row")
        except ValueError as error:
            raise ValueError(f"{csv_path}: {error}") from error
        return costs


def _from_csv(table: str) -> tuple[tuple[int, ...], dict[str, tuple[float, ...]]]:
    """Return the seeds and the columns of costs; an empty cell is NaN."""
    try:
        header, *rows = csv.reader(io.StringIO(table), strict=True)
    except csv.Error as error:
        raise ValueError(f"not CSV with a header: {error}") from error
    if tuple(header) != COLUMNS:
        raise ValueError(f"the header must be {','.join(COLUMNS)}, got {','.join(header)}")
    seeds: list[int] = []
    costs: list[list[float]] = []
    for line, row in enumerate(rows, start=2):
        try:
            seeds.append(int(row[0]))
            costs.append([float(cell) if cell else math.nan for cell in row[1:]])
            if len(row) != len(COLUMNS):
                raise ValueError(f"{len(row)} cells")
        except (ValueError, IndexError) as error:
            raise ValueError(f"line {line}: expected a seed and {len(COLUMNS) - 1} costs: {error}") from error
    columns = zip(*costs, strict=True) if costs else ((),) * (len(COLUMNS) - 1)
    return tuple(seeds), dict(zip(COLUMNS[1:], columns, strict=True))


@dataclass(frozen=True, kw_only=True)
class KnownOracle:
    """The oracle's costs of an evaluation's scenarios."""

    costs: Mapping[int, float]  # by the scenarios' seeds; a scenario without an oracle is left out
    missing: str  # why there are none; empty where there are some


def known_oracle(
    suite: str, split: str, suite_hash: str, settings: Mapping[str, Any], reference: Mapping[int, float]
) -> KnownOracle:
    """Return the oracle of an evaluation's scenarios, if it was found for the same problem.

    Args:
        suite, split, suite_hash, settings: of the evaluation.
        reference: the reference's pinned costs in it, by the scenarios' seeds. They show whether physics and cost are
            still those that were searched.
    """
    try:
        return KnownOracle(costs=_oracle_of(suite, split, suite_hash, settings, reference), missing="")
    except ValueError as error:
        return KnownOracle(costs={}, missing=str(error))


def _oracle_of(
    suite: str, split: str, suite_hash: str, settings: Mapping[str, Any], reference: Mapping[int, float]
) -> dict[int, float]:
    path = FOLDER / f"{suite}-{split}.json"
    if not path.exists():
        raise ValueError(f"there is no oracle for the {split} scenarios of {suite}")
    known = OracleCosts.read(path)
    if (known.suite, known.split, known.suite_hash) != (suite, split, suite_hash):
        raise ValueError(f"the oracle in {path.name} is of another suite, of hash {known.suite_hash[:12]}")
    if known.settings != settings:
        different = sorted(key for key in settings if known.settings.get(key) != settings[key])
        raise ValueError(f"the oracle was found for other settings: {', '.join(different)}")
    shared = [row for row in zip(known.seeds, known.reference, known.oracle, strict=True) if row[0] in reference]
    if not shared:
        raise ValueError("none of these scenarios has an oracle")
    for seed, cost, _ in shared:
        if not math.isclose(cost, reference[seed], rel_tol=REFERENCE_TOLERANCE):
            raise ValueError(
                f"the oracle was found for another physics or cost: in the scenario of seed {seed} the reference cost "
                f"{cost:.6g}, now {reference[seed]:.6g}"
            )
    return {seed: oracle for seed, _, oracle in shared}
