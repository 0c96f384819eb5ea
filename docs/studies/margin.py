"""Where control decides: cost and bad runs of entries over the reserve margin of validation scenarios.

    python docs/studies/margin.py [--output DOCS]

draws DOCS/images/margin.svg and puts the table of the strata into DOCS/benchmark.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from output import folder as output_folder

from wtg_gym.evaluation import Results, evaluate
from wtg_gym.evaluation.summary import lost_or_beyond, runs_by_name
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.plotting import save_figure, style
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
#: Laws, and the policies whose first training seed is shown, if they are shipped.
ENTRIES = ("deloaded-10", "coordinated-piecewise", "coordinated-tuned", "coordinated-free", "ppo-v1-0")
#: Edges of the bins [-]; the last one holds all beyond.
EDGES = (-0.10, -0.05, 0.0, 0.05, 0.10, 0.15, 0.20, 0.30, 0.50)


def by_entry(results: Results) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return margin, J + J0 and whether the run is bad of each scenario, by entry, of the first training seed."""
    suite = get_suite(SUITE)
    offsets = np.array([suite.task.cost_offsets[suite.stratum(seed)] for seed in results.seeds])
    found = {}
    for name, runs in runs_by_name(results.episodes).items():
        margins, costs = (np.array([row.metrics[key] for row in runs[0]]) for key in ("reserve_margin", "cost"))
        found[name] = margins, costs + offsets, lost_or_beyond(runs[:1], suite.nominal_hz)[0]
    return found


@style.printed
def plot_over_margin(entries: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]], hundred: str) -> Figure:
    """Draw cost relative to the law that scores 100, and the share of bad runs, over the reserve margin."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 70.0)
    looks = style.strategy_looks(entries)
    panels = figure.subplots(1, 2)
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
    panels[0].set_yticks([0.7, 1.0, 1.5, 2.0, 3.0, 5.0], ["0.7", "1", "1.5", "2", "3", "5"])
    panels[0].minorticks_off()
    for axes in panels:
        for edge in (0.0, 10.0):
            axes.axvline(edge, color="0.8", linewidth=0.8, zorder=0)
        axes.set_xlabel("reserve margin [% of the load]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(entries))
    return figure


def strata(entries: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]], seeds: list[int], hundred: str) -> str:
    """Return a row per stratum: its margins, J0, and median cost and bad runs of the law that scores 100."""
    suite = get_suite(SUITE)
    _, costs, bad = entries[hundred]
    rows = []
    for name, (low, high) in suite.margins.items():
        chosen = np.array([suite.stratum(seed) == name for seed in seeds])
        offset = suite.task.cost_offsets[name]
        upper = f"… {100.0 * high:.0f} %" if np.isfinite(high) else "% and more"
        median = float(np.median(costs[chosen])) - offset
        kinds = ", ".join(kind.name.rpartition("/")[2] for kind in suite.drawn_from[name])
        share = f"{100.0 * float(bad[chosen].mean()):.0f} %"
        rows.append([name, f"{100.0 * low:.0f} {upper}", kinds, f"{offset:g}", f"{median:.0f}", share])
    return markdown_table(("stratum", "reserve margin", "kinds of event", "J0", "median cost", "bad runs"), rows)


def main() -> None:
    docs = output_folder(__doc__)
    suite = get_suite(SUITE)
    results = evaluate(list(ENTRIES), SUITE, "validation")
    entries = by_entry(results)
    save_figure(plot_over_margin(entries, suite.task.hundred), docs / "images/margin", ["svg"])
    table = strata(entries, list(results.seeds), suite.task.hundred)
    update_between_markers(docs / "benchmark.md", table, "strata")


if __name__ == "__main__":
    main()
