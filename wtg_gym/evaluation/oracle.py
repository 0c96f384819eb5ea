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

from wtg_gym.evaluation.results_file import read_pair, write_pair

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
        for name, costs in {"reference": self.reference, **self.found}.items():
            if len(costs) != len(self.seeds) or not all(math.isfinite(cost) and cost >= 0.0 for cost in costs):
                raise ValueError(f"{name} must have one cost per scenario, finite and not negative, got {costs}")

    @property
    def oracle(self) -> tuple[float, ...]:
        """The least cost of each scenario, the reference's included."""
        return tuple(min(costs) for costs in zip(self.reference, *self.found.values(), strict=True))

    def write(self, folder: str | Path) -> tuple[Path, Path]:
        """Write `<suite>-<split>.json` and `.csv`, both or none, and return their paths; an OSError names the file."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(COLUMNS)
        columns = [self.reference, *(self.found.get(form) for form in FORMS), self.oracle]
        for i, seed in enumerate(self.seeds):
            writer.writerow([seed, *("" if column is None else repr(float(column[i])) for column in columns)])
        data = {"format": FORMAT, **{key: getattr(self, key) for key in _DESCRIBED}}
        return write_pair(Path(folder) / f"{self.suite}-{self.split}", data, buffer.getvalue())

    @classmethod
    def read(cls, path: str | Path) -> OracleCosts:
        """Read the files of :meth:`write`; the CSV lies beside the JSON.

        Args:
            path: the JSON file.

        Raises:
            ValueError: a file is missing, cut short, of another version, or was edited; the message names the file.
        """
        data, table, csv_path = read_pair(Path(path), "oracle", (FORMAT,))
        try:
            rows = list(csv.DictReader(io.StringIO(table)))
            costs = {
                name: tuple(float(row[name]) for row in rows) for name in COLUMNS[1:] if all(row[name] for row in rows)
            }
            found = cls(
                **{key: data[key] for key in _DESCRIBED},
                seeds=tuple(int(row["seed"]) for row in rows),
                reference=costs["reference"],
                found={form: costs[form] for form in FORMS if form in costs},
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{csv_path} is no table of the oracle: {error}") from error
        return found


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
    if known.suite_hash != suite_hash:
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
