"""An episode up to now, and the panels that show its quantities."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.scenario import Event
from wtg_gym.physics.tracking_law import coordinated_piecewise

Floats = npt.NDArray[np.float64]
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Episode:
    """An episode up to now.

    Args:
        heading: which episode it is.
        duration_s: length of the episode if nothing ends it before [s].
        time_s: instants of the samples so far, at least one (n,) [s].
        traces: the panels' quantities then, in the order of :data:`PANELS` with one column per WTG group where
            `per_group` (n, n_traces); not a number where there is none.
        events: of the whole episode; those to come are not shown.
        group_buses: bus of each WTG group.
        total_reward: sum of the rewards so far.
        n_violated: number of steps so far that violated a constraint.
        outcome: why the episode is over, empty while it runs.
        failed: whether that is a failure.
    """

    heading: str
    duration_s: float
    time_s: Floats
    traces: Floats
    events: tuple[Event, ...]
    group_buses: tuple[int, ...]
    total_reward: float
    n_violated: int
    outcome: str
    failed: bool


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One quantity over time.

    Args:
        name: short name.
        title: text above it, with the unit.
        per_group: whether every WTG group has a line of its own.
        ranges: of its axis, each within the next; the first that holds all values so far is shown.
        rules: values with a dashed line.
        band: a shaded range of values.
    """

    name: str
    title: str
    per_group: bool
    ranges: tuple[Range, ...]
    rules: tuple[float, ...] = ()
    band: Range | None = None


def _panels() -> tuple[Panel, ...]:
    nominal = modified_ieee14().frequency_hz
    control, law = GridFormingParameters(), coordinated_piecewise()
    ratios = tracking_point().tip_speed_ratio, tracking_point(control.deloading_limit).tip_speed_ratio
    around = [(nominal - d, nominal + d) for d in (0.25, 0.5, 1.0)]
    return (
        Panel(
            name="frequency",
            title="frequency [Hz]",
            per_group=False,
            ranges=(*around, (nominal - 2.5, nominal + 2.5)),
            # Beyond it the deviation costs four times as much.
            rules=(nominal - 0.2, nominal + 0.2),
        ),
        Panel(
            name="rocof",
            title="RoCoF [Hz/s]",
            per_group=False,
            ranges=((-0.3, 0.3), (-0.6, 0.6), (-2.0, 2.0), (-10.0, 10.0)),
        ),
        Panel(name="rotor", title="rotor speed [p.u.]", per_group=True, ranges=((0.5, 1.3), (0.2, 1.4), (0.0, 2.0))),
        Panel(
            name="ratio",
            title="tip-speed ratio [–]",
            per_group=True,
            ranges=((5.0, 13.0), (2.0, 14.0), (0.0, 20.0)),
            band=(0.9 * ratios[0], 1.1 * ratios[1]),
        ),
        Panel(
            name="power",
            title="power [p.u.]",
            per_group=True,
            ranges=((0.0, 1.3), (-0.2, 1.4), (-1.0, 2.0)),
            rules=(control.overload_limit_pu,),
        ),
        Panel(
            name="k",
            title="k [p.u.]",
            per_group=True,
            ranges=((0.2, 1.3), (0.0, 3.0)),
            rules=(law.k_min, law.k_nominal, law.k_max),
        ),
        Panel(
            name="tau",
            title="τ [s]",
            per_group=True,
            ranges=((0.0, 3.4), (0.0, 14.0), (0.0, 60.0)),
        ),
        Panel(name="wind", title="wind speed [m/s]", per_group=True, ranges=((4.0, 16.0), (2.0, 26.0))),
    )


#: From top to bottom, first the left column.
PANELS = _panels()


def n_traces(n_groups: int) -> int:
    """Return how many lines all panels have together."""
    return sum(n_groups if panel.per_group else 1 for panel in PANELS)


@functools.cache
def panels_of_traces(n_groups: int) -> npt.NDArray[np.int64]:
    """Return the index of the panel of every trace (n_traces,)."""
    return np.repeat(np.arange(len(PANELS)), [n_groups if panel.per_group else 1 for panel in PANELS])


def fitting_levels(episode: Episode) -> tuple[int, ...]:
    """Return which of its ranges each panel shows: the first that holds all values so far, else the last."""
    owners = panels_of_traces(len(episode.group_buses))
    # fmin and fmax pass over what is not a number.
    lows = np.fmin.reduce(episode.traces, axis=0)
    highs = np.fmax.reduce(episode.traces, axis=0)
    levels = []
    for index, panel in enumerate(PANELS):
        low, high = np.fmin.reduce(lows[owners == index]), np.fmax.reduce(highs[owners == index])
        wide = [not (low < bottom or high > top) for bottom, top in panel.ranges]
        levels.append(wide.index(True) if True in wide else len(wide) - 1)
    return tuple(levels)
