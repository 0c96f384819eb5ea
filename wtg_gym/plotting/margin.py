"""Where control decides: cost and bad runs over the reserve margin of the scenarios."""

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.evaluation import Results, score, statistics, summary
from wtg_gym.plotting import style
from wtg_gym.scenarios import get_suite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Margin, J + J0 and whether the run is bad, of each scenario, (n_scenarios,) each.
OverMargin = tuple[statistics.Floats, statistics.Floats, statistics.Floats]
#: Edges of the bins [-]; the last one holds all beyond.
EDGES = (-0.10, -0.05, 0.0, 0.05, 0.10, 0.15, 0.20, 0.30, 0.50)


def by_entry(results: Results) -> dict[str, OverMargin]:
    """Return margin, J + J0 and whether the run is bad of each scenario, by entry, of the first training seed."""
    offsets, nominal_hz = score.cost_offsets(results.groups, results.task), get_suite(results.suite).nominal_hz
    over_margin = {}
    for name, runs in results.runs.items():
        margins, costs = (np.array([row.metrics[key] for row in runs[0]]) for key in ("reserve_margin", "cost"))
        over_margin[name] = margins, costs + offsets, summary.lost_or_beyond(runs[:1], nominal_hz)[0]
    return over_margin


@style.printed
def plot_over_margin(entries: Mapping[str, OverMargin], hundred: str, *, stacked: bool = False) -> "Figure":
    """Draw cost relative to the law that scores 100, and the share of bad runs, over the reserve margin.

    The panels stand side by side, or `stacked` in a single column.
    """
    figure = style.new_figure(*((style.SINGLE_COLUMN_MM, 120.0) if stacked else (style.DOUBLE_COLUMN_MM, 70.0)))
    looks = style.strategy_looks(entries)
    panels = figure.subplots(*((2, 1) if stacked else (1, 2)))
    style.letter_panel(panels[0], "a", "(J + J0) over that of the law at 100 [-]")
    style.letter_panel(panels[1], "b", "runs lost or beyond 0.8 Hz [%]")
    for name, (margins, costs, bad) in entries.items():
        ratios, shares, middles = [], [], []
        for low, high in itertools.pairwise(EDGES):
            chosen = (margins >= low) & (margins < high)
            if chosen.any():
                middles.append(100.0 * float(margins[chosen].mean()))
                ratios.append(float(np.exp(np.log(costs[chosen] / entries[hundred][1][chosen]).mean())))
                shares.append(100.0 * float(bad[chosen].mean()))
        for axes, values in zip(panels, (ratios, shares), strict=True):
            axes.plot(middles, values, color=looks[name].colour, linestyle=looks[name].dashes, label=name, marker=".")
    panels[0].set_yscale("log")
    largest = max(5.0, panels[0].get_ylim()[1])
    ticks = [tick for tick in (0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0) if tick <= largest]
    panels[0].set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panels[0].minorticks_off()
    for axes in panels:
        for edge in (0.0, 10.0):
            axes.axvline(edge, color="0.8", linewidth=0.8, zorder=0)
        axes.set_xlabel("reserve margin [% of the load]")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2 if stacked else len(entries)
    )
    return figure
