"""The matrix of generalisation: scores of entries on every suite, and with other sensors than they were trained for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

from wtg_gym import files
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.statistics import Interval
from wtg_gym.evaluation.summary import worst_decile
from wtg_gym.scenarios import SUITES, get_suite
from wtg_gym.scenarios.benchmark import Benchmark
from wtg_gym.scenarios.sensor_distribution import DELAY_STEP_S, SensorDistribution

#: Values of the sensors in place of a suite's own.
Changes = Mapping[str, Any]


def _later(steps: int) -> Callable[[SensorDistribution], Changes]:
    return lambda own: {"delay_s": tuple(round(delay + steps * DELAY_STEP_S, 9) for delay in own.delay_s)}


#: Other sensors that entries are played with: the name of the folder of results, and the change of the suite's sensors.
PERTURBATIONS: Mapping[str, Callable[[SensorDistribution], Changes]] = MappingProxyType(
    {
        "delay-plus-1": _later(1),
        "delay-plus-2": _later(2),
        "wind-bias-times-2": lambda own: {"wind_bias": 2.0 * own.wind_bias},
    }
)
#: Why one scale does for a suite and for its perturbed sensors.
SCALE = "Sensors do not affect the laws that score 0 and 100: with changed sensors the scale remains that of the suite."


@dataclass(frozen=True, kw_only=True)
class Column:
    """The scenarios of a column."""

    #: The suite without its version, the split where columns differ in it and it is not the test one, and how the
    #: sensors are changed.
    heading: str
    #: suite, split: of the results.
    suite: str
    split: str
    n_scenarios: int  # how many
    change: str  # how the sensors are changed, empty where they are the suite's own


@dataclass(frozen=True, kw_only=True)
class Cell:
    """An entry in a column."""

    score: Interval | None  # mean score with its interval; None where the scenarios have no scale
    worst_decile_cost: float  # mean pinned cost of the worst tenth of the scenarios [-]


@dataclass(frozen=True, kw_only=True)
class Row:
    """An entry in all columns."""

    #: name, kind, n_runs: of the entry, as in :class:`~wtg_gym.evaluation.summary.EntrySummary`.
    name: str
    kind: str
    n_runs: int
    cells: tuple[Cell | None, ...]  # one per column; None where the results do not hold the entry

    @property
    def label(self) -> str:
        """The name, and the number of training seeds where there are several."""
        return self.name if self.n_runs == 1 else f"{self.name} ({self.n_runs} seeds)"


@dataclass(frozen=True, kw_only=True)
class Matrix:
    """Scores of entries in several sets of scenarios of one version."""

    benchmark: Benchmark
    columns: tuple[Column, ...]  # the sets of scenarios, those with changed sensors last
    rows: tuple[Row, ...]  # the entries, the best in the first column first

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON-ready data."""
        return {
            "version": self.benchmark.version,
            "columns": [asdict(column) for column in self.columns],
            "rows": [asdict(row) for row in self.rows],
        }

    def header(self) -> list[str]:
        """Return the headings of the tables."""
        return ["entry", *(column.heading for column in self.columns)]

    def texts(self, text: Callable[[Cell], str]) -> list[list[str]]:
        """Return a table, the entries' names and the text of each cell; a cell without results is empty."""
        return [[row.label, *("" if cell is None else text(cell) for cell in row.cells)] for row in self.rows]

    def page(self) -> str:
        """Return scenarios and scores as Markdown, without a line feed at the end."""
        scores = files.markdown_table(self.header(), self.texts(score_text), right=range(1, 1 + len(self.columns)))
        return f"Scores on {self.describe()}\n\n{scores}"

    def describe(self) -> str:
        """Return how many scenarios of which split the columns have, which have no scale, and what the scale is."""
        counts: dict[str, list[str]] = {}
        for column in self.columns:
            counts.setdefault(f"{column.n_scenarios} {column.split} scenarios", []).append(column.heading)
        usual = max(counts, key=lambda text: len(counts[text]))
        others = [f"{text} on {', '.join(names)}" for text, names in counts.items() if text != usual]
        every = zip(self.columns, zip(*(row.cells for row in self.rows), strict=True), strict=True)
        unscored = [column.heading for column, cells in every if all(c is None or c.score is None for c in cells)]
        text = "; ".join((f"{usual} per column", *others)) + "."
        if unscored:
            zero, hundred = self.benchmark.anchors
            text += f" No score on {', '.join(unscored)}, where {hundred} (100) is no better than {zero} (0)."
        return f"{text} {SCALE}" if any(column.change for column in self.columns) else text


def score_text(cell: Cell) -> str:
    """Return a score, "" without one."""
    return "" if cell.score is None else f"{round(cell.score.value, 1) + 0.0:.1f}"


def worst_text(cell: Cell) -> str:
    """Return the cost of the worst tenth of the scenarios."""
    return f"{cell.worst_decile_cost:.0f}"


def matrix_of(results: Sequence[Results]) -> Matrix:
    """Return the matrix of results of one version, one column each.

    Args:
        results: in any order; the columns have that of the suites, with fixed cases and then changed sensors last.

    Raises:
        ValueError: no results, those of two versions, or two of the same scenarios with the same sensors.
    """
    versions = {each.benchmark.version for each in results}
    if len(versions) != 1:
        raise ValueError(f"a matrix is of one version of the benchmark, got {', '.join(sorted(versions)) or 'none'}")
    ordered = sorted(results, key=_order)
    splits = {each.split for each in results}
    columns = tuple(_column(each, with_split=len(splits) > 1) for each in ordered)
    headings = [column.heading for column in columns]
    if twice := sorted({heading for heading in headings if headings.count(heading) > 1}):
        raise ValueError(f"results of the same scenarios were given twice: {', '.join(twice)}")
    cells = [_cells(each) for each in ordered]
    entries = {data["name"]: data for each in ordered for data in each.entries}
    rows = (
        Row(
            name=name,
            kind=data["kind"],
            n_runs=max(costs[name].shape[0] for costs in (each.pinned_costs for each in ordered) if name in costs),
            cells=tuple(own.get(name) for own in cells),
        )
        for name, data in entries.items()
    )
    return Matrix(benchmark=results[0].benchmark, columns=columns, rows=tuple(sorted(rows, key=_place)))


def _order(results: Results) -> tuple[bool, bool, int]:
    """Return what columns are sorted by: changed sensors come last, before them suites of fixed cases."""
    suite = get_suite(results.suite)
    return bool(changed_sensors(results)), bool(suite.cases), list(SUITES).index(suite.name)


def _cells(results: Results) -> dict[str, Cell]:
    scores = results.scores if results.has_scale else {}
    return {
        name: Cell(score=scores.get(name), worst_decile_cost=worst_decile(costs))
        for name, costs in results.pinned_costs.items()
    }


def _place(row: Row) -> tuple[float, str]:
    """Return what rows are sorted by: the first score, the best first; those without one last."""
    first = row.cells[0]
    return (math.inf if first is None or first.score is None else -first.score.value, row.name)


def _column(results: Results, *, with_split: bool) -> Column:
    change = changed_sensors(results)
    name = results.suite.removesuffix(f"-{results.benchmark.version}")
    parts = [name, *([results.split] if with_split and results.split != "test" else []), *([change] if change else [])]
    return Column(
        heading=", ".join(parts),
        suite=results.suite,
        split=results.split,
        n_scenarios=len(results.seeds),
        change=change,
    )


def changed_sensors(results: Results) -> str:
    """Return how the sensors of results differ from the suite's own, "" where they do not."""
    own, now = get_suite(results.suite).sensors, results.settings.get("sensors")
    if own is None or now is None:
        return ""
    if now == "exact":
        return "exact sensors"
    usual = asdict(own)
    return ", ".join(
        _change(name, usual.get(name), value)
        for name, value in now.items()
        if (tuple(value) if isinstance(value, list) else value) != usual.get(name)
    )


def _change(name: str, usual: Any, value: Any) -> str:
    """Return one change in words: a shift of both ends of a range, a factor on a number, or the value itself."""
    words = name.removesuffix("_s").replace("_", " ")
    if isinstance(value, list):
        shifts = {round(new - old, 9) for new, old in zip(value, usual, strict=True)}
        return f"{words} {shifts.pop():+g} s" if len(shifts) == 1 else f"{words} {value[0]:g} … {value[1]:g} s"
    if isinstance(value, bool) or not usual:
        return f"{words} {value}"
    return f"{words} × {value / usual:g}"


def suites_of(version: str) -> list[str]:
    """Return the suites of a version of the benchmark, in their order."""
    return [name for name, suite in SUITES.items() if suite.benchmark.version == version]
