"""An episode up to now, and the panels that show its quantities."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Event
from wtg_gym.physics.tracking_law import coordinated_piecewise

Floats = npt.NDArray[np.float64]
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Episode:
    """An episode up to now.

    Args:
        env_id: id of the environment.
        heading: which episode it is.
        duration_s: length of the episode if nothing ends it before [s].
        time_s: instants of the samples so far, at least one (n,) [s].
        panels: what is shown; as many as :data:`PANELS`.
        traces: the panels' quantities then, in their order with one column per WTG group where `per_group`; after them
            what sensors measure, a column per WTG group for each of :data:`MEASURED` (n, n_traces); not a number where
            there is none.
        events: of the whole episode; those to come are not shown.
        group_buses: bus of each WTG group.
        total_reward: sum of the rewards so far.
        n_violated: number of steps so far that violated a constraint.
        outcome: why the episode is over, empty while it runs.
        failed: whether that is a failure.
        note: a last line in words.
    """

    env_id: str
    heading: str
    duration_s: float
    time_s: Floats
    panels: tuple[Panel, ...]
    traces: Floats
    events: tuple[Event, ...]
    group_buses: tuple[int, ...]
    total_reward: float
    n_violated: int
    outcome: str
    failed: bool
    note: str


class Panel(NamedTuple):
    """One quantity over time.

    Args:
        name: short name.
        title: text above it, with the unit.
        per_group: whether every WTG group has a line of its own.
        ranges: of its axis, each within the next; the first that holds all values so far is shown.
        rules: values with a dashed line.
        band: a shaded range of values.
        limits: beyond which a run fails, or that converters keep; with a coloured line.
    """

    name: str
    title: str
    per_group: bool
    ranges: tuple[Range, ...]
    rules: tuple[float, ...] = ()
    band: Range | None = None
    limits: tuple[float, ...] = ()


def _panels() -> tuple[Panel, ...]:
    nominal = modified_ieee14().frequency_hz
    control, law = GridFormingParameters(), coordinated_piecewise()
    ratios = tracking_point().tip_speed_ratio, tracking_point(control.deloading_limit).tip_speed_ratio
    around = tuple((nominal - d, nominal + d) for d in (0.25, 0.5, 1.0, 2.5))
    # Beyond ±0.2 Hz the deviation costs four times as much.
    limits, band = (nominal - 0.2, nominal + 0.2), (0.9 * ratios[0], 1.1 * ratios[1])
    coefficients = law.k_min, law.k_nominal, law.k_max
    return (
        Panel("frequency", "frequency [Hz]", False, around, limits),
        Panel("rocof", "RoCoF [Hz/s]", False, ((-0.3, 0.3), (-0.6, 0.6), (-2.0, 2.0), (-10.0, 10.0))),
        Panel("rotor", "rotor speed [p.u.]", True, ((0.5, 1.3), (0.2, 1.4), (0.0, 2.0))),
        Panel("ratio", "tip-speed ratio [–]", True, ((5.0, 13.0), (2.0, 14.0), (0.0, 20.0)), band=band),
        Panel("power", "power [p.u.]", True, ((0.0, 1.3), (-0.2, 1.4), (-1.0, 2.0)), (control.overload_limit_pu,)),
        Panel("k", "k [p.u.]", True, ((0.2, 1.3), (0.0, 3.0)), coefficients),
        Panel("tau", "τ [s]", True, ((0.0, 3.4), (0.0, 14.0), (0.0, 60.0))),
        Panel("wind", "wind speed [m/s]", True, ((4.0, 16.0), (2.0, 26.0))),
    )


#: From top to bottom, first the left column.
PANELS = _panels()
#: Panels with the quantities that sensors measure, in the order of
#: :class:`~wtg_gym.envs.observation.MeasuredObservation`.
MEASURED = ("frequency", "rocof", "ratio", "rotor", "power", "wind")


def limited_panels(plant: PlantSettings, *, wind_sensor: bool) -> tuple[Panel, ...]:
    """Return :data:`PANELS` with the limits of a plant, and with words where the wind is not measured."""
    protection, nominal = plant.protection, plant.case.frequency_hz
    low, high = nominal * protection.frequency_min_pu, nominal * protection.frequency_max_pu
    of_power = () if plant.limits is None else (plant.limits.power_max_pu,)
    unseen = "" if wind_sensor else ", not measured"
    frequency, _, rotor, ratio, *_, wind = PANELS
    changed: dict[str, dict[str, Any]] = {
        "frequency": {"ranges": (*frequency.ranges[:-1], (low - 0.25, high + 0.25)), "limits": (low, high)},
        # The least speed is not to hide in the axis.
        "rotor": {
            "ranges": ((0.4, 1.3), *rotor.ranges[1:]),
            "limits": (protection.rotor_speed_min_pu, protection.over_speed_pu),
        },
        "ratio": {"title": ratio.title + unseen, "limits": (protection.stall_tip_speed_ratio,)},
        "power": {"rules": (plant.control.overload_limit_pu,), "limits": of_power},
        "wind": {"title": wind.title + unseen},
    }
    return tuple(panel._replace(**changed.get(panel.name, {})) for panel in PANELS)


def n_traces(n_groups: int) -> int:
    """Return the number of lines of all panels together, without those of sensors."""
    return sum(n_groups if panel.per_group else 1 for panel in PANELS)


@functools.cache
def panels_of_traces(n_groups: int, *, measured: bool) -> npt.NDArray[np.int64]:
    """Return the index of the panel of every trace (n_traces,)."""
    names = [panel.name for panel in PANELS]
    owners = np.repeat(np.arange(len(PANELS)), [n_groups if panel.per_group else 1 for panel in PANELS])
    seen = np.repeat([names.index(name) for name in MEASURED], n_groups)
    return np.concatenate([owners, seen]) if measured else owners


def fitting_levels(episode: Episode) -> tuple[int, ...]:
    """Return which of its ranges each panel shows: the first that holds all values so far, else the last."""
    n_groups = len(episode.group_buses)
    owners = panels_of_traces(n_groups, measured=episode.traces.shape[1] > n_traces(n_groups))
    # fmin and fmax pass over what is not a number.
    lows = np.fmin.reduce(episode.traces, axis=0)
    highs = np.fmax.reduce(episode.traces, axis=0)
    levels = []
    for index, panel in enumerate(episode.panels):
        low, high = np.fmin.reduce(lows[owners == index]), np.fmax.reduce(highs[owners == index])
        wide = [not (low < bottom or high > top) for bottom, top in panel.ranges]
        levels.append(wide.index(True) if True in wide else len(wide) - 1)
    return tuple(levels)
