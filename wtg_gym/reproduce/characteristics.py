"""The paper's schematic of a strategy at two wind speeds, to scale: steady power and rotor speed over frequency."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from wtg_gym.physics.aerodynamics import power_coefficient
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.scenario import WIND_SPEED_RANGE
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.plotting import style
from wtg_gym.ranges import require_range
from wtg_gym.reproduce.power_frequency import characteristic, critical_frequency_pu, named_points
from wtg_gym.reproduce.steady_states import OperatingPoint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: Frequencies shown beyond either end of the regulation range [p.u.].
_BEYOND = 0.0025
_TOP_POWER_PU = 1.18
_HATCHES = ("////", r"\\\\", "....", "||||")
_UNSTABLE_DASHES = (0.0, (3.0, 1.6))
_DEMAND_DASHES = (0.0, (1.0, 1.4))


@dataclass(frozen=True)
class _Branches:
    """Steady states of the law at one wind speed, the branches joined where they meet, and the points with a name."""

    number: int
    wind_m_s: float
    colour: str
    critical_pu: float | None
    #: Frequency, rotor speed and power along each branch, (3, n) [p.u.].
    stable: Floats
    unstable: Floats
    points: Mapping[str, OperatingPoint]

    @property
    def label(self) -> str:
        return f"{self.wind_m_s:g} m/s"


@style.printed
def plot_characteristic(law: TrackingLaw, winds: Sequence[float] = (11.4, 8.0)) -> Figure:
    """Draw what a strategy does in steady state: power and rotor speed over frequency, and where on the rotor's curve.

    The paper's figures `MPPTDroop` (law mppt), `DeloadingLowDroop` (deloaded-5), `DeloadingHighDroop` (deloaded-10)
    and `Proposed` (coordinated-piecewise), to scale, blades at fine pitch. (a) captured power over rotor speed with
    the tracking curves k ω_m³; (b) power and (c) rotor speed over frequency: stable equilibria solid, unstable ones
    dashed, frequencies without any hatched. A_i at ω_st, B_i at ω_min or where the equilibrium is lost, C_i at ω_max,
    M_i at maximum power, for the i-th wind.

    Args:
        law: the strategy.
        winds: one to four wind speeds, 3 … 25 [m/s].

    Raises:
        ValueError: the number of winds or one of them is out of range.
    """
    if not 1 <= len(winds) <= len(_HATCHES):
        raise ValueError(f"a characteristic is drawn at 1 … {len(_HATCHES)} wind speeds, got {len(winds)}")
    for wind in winds:
        require_range("wind", wind, *WIND_SPEED_RANGE, "m/s")
    branches = [_branches(law, float(wind), i) for i, wind in enumerate(winds)]
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 74.0)
    rotor, power, speed = figure.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
    _draw_rotor_panel(rotor, law, branches)
    for axes, row, name in ((power, 2, "power p [p.u.]"), (speed, 1, r"rotor speed $\omega_m$ [p.u.]")):
        _draw_frequency_panel(axes, row, branches)
        axes.set_ylabel(name)
    style.letter_panel(rotor, "a")
    style.letter_panel(power, "b")
    style.letter_panel(speed, "c")
    power.set_ylim(bottom=-0.02)
    _draw_legend(figure, law, branches)
    figure.suptitle(law.name, x=0.01, ha="left")
    return figure


def _branches(law: TrackingLaw, wind_m_s: float, index: int) -> _Branches:
    control = GridFormingParameters()
    low, high = control.frequency_min_pu - _BEYOND, control.frequency_max_pu + _BEYOND
    critical = critical_frequency_pu(law, wind_m_s, lowest_pu=low, fine_pitch=True)
    corners = (control.frequency_min_pu, control.frequency_setpoint_pu, control.frequency_max_pu)
    grid = np.append(np.linspace(low, high, 121), corners)
    if critical is not None:
        # Both branches leave the point where they meet like a square root of the distance.
        grid = np.append(grid[grid > critical], critical + np.geomspace(1e-9, 1e-3, 40))
    found = characteristic(law, wind_m_s, np.unique(grid), fine_pitch=True)
    stable = np.array([found.frequency_pu, found.rotor_speed_pu, found.power_pu])
    unstable = np.array([found.frequency_pu, found.unstable_rotor_speed_pu, found.unstable_power_pu])
    stable, unstable = (branch[:, np.isfinite(branch).all(axis=0)] for branch in (stable, unstable))
    if critical is not None:
        # The roots at 1e-9 p.u. above it straddle the meeting point evenly.
        meeting = 0.5 * (stable[:, :1] + unstable[:, :1])
        meeting[0] = critical
        stable, unstable = np.hstack([meeting, stable]), np.hstack([meeting, unstable])
    points = named_points(law, wind_m_s)
    return _Branches(index + 1, wind_m_s, style.PALETTE[index], critical, stable, unstable, points)


def _draw_rotor_panel(axes: Axes, law: TrackingLaw, branches: Sequence[_Branches]) -> None:
    turbine, control = TurbineParameters(), GridFormingParameters()
    fastest = max(point.rotor_speed_pu for branch in branches for point in branch.points.values())
    speeds = np.linspace(0.1, fastest + 0.13, 300)
    for branch in branches:
        ratio = turbine.tip_speed_ratio_per_speed_m_s * speeds / branch.wind_m_s
        captured = turbine.wind_power_pu_per_cubic_wind * branch.wind_m_s**3 * power_coefficient(ratio)
        axes.plot(speeds, captured, color=branch.colour, linewidth=1.2, label=f"_captured {branch.label}")
        limit = branch.points.get("B")
        if branch.critical_pu is not None and limit is not None and math.isinf(law.damping_time_constant_s):
            # At B the law demands this over rotor speed; below ω_b it demands more than the rotor can capture.
            droop = control.droop_gain_pu * (control.frequency_setpoint_pu - limit.frequency_pu)
            axes.plot(
                speeds,
                law.k_nominal * speeds**3 + droop,
                color=branch.colour,
                linewidth=0.9,
                linestyle=_DEMAND_DASHES,
                label=f"_demand {branch.label}",
            )
        _mark_points(axes, branch, lambda point: (point.rotor_speed_pu, point.power_pu), _ROTOR_OFFSETS)
    for (name, k), align in zip(_coefficients(law).items(), ("center", "right", "left"), strict=False):
        axes.plot(speeds, k * speeds**3, color=style.REFERENCE_GREY, linewidth=0.8, linestyle="-", zorder=1.5)
        at = (_TOP_POWER_PU / k) ** (1.0 / 3.0)
        axes.text(at, _TOP_POWER_PU + 0.015, name, color="0.3", fontsize=style.SMALL_PT, ha=align, va="bottom")
    axes.set_xlim(0.1, speeds[-1])
    axes.set_ylim(0.0, _TOP_POWER_PU)
    axes.set_xlabel(r"rotor speed $\omega_m$ [p.u.]")
    axes.set_ylabel("power p [p.u.]")


def _coefficients(law: TrackingLaw) -> dict[str, float]:
    """The law's tracking coefficients by the name that is written at their curve."""
    if law.k_min == law.k_nominal == law.k_max:
        return {f"k = {law.k_nominal:.3f}": law.k_nominal}
    return {r"$k_{min}$": law.k_min, r"$k_n$": law.k_nominal, r"$k_{max}$": law.k_max}


def _draw_frequency_panel(axes: Axes, row: int, branches: Sequence[_Branches]) -> None:
    control = GridFormingParameters()
    low, high = control.frequency_min_pu - _BEYOND, control.frequency_max_pu + _BEYOND
    for branch in branches:
        for kind, part, dashes, width in (
            ("stable", branch.stable, "-", 1.4),
            ("unstable", branch.unstable, _UNSTABLE_DASHES, 1.0),
        ):
            line: dict[str, Any] = {"color": branch.colour, "linestyle": dashes, "linewidth": width}
            axes.plot(part[0], part[row], label=f"_{kind} {branch.label}", **line)
        if branch.critical_pu is not None:
            for part_of_region in _lost_region(branch):
                axes.axvspan(low, branch.critical_pu, zorder=0.5, **part_of_region)

        def place(point: OperatingPoint) -> tuple[float, float]:
            return point.frequency_pu, point.power_pu if row == 2 else point.rotor_speed_pu

        _mark_points(axes, branch, place, _POWER_OFFSETS if row == 2 else _SPEED_OFFSETS)
    corners = {
        control.frequency_min_pu: r"$\omega_{min}$",
        control.frequency_setpoint_pu: r"$\omega_{st}$",
        control.frequency_max_pu: r"$\omega_{max}$",
    }
    for frequency in corners:
        axes.axvline(frequency, linewidth=0.7, zorder=1, **style.REFERENCE)
    axes.set_xlim(low, high)
    axes.set_xticks(list(corners), [f"{frequency:.3f}\n{name}" for frequency, name in corners.items()])
    # Room for the names of the highest points.
    bottom, top = axes.get_ylim()
    axes.set_ylim(bottom, top + 0.06 * (top - bottom))
    axes.set_xlabel(r"frequency $\omega$ [p.u.]")


def _lost_region(branch: _Branches) -> tuple[dict[str, Any], dict[str, Any]]:
    """How the frequencies without an equilibrium are drawn at a wind speed: a tint, and a hatch for greyscale.

    Two patches, since some programs that read SVG draw nothing for a hatched one.
    """
    tint = {"facecolor": branch.colour, "alpha": 0.08, "linewidth": 0.0}
    hatch = {"facecolor": "none", "edgecolor": branch.colour, "alpha": 0.35, "linewidth": 0.0}
    return tint, hatch | {"hatch": _HATCHES[branch.number - 1]}


#: Where a point's name stands from the point [pt], per panel: clear of the curves through it.
_ROTOR_OFFSETS = {"A": (7.0, 7.0), "B": (-8.0, 4.0), "C": (10.0, 0.0), "M": (3.0, 8.0)}
_POWER_OFFSETS = {"A": (7.0, 6.0), "B": (-7.0, 6.5), "C": (-8.0, -6.5), "M": (3.0, 8.0)}
_SPEED_OFFSETS = {"A": (-8.0, 5.5), "B": (-7.0, 6.5), "C": (-8.0, 5.5), "M": (8.0, -5.0)}


def _mark_points(
    axes: Axes,
    branch: _Branches,
    place: Callable[[OperatingPoint], tuple[float, float]],
    offsets: Mapping[str, tuple[float, float]],
) -> None:
    for name, point in branch.points.items():
        x, y = place(point)
        axes.plot(
            x,
            y,
            style.MARKERS[branch.number - 1],
            color=branch.colour,
            markersize=4.2,
            markeredgecolor="white",
            markeredgewidth=0.6,
            zorder=5,
            label=f"_point {name}{branch.number}",
        )
        axes.annotate(
            rf"$\mathregular{{{name}_{branch.number}}}$",
            (x, y),
            offsets[name],
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=style.SMALL_PT + 0.5,
            color=branch.colour,
            bbox={"boxstyle": "square,pad=0.02", "facecolor": "white", "edgecolor": "none", "alpha": 0.7},
            zorder=4.5,
        )


def _draw_legend(figure: Figure, law: TrackingLaw, branches: Sequence[_Branches]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    # A tuple of patches is drawn as one on top of the other.
    entries: dict[str, Any] = {}
    for branch in branches:
        marker = style.MARKERS[branch.number - 1]
        line = Line2D([], [], color=branch.colour, marker=marker, markeredgecolor="white")
        entries[f"{branch.number}: {branch.label}"] = line
    entries["stable"] = Line2D([], [], color="0.2", linewidth=1.4)
    entries["unstable"] = Line2D([], [], color="0.2", linewidth=1.0, linestyle=_UNSTABLE_DASHES)
    entries[r"$k\,\omega_m^3$"] = Line2D([], [], color=style.REFERENCE_GREY, linewidth=0.8)
    lost = [branch for branch in branches if branch.critical_pu is not None]
    if lost and math.isinf(law.damping_time_constant_s):
        demand = Line2D([], [], color="0.2", linewidth=0.9, linestyle=_DEMAND_DASHES)
        entries[r"$k\,\omega_m^3 + D_p(\omega_{st}-\omega_b)$"] = demand
    for branch in lost:
        entries[f"no equilibrium at {branch.label}"] = tuple(Patch(**part) for part in _lost_region(branch))
    n_columns = 4 if len(entries) > 6 else len(entries)
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=n_columns)
