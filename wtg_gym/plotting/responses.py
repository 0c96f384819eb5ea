"""Responses of a policy: its k and τ over the quantities that it sees, beside the reference's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.evaluation.recording import Recording
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.plotting.policy_runs import K_OPT, Quantity, draw_legend, scale_time_constant
from wtg_gym.plotting.style import DOUBLE_COLUMN_MM, GROUP_STYLES, Look, new_figure, printed, strategy_looks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: Share of the samples drawn, from the middle, and of those in a bin that lie within its band.
_DRAWN, _BAND = 0.98, 0.8
_N_BINS = 24
#: Fewer samples of a bin are not drawn: neighbours in time are alike.
_LEAST_SAMPLES = 60
#: Groups are drawn apart where their means differ by this share of the scatter (root mean square over bins).
_GROUPS_APART = 0.25

_SEEN: dict[str, Quantity] = {
    "frequency deviation\n[Hz]": lambda run: run.deviation_hz,
    "RoCoF over 0.1 s\n[Hz/s]": lambda run: run.rocof_hz_s,
    "tip-speed ratio λ above\nits target [–]": lambda run: run.ratio_above_target,
    "rotor speed $\\omega_m$\n[p.u.]": lambda run: run.rotor_speed_pu,
    "wind speed\n[m/s]": lambda run: run.wind_m_s,
}


@dataclass(frozen=True)
class Bins:
    """A quantity over another one, in bins of equal width: centres, and quantiles of what lies in each (n_bins,)."""

    centre: Floats
    low: Floats
    median: Floats
    high: Floats


def binned(x: Floats, y: Floats, edges: Floats) -> Bins:
    """Return the quantiles 10, 50 and 90 % of y over x, not a number in bins of fewer than 60 samples.

    Args:
        x, y: samples of one shape; those that are not finite do not count.
        edges: of the bins, rising (n_bins + 1,).
    """
    finite = np.isfinite(x) & np.isfinite(y)
    place, values = np.digitize(x[finite], edges) - 1, y[finite]
    quantiles = np.full((3, edges.size - 1), np.nan)
    for i in range(edges.size - 1):
        inside = values[place == i]
        if inside.size >= _LEAST_SAMPLES:
            quantiles[:, i] = np.quantile(inside, [0.5 - 0.5 * _BAND, 0.5, 0.5 + 0.5 * _BAND])
    return Bins(0.5 * (edges[1:] + edges[:-1]), *quantiles)


@printed
def plot_responses(
    name: str, policy: Recording, reference: Recording, looks: Mapping[str, Look] | None = None
) -> Figure:
    """Draw k and τ in use over what a policy sees, with the reference's beside them.

    Lines are medians of bins, bands hold the middle 80 %; the lowest row says where the samples are. Groups are taken
    together; where the policy treats them differently, it has a median for each.
    """
    looks = looks or strategy_looks([REFERENCE_STRATEGY, name])
    runs = {REFERENCE_STRATEGY: reference, name: policy}
    used: dict[str, Quantity] = {
        "k / $K_{opt}$ [–]": lambda run: run.coefficient_pu / K_OPT,
        "added to the\nlaw's k / $K_{opt}$ [–]": lambda run: run.offset_pu / K_OPT,
        "τ [s]": lambda run: run.time_constant_s,
    }
    apart = _groups_differ(policy)
    figure = new_figure(DOUBLE_COLUMN_MM, 128.0)
    grid = figure.subplots(4, len(_SEEN), sharex="col", sharey="row", height_ratios=(1.0, 1.0, 1.0, 0.4))
    for column, (seen, x_of) in enumerate(_SEEN.items()):
        edges = _edges([x_of(run) for run in runs.values()])
        for row, (label, y_of) in enumerate(used.items()):
            axes = grid[row, column]
            for own, run in runs.items():
                _draw_bins(axes, binned(x_of(run), y_of(run), edges), looks[own], with_median=own != name or not apart)
            if apart:
                for group, style in zip(range(policy.n_wtg), GROUP_STYLES, strict=False):
                    bins = binned(x_of(policy)[:, :, group], y_of(policy)[:, :, group], edges)
                    axes.plot(bins.centre, bins.median, style, color=looks[name].colour, linewidth=1.0)
            if column == 0:
                axes.set_ylabel(label)
        for own, run in runs.items():
            counts = np.histogram(x_of(run), edges)[0] / np.isfinite(x_of(run)).sum()
            grid[3, column].stairs(100.0 * counts, edges, color=looks[own].colour, linewidth=0.9)
        grid[3, column].set_xlabel(seen)
        grid[3, column].set_xlim(edges[0], edges[-1])
    grid[3, 0].set_ylabel("samples\n[% per bin]")
    grid[3, 0].set_ylim(bottom=0.0)
    scale_time_constant(grid[2, 0], [policy.time_constant_s, reference.time_constant_s])
    figure.align_ylabels(grid[:, 0])
    # Dashes tell groups apart here, so that the legend shows colours only.
    solid = {own: Look(looks[own].colour) for own in runs}
    draw_legend(figure, runs, solid, policy.n_wtg if apart else 1)
    return figure


def _groups_differ(policy: Recording) -> bool:
    """Whether groups lie apart by a quarter of their scatter, at the same value of whatever is seen."""
    if not 1 < policy.n_wtg <= len(GROUP_STYLES):
        return False
    for y in (policy.offset_pu, np.log(policy.time_constant_s)):
        scatter = float(np.nanstd(y)) if np.isfinite(y).any() else 0.0
        # One quantity that explains the difference is enough: groups see different winds.
        least = min(_distance_of_groups(x_of(policy), y) for x_of in _SEEN.values())
        if least > _GROUPS_APART * scatter > 1e-9:
            return True
    return False


def _distance_of_groups(x: Floats, y: Floats) -> float:
    """Return the root mean square of how far the groups' mean y lie from each other at the same x.

    Args:
        x, y: samples (n_scenarios, n, n_wtg).
    """
    edges = _edges([x])
    finite = np.isfinite(x) & np.isfinite(y)
    rows = [
        (np.histogram(x[..., g][finite[..., g]], edges, weights=w)[0])
        for g in range(x.shape[2])
        for w in (None, y[..., g][finite[..., g]])
    ]
    counts, sums = np.array(rows[::2], dtype=np.float64), np.array(rows[1::2])
    counts, sums = (each[:, (counts >= _LEAST_SAMPLES).all(axis=0)] for each in (counts, sums))
    if counts.size == 0:
        return 0.0
    return float(np.sqrt(np.average((sums / counts).var(axis=0), weights=counts.sum(axis=0))))


def _edges(samples: Sequence[Floats]) -> Floats:
    values = np.concatenate([each[np.isfinite(each)] for each in samples])
    low, high = np.quantile(values, [0.5 - 0.5 * _DRAWN, 0.5 + 0.5 * _DRAWN])
    if not low < high:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, _N_BINS + 1)


def _draw_bins(axes: Axes, bins: Bins, look: Look, *, with_median: bool) -> None:
    axes.fill_between(bins.centre, bins.low, bins.high, color=look.colour, alpha=0.2, linewidth=0.0)
    if with_median:
        axes.plot(bins.centre, bins.median, color=look.colour, linewidth=1.2)
