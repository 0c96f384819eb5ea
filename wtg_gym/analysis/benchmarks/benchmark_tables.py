"""Tables and sentences of a benchmark, for terminal and page alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from wtg_gym.analysis.benchmarks.environments import YARDSTICK
from wtg_gym.analysis.benchmarks.growth import Curve, describe_growth
from wtg_gym.analysis.benchmarks.parts import Results
from wtg_gym.analysis.benchmarks.roofline import Roofline
from wtg_gym.analysis.benchmarks.timing import Rate
from wtg_gym.analysis.benchmarks.training import describe_training


class Table(NamedTuple):
    """A table: column heads with units, cells, and which columns hold text rather than numbers."""

    header: tuple[str, ...]
    rows: list[tuple[str, ...]]
    text: tuple[int, ...] = (0,)


def part_tables(part: str, results: Results) -> list[Table | str]:
    """Return a part's tables and sentences; nothing where nothing was measured."""
    if part == "growth":
        return [*describe_growth(results.growth), *growth_tables(results.growth)] if results.growth else []
    if part == "roofline":
        found = results.roofline
        if found is None:
            return []
        return [count_table(found), ceiling_table(found), achieved_table(found), describe_roofline(found)]
    rates = results.of_part(part)
    if not rates:
        return []
    return [*([describe_training() + "."] if part == "training" else []), rate_table(results, rates)]


def rate_table(results: Results, rates: Sequence[Rate]) -> Table:
    """Return rates and their ratios to the yardstick."""
    return Table(
        ("case", "steps per s", f"× {YARDSTICK}"),
        [
            (
                rate.case.name,
                f"{rate.per_s:,.0f}",
                f"{results.ratio(rate):{'.2f' if results.ratio(rate) >= 0.1 else '.2g'}}",
            )
            for rate in rates
        ],
    )


def growth_tables(curves: Sequence[Curve]) -> list[Table | str]:
    """Return the points of all curves, a row for each number: times, then compiling and memory where a plant grows."""
    points = {curve.name: {point.n: point for point in curve.points} for curve in curves}
    times = {name: {n: f"{point.microseconds:.3g}" for n, point in own.items()} for name, own in points.items()}
    plants = {name: own for name, own in points.items() if name not in ("lanes", "threads")}
    compiling = {
        f"{name}: compiling [s]": {n: f"{p.compile_s:.0f}" if p.compile_s else "–" for n, p in own.items()}
        for name, own in plants.items()
    }
    # A lane of a single environment is as large as one of a batch.
    memory = {
        f"{name}: memory [kB]": {n: f"{1e-3 * p.bytes_per_lane:.1f}" for n, p in own.items()}
        for name, own in plants.items()
        if "single" not in name
    }
    return [
        "Time per step [µs]:",
        _by_number(times),
        "Compiling, and memory of a lane:",
        _by_number(compiling | memory),
    ]


def _by_number(columns: Mapping[str, Mapping[int, str]]) -> Table:
    numbers = sorted({n for cells in columns.values() for n in cells})
    rows = [(str(n), *(cells.get(n, "") for cells in columns.values())) for n in numbers]
    return Table(("number", *columns), rows, ())


def count_table(roofline: Roofline) -> Table:
    """Return the counted operations."""
    heads = ("adds", "multiplies", "divisions", "roots", "powers", "comparisons")
    return Table(
        ("one lane, default plant", *heads, "flop", "loads", "stores"),
        [
            (
                name,
                *(f"{getattr(counts, head):,}" for head in heads),
                f"{counts.flops:,}",
                f"{counts.loads:,}",
                f"{counts.stores:,}",
            )
            for name, counts in roofline.counts.items()
        ],
    )


def ceiling_table(roofline: Roofline) -> Table:
    """Return the machine's ceilings, a column for each number of threads."""
    rows: dict[str, dict[int, str]] = {}
    for what, unit, ceilings in (("peak", "Gflop/s", roofline.peaks), ("bandwidth", "GB/s", roofline.bandwidths)):
        for each in ceilings:
            rows.setdefault(f"{what}, {each.name} [{unit}]", {})[each.threads] = f"{each.giga_per_s:.1f}"
    threads = sorted({n for cells in rows.values() for n in cells})
    return Table(
        ("ceiling of this machine", *(f"threads: {n}" for n in threads)),
        [(name, *(cells.get(n, "") for n in threads)) for name, cells in rows.items()],
    )


def achieved_table(roofline: Roofline) -> Table:
    """Return the shares of them that the environment reaches."""
    return Table(
        ("what is stepped", "threads", "steps per s", "Gflop/s", "of the vector peak", "of the fused vector peak"),
        [
            (
                row.name.split(",")[0],
                str(row.threads),
                f"{row.steps_per_s:,.0f}",
                f"{row.gflop_per_s:.2f}",
                f"{100.0 * row.share:.1f} %",
                f"{100.0 * row.fused_share:.1f} %",
            )
            for row in roofline.achieved
        ],
    )


def describe_roofline(roofline: Roofline) -> str:
    """Return the limits of a step in words, computed from the numbers."""
    peak = next(c.giga_per_s for c in roofline.peaks if c.name == "vectors" and c.threads == 1)
    cache = roofline.bandwidths[0].giga_per_s * roofline.cache_intensity
    memory = roofline.bandwidths[-1].giga_per_s * roofline.memory_intensity
    roof = min(peak, cache, memory)
    single, batch = (next(a for a in roofline.achieved if a.name.startswith(name)) for name in ("single", "batch"))
    return (
        f"A step makes {roofline.cache_intensity:.2f} flop for every byte that the source loads or stores, and "
        f"{roofline.memory_intensity:.1f} flop for every byte of a lane's rows ({1e-3 * roofline.row_bytes:.1f} kB), "
        f"read and written once. So on one thread the first cache limits it to {cache:.0f} Gflop/s, memory to "
        f"{memory:.0f}, and the vector peak to {peak:.0f}. Of the lowest of these limits the batch reaches "
        f"{100.0 * batch.gflop_per_s / roof:.0f} %, the single environment {100.0 * single.gflop_per_s / roof:.0f} %."
    )
