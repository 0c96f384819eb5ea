"""For docs/benchmark.md: cost and bad runs over the reserve margin, and the table of the strata."""

from collections.abc import Mapping

import numpy as np
from output import DOCS

from wtg_gym.evaluation import evaluate
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.plotting import save_figure
from wtg_gym.plotting.report import over_margin, plot_over_margin
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
#: Laws, and the policies whose first training seed is shown, if they are shipped.
ENTRIES = ("deloaded-10", "coordinated-piecewise", "coordinated-tuned", "coordinated-free", "evolution-v1-2")


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
        events = ", ".join(draw.name.rpartition("/")[2] for draw in suite.drawn_from[name])
        values = f"{offset:g}", f"{median:.0f}", f"{100.0 * float(bad[chosen].mean()):.0f} %"
        rows.append([name, f"{100.0 * low:.0f} {upper}", events, *values])
    return markdown_table(("stratum", "reserve margin", "kinds of event", "J0", "median cost", "bad runs"), rows)


if __name__ == "__main__":
    suite = get_suite(SUITE)
    results = evaluate(list(ENTRIES), SUITE, "validation")
    entries = over_margin(results)
    save_figure(plot_over_margin(entries, suite.task.hundred), DOCS / "images/margin.svg")
    table = strata(entries, list(results.seeds), suite.task.hundred)
    update_between_markers(DOCS / "benchmark.md", table, "strata")
