"""The panels of a frame: which quantity each shows, and its axis."""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.tracking_law import coordinated_piecewise

Range = tuple[float, float]


class Panel(NamedTuple):
    """One quantity over time."""

    name: str  # of the quantity
    title: str  # text above it, with the unit
    ranges: tuple[Range, ...]  # of its axis, each within the next; the first that holds all values so far is shown
    rules: tuple[float, ...] = ()  # values with a dashed line
    band: Range | None = None  # a shaded range of values
    limits: tuple[float, ...] = ()  # beyond which a run fails, or that converters keep; with a coloured line


def panels_of(plant: Plant, *, limited: bool) -> tuple[Panel, ...]:
    """Return the panels, from top to bottom, first the left column; with the plant's limits where `limited`."""
    nominal, law, protection = plant.case.frequency_hz, coordinated_piecewise(), plant.protection
    ratios = tracking_point().tip_speed_ratio, tracking_point(plant.control.deloading_limit).tip_speed_ratio
    free = (0.9 * ratios[0], 1.1 * ratios[1])
    # Beyond ±0.2 Hz the deviation costs four times as much.
    dear, overload = (nominal - 0.2, nominal + 0.2), (plant.control.overload_limit_pu,)
    low, high = nominal * protection.frequency_min_pu, nominal * protection.frequency_max_pu
    around = *((nominal - d, nominal + d) for d in (0.25, 0.5, 1.0)), (low - 0.25, high + 0.25)
    speeds, stall = (protection.rotor_speed_min_pu, protection.over_speed_pu), (protection.stall_tip_speed_ratio,)
    most = () if plant.limits is None else (plant.limits.power_max_pu,)
    panels = (
        Panel("frequency", "frequency [Hz]", around, rules=dear, limits=(low, high)),
        Panel("rocof", "RoCoF [Hz/s]", ((-0.3, 0.3), (-0.6, 0.6), (-2.0, 2.0), (-10.0, 10.0))),
        Panel("rotor", "rotor speed [p.u.]", ((0.4, 1.3), (0.2, 1.4), (0.0, 2.0)), limits=speeds),
        Panel("ratio", "tip-speed ratio [–]", ((5.0, 13.0), (2.0, 14.0), (0.0, 20.0)), band=free, limits=stall),
        Panel("power", "power [p.u.]", ((0.0, 1.3), (-0.2, 1.4), (-1.0, 2.0)), rules=overload, limits=most),
        Panel("k", "k [p.u.]", ((0.2, 1.3), (0.0, 3.0)), rules=(law.k_min, law.k_nominal, law.k_max)),
        Panel("tau", "τ [s]", ((0.0, 3.4), (0.0, 14.0), (0.0, 60.0))),
        Panel("wind", "wind speed [m/s]", ((4.0, 16.0), (2.0, 26.0))),
    )
    return panels if limited else tuple(panel._replace(limits=()) for panel in panels)
