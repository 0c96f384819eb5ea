"""The paper's figures: power coefficient, characteristics of the strategies, open loops, case studies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from wtg_gym import single_wtg as wtg
from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES, TrackingLaw
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting import style
from wtg_gym.plotting.trajectories import PANELS, Panel, plot_trajectories
from wtg_gym.scenarios import get_suite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Frequencies shown beyond either end of the regulation range [p.u.].
_BEYOND = 0.0025
#: Where the name of a point stands from it [pt].
_AWAY = {"A": (0.0, 6.0), "B": (-12.0, 4.0), "C": (4.0, 3.0), "M": (-2.0, 6.0)}
#: What the panels of a characteristic show of an operating point: abscissa and ordinate.
_PANELS = (("rotor_speed_pu", "power_pu"), ("frequency_pu", "power_pu"), ("frequency_pu", "rotor_speed_pu"))
_LABELS = {
    "frequency_pu": r"frequency $\omega$ [p.u.]",
    "power_pu": "power p [p.u.]",
    "rotor_speed_pu": r"rotor speed $\omega_m$ [p.u.]",
}


def paper_figures(
    increase: Mapping[str, Trajectory], decrease: Mapping[str, Trajectory]
) -> Iterator[tuple[str, Figure]]:
    """Draw the paper's figures one by one: name of the file, figure. The runs are the case studies'."""
    wind, reference, suite = wtg.WINDS[0], STRATEGIES[REFERENCE_STRATEGY], get_suite("paper")
    fixed = ("mppt", "deloaded-5", "deloaded-10")
    yield "power-coefficient", plot_power_coefficient()
    for name in (*fixed, reference.name):
        yield f"characteristic-{name}", plot_characteristic(STRATEGIES[name])
    loops = {name: wtg.single_machine(STRATEGIES[name], wind) for name in fixed}
    linear = {"coordinated-linear": wtg.single_machine(STRATEGIES["coordinated-linear"], wind)}
    undamped = {wtg.LINEAR_UNDAMPED.name: wtg.single_machine(wtg.LINEAR_UNDAMPED, wind)}
    slopes = {
        f"{reference.name}, {side}-frequency": wtg.single_machine(reference, wind, side=side) for side in wtg.SIDES
    }
    yield "bode-comparison", plot_bode({"ideal-source": wtg.ideal_source_loop(), **loops, **undamped})
    yield "bode-proposed", plot_bode({**linear, **undamped, **slopes})
    yield "load-increase", plot_case_study(suite.scenario(0), increase)
    yield "load-decrease", plot_case_study(suite.scenario(1), decrease)


@style.printed
def plot_power_coefficient() -> Figure:
    """Draw C_p(λ) at β = 0 with the points of 0, 5 and 10 % deloading (a), and the range between them (b).

    The paper's figures `PerformanceCoefficient` and `PerformanceCoefficientPr`.
    """
    levels, names, corners = (0.0, 0.05, 0.10), ("opt", "n", "pr"), ("min", "st", "max")
    points = [tracking_point(level) for level in levels]
    ratios, values = [p.tip_speed_ratio for p in points], [p.power_coefficient for p in points]
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 66.0)
    whole, part = figure.subplots(1, 2)
    for axes, low, high in ((whole, 2.0, 13.0), (part, 6.6, 8.8)):
        x = np.unique(np.append(np.linspace(low, high, 400), ratios))
        y = power_coefficient(x)
        axes.plot(x, y, color="0.15", linewidth=1.3)
        for i, colour in enumerate((style.PALETTE[1], style.PALETTE[0])):
            inside = (x >= ratios[i]) & (x <= ratios[i + 1])
            axes.fill_between(x[inside], y[inside], color=colour, alpha=0.3, linewidth=0.0)
        axes.plot(ratios, values, "o", color="0.15", zorder=4)
        axes.set(xlim=(low, high), xlabel=r"tip-speed ratio $\lambda$ [–]", ylabel=r"power coefficient $C_p$ [–]")
    whole.set_ylim(0.0, 0.51)
    part.set_ylim(values[2] - 0.035, values[0] + 0.02)
    for name, level, value in zip(names, levels, values, strict=True):
        loss = f", −{100 * level:.0f} %" if level > 0.0 else ""
        style.draw_reference(part, value, rf"$C_{{p,{name}}}$ = {value:.3f}{loss}")
    ticks = zip(ratios, names, corners, strict=True)
    part.set_xticks(ratios, [f"{x:.2f}\n$\\lambda_{{{n}}}$\nat $\\omega_{{{c}}}$" for x, n, c in ticks])
    style.letter_panel(whole, "a", "power coefficient and reserve")
    style.letter_panel(part, "b", r"operating range over $\omega_{min}$ … $\omega_{max}$")
    return figure


@style.printed
def plot_characteristic(law: TrackingLaw) -> Figure:
    """Draw what a strategy does in steady state: power and rotor speed over frequency, and where on the rotor's curve.

    The paper's figures `MPPTDroop` (law mppt), `DeloadingLowDroop` (deloaded-5), `DeloadingHighDroop` (deloaded-10)
    and `Proposed` (coordinated-piecewise), to scale. (a) captured power over rotor speed with the tracking curves
    k ω_m³, dotted what the law demands where the equilibrium is lost; (b) power and (c) rotor speed over frequency:
    stable equilibria solid, unstable ones dashed, frequencies without any shaded. For the points A_i … M_i at the i-th
    wind see :func:`~wtg_gym.single_wtg.named_points`.
    """
    corners = (wtg.CONTROL.frequency_min_pu, wtg.CONTROL.frequency_setpoint_pu, wtg.CONTROL.frequency_max_pu)
    low, high = corners[0] - _BEYOND, corners[2] + _BEYOND
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 74.0)
    panels = figure.subplots(1, 3, width_ratios=(1.1, 1.0, 1.0))
    for number, (wind, colour) in enumerate(zip(wtg.WINDS, style.PALETTE, strict=False), start=1):
        critical = wtg.critical_frequency_pu(law, wind, lowest_pu=low)
        _draw_rotor_curve(panels[0], law, wind, critical, colour)
        points = _equilibria_between(low, high, law, wind, critical)
        stable, unstable = ([p for p in points if p.stable == wanted] for wanted in (True, False))
        for axes, (x, y) in zip(panels[1:], _PANELS[1:], strict=True):
            axes.plot(*_values(stable, x, y), color=colour, label=f"{number}: {wind:g} m/s")
            axes.plot(*_values(unstable, x, y), "--", color=colour)
            if critical is not None:
                text = f"no equilibrium at {wind:g} m/s"
                axes.axvspan(low, critical, color=colour, alpha=0.1, linewidth=0.0, label=text)
        for axes, (x, y) in zip(panels, _PANELS, strict=True):
            for name, point in wtg.named_points(law, wind).items():
                place = getattr(point, x), getattr(point, y)
                axes.plot(*place, "o", color=colour, zorder=5)
                text = rf"$\mathregular{{{name}_{number}}}$"
                axes.annotate(text, place, _AWAY[name], textcoords="offset points", color=colour)
    _draw_tracking_curves(panels[0], law)
    ticks = [f"{x:.3f}\n$\\omega_{{{name}}}$" for x, name in zip(corners, ("min", "st", "max"), strict=True)]
    for axes in panels[1:]:
        for corner in corners:
            axes.axvline(corner, linewidth=0.7, zorder=1, **style.REFERENCE)
        axes.set_xticks(corners, ticks)
        axes.set_xlim(low, high)
    for axes, letter, (x, y) in zip(panels, "abc", _PANELS, strict=True):
        axes.set(xlabel=_LABELS[x], ylabel=_LABELS[y])
        style.letter_panel(axes, letter)
    figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle(law.name, x=0.01, ha="left")
    return figure


def _values(points: Iterable[wtg.OperatingPoint], *names: str) -> list[list[float]]:
    return [[getattr(point, name) for point in points] for name in names]


def _equilibria_between(
    low_pu: float, high_pu: float, law: TrackingLaw, wind_m_s: float, critical_pu: float | None
) -> list[wtg.OperatingPoint]:
    """Return the stable and the unstable equilibria over a range of frequencies, from where they are lost if so."""
    frequencies = np.linspace(low_pu, high_pu, 126)
    if critical_pu is not None:
        # Both branches leave the point where they meet like a square root of the distance.
        near = critical_pu + np.geomspace(1e-9, 1e-3, 40)
        frequencies = np.unique(np.append(frequencies[frequencies > critical_pu], near))
    return [point for frequency in frequencies for point in wtg.equilibria(float(frequency), law, wind_m_s)[-2:]]


def _draw_rotor_curve(axes: Axes, law: TrackingLaw, wind_m_s: float, critical_pu: float | None, colour: str) -> None:
    """Draw captured power over rotor speed, and the demand that touches it where the equilibrium is lost."""
    speeds = np.linspace(0.1, 1.4, 300)
    ratios = wtg.TURBINE.tip_speed_ratio_per_speed_m_s * speeds / wind_m_s
    captured = wtg.TURBINE.wind_power_pu_per_cubic_wind * wind_m_s**3 * power_coefficient(ratios)
    axes.plot(speeds, captured, color=colour)
    if critical_pu is not None and np.isinf(law.damping_time_constant_s):
        demand = law.k_nominal * speeds**3 + wtg.CONTROL.droop_gain_pu * (
            wtg.CONTROL.frequency_setpoint_pu - critical_pu
        )
        axes.plot(speeds, demand, ":", color=colour, linewidth=0.9)


def _draw_tracking_curves(axes: Axes, law: TrackingLaw) -> None:
    for k in sorted({law.k_min, law.k_nominal, law.k_max}):
        speeds = np.linspace(0.1, min((1.15 / k) ** (1.0 / 3.0), 1.4))
        axes.plot(speeds, k * speeds**3, color=style.REFERENCE_GREY, linewidth=0.8)
        top = (speeds[-1], k * speeds[-1] ** 3)
        axes.annotate(f"k = {k:.2f}", top, (0.0, 2.0), textcoords="offset points", rotation=60, fontsize=6)
    axes.set_ylim(0.0, 1.35)


@style.printed
def plot_bode(loops: Mapping[str, wtg.SingleMachine]) -> Figure:
    """Draw the open loops of strategies over angular frequency, with crossovers and phase margins.

    The paper's figures `BodeComparison` and `BodeProposed`. A dot marks the gain crossover; a line from -180° up to
    the phase there is the margin, which the legend states.
    """
    figure = style.new_figure(style.SINGLE_COLUMN_MM, 92.0 + 3.5 * len(loops))
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    angular = np.geomspace(1e-2, 1e2, 600)
    for (label, loop), look in zip(loops.items(), style.strategy_looks(loops).values(), strict=True):
        margins, response = loop.margins(), loop.response(angular)
        line: dict[str, Any] = {"color": look.colour, "linestyle": look.dashes}
        text = f"{label}: {margins.phase_margin_deg:.1f}° at {margins.crossover_rad_s:.2f} rad/s"
        magnitude.plot(angular, 20.0 * np.log10(np.abs(response)), label=text, **line)
        # About -180°, since the phase stays within 180° of that, it never jumps.
        phase.plot(angular, np.degrees(np.angle(-response)) - 180.0, **line)
        crossover, top = margins.crossover_rad_s, margins.phase_margin_deg - 180.0
        magnitude.plot(crossover, 0.0, "o", color=look.colour, zorder=4)
        phase.plot(crossover, top, "o", color=look.colour, zorder=4)
        phase.vlines(crossover, -180.0, top, color=look.colour, linewidth=0.8, zorder=3)
    magnitude.axhline(0.0, color=style.REFERENCE_GREY, linewidth=0.8, zorder=1)
    phase.axhline(-180.0, color=style.REFERENCE_GREY, linewidth=0.8, zorder=1)
    magnitude.set_ylabel("magnitude [dB]")
    bottom = max(-275.0, phase.get_ylim()[0] - 10.0)
    phase.set_yticks(np.arange(-270.0, -89.0, 30.0))
    phase.set(xscale="log", xlim=(angular[0], angular[-1]), ylim=(bottom, -85.0), ylabel="phase [°]")
    phase.set_xlabel(r"angular frequency $\Omega$ [rad/s]")
    figure.legend(loc="outside lower left", ncols=1, title="phase margin at gain crossover", alignment="left")
    return figure


def plot_case_study(scenario: Scenario, runs: Mapping[str, Trajectory]) -> Figure:
    """Draw frequency, power, rotor speed and tracking coefficient of both WTG groups in the paper's winds.

    The paper's figures `SimulationLoadIncrease` and `SimulationLoadShed`. Grey lines: available power and 90 % of it,
    rotor speed of maximum power, K_opt, K_n and K_pr.
    """
    columns = {f"GFM-WTG {group} ({wind:g} m/s)": _panels(wind) for group, wind in enumerate(wtg.WINDS, start=1)}
    return plot_trajectories(runs, scenario, columns)


def _panels(wind_m_s: float) -> tuple[Panel, ...]:
    """Return the panels of a group in a case study, from above; all reference lines are drawn."""
    law, available = STRATEGIES[REFERENCE_STRATEGY], float(available_power_pu(wind_m_s))
    best_speed = tracking_point().tip_speed_ratio * wind_m_s / wtg.TURBINE.tip_speed_ratio_per_speed_m_s
    powers = {r"$p_{avail}$": available, r"0.9 $p_{avail}$": 0.9 * available}
    coefficients = {r"$K_{opt}$": law.k_min, "$K_n$": law.k_nominal, r"$K_{pr}$": law.k_max}
    _, power, rotor, coefficient = PANELS
    return (
        Panel(_LABELS["frequency_pu"], lambda run: run.wtg_frequency_hz / run.nominal_frequency_hz),
        power._replace(label=_LABELS["power_pu"], references=powers),
        rotor._replace(label=_LABELS["rotor_speed_pu"], references={r"$\lambda_{opt}$": best_speed}),
        coefficient._replace(references=coefficients),
    )
