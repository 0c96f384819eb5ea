"""Tables and sentences of a benchmark, for terminal and page alike."""

from __future__ import annotations

from collections.abc import Sequence
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
        return [*describe_growth(results.growth), growth_table(results.growth)] if results.growth else []
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
        ("case", "environments", "steps per s", f"× {YARDSTICK}"),
        [
            (
                rate.case.name,
                str(rate.case.n_envs),
                f"{rate.per_s:,.0f}",
                f"{results.ratio(rate):{'.2f' if results.ratio(rate) >= 0.1 else '.2g'}}",
            )
            for rate in rates
        ],
    )


def growth_table(curves: Sequence[Curve]) -> Table:
    """Return every curve's points."""
    return Table(
        ("what grows", "number", "time per step [µs]", "× the first", "compiling [s]", "memory per lane [kB]"),
        [
            (
                curve.name,
                str(point.n),
                f"{point.microseconds:.3g}",
                f"{point.microseconds / curve.points[0].microseconds:.3g}",
                f"{point.compile_s:.0f}" if point.compile_s else "–",
                f"{1e-3 * point.bytes_per_lane:.1f}",
            )
            for curve in curves
            for point in curve.points
        ],
    )


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
    """Return the machine's ceilings."""
    rows = [(f"peak, {c.name}", str(c.threads), f"{c.giga_per_s:.1f} Gflop/s") for c in roofline.peaks]
    rows += [(f"bandwidth, {c.name}", str(c.threads), f"{c.giga_per_s:.1f} GB/s") for c in roofline.bandwidths]
    return Table(("ceiling of this machine", "threads", "measured"), list(rows))


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
        f"As written, a step makes {roofline.cache_intensity:.2f} flop for every byte between rows and registers, and "
        f"{roofline.memory_intensity:.1f} for every byte of a lane's {1e-3 * roofline.row_bytes:.1f} kB of rows, read "
        f"and written once a step. On one thread the first cache can feed {cache:.0f} Gflop/s of that, memory "
        f"{memory:.0f}, and the arithmetic itself ends at {peak:.0f}. Of the lowest of these roofs the batch reaches "
        f"{100.0 * batch.gflop_per_s / roof:.0f} %, the single environment {100.0 * single.gflop_per_s / roof:.0f} %."
    )
