"""The paper's figures of the C_p curve, the open loops and the case studies."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, coordinated_piecewise
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting import style
from wtg_gym.plotting.event_marks import endings, explain_events, mark_end, mark_instants

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from wtg_gym.reproduce.loops import SingleMachine

Floats = npt.NDArray[np.float64]


@style.printed
def plot_power_coefficient() -> Figure:
    """Draw C_p(λ) at β = 0 with the points of 0, 5 and 10 % deloading and the reserve between them.

    The paper's figures `PerformanceCoefficient` (a, the whole curve) and `PerformanceCoefficientPr` (b, the range that
    belongs to the regulation range of frequency).
    """
    control = GridFormingParameters()
    levels = (0.0, control.deloading_nominal, control.deloading_limit)
    points = [tracking_point(level) for level in levels]
    ratios, values = [p.tip_speed_ratio for p in points], [p.power_coefficient for p in points]
    names = ("opt", "n", "pr")
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 72.0)
    whole, part = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    for axes, low, high in ((whole, 2.0, 13.0), (part, ratios[0] - 0.6, ratios[2] + 1.15)):
        x = np.unique(np.append(np.linspace(low, high, 400), ratios))
        y = power_coefficient(x)
        axes.plot(x, y, color="0.15", linewidth=1.3, label="_power coefficient")
        for i, colour in enumerate((style.PALETTE[1], style.PALETTE[0])):
            inside = (x >= ratios[i]) & (x <= ratios[i + 1])
            axes.fill_between(x[inside], y[inside], color=colour, alpha=0.22 + 0.1 * i, linewidth=0.0)
        axes.plot(ratios, values, "o", color="0.15", markeredgecolor="white", markersize=4.8, zorder=4)
        axes.set_xlim(low, high)
        axes.set_xlabel(r"tip-speed ratio $\lambda$ [–]")
        axes.set_ylabel(r"power coefficient $C_p$ [–]")
    whole.set_ylim(0.0, 0.51)
    part.set_ylim(values[2] - 0.035, values[0] + 0.02)
    whole.annotate(
        rf"$\lambda_{{opt}}$ = {ratios[0]:.2f}, $C_{{p,opt}}$ = {values[0]:.3f}",
        (ratios[0], values[0]),
        (0.0, 6.0),
        textcoords="offset points",
        ha="center",
    )
    right = part.get_xlim()[1]
    for name, level, ratio, value in zip(names, levels, ratios, values, strict=True):
        part.vlines(ratio, 0.0, value, linewidth=0.7, **style.REFERENCE)
        part.hlines(value, ratio, right, linewidth=0.7, **style.REFERENCE)
        text = rf"$C_{{p,{name}}}$ = {value:.3f}, −{100 * level:.0f} %".replace(", −0 %", "")
        part.annotate(text, (right, value), (0.0, 1.5), textcoords="offset points", ha="right", va="bottom")
    corners = (r"\omega_{min}", r"\omega_{st}", r"\omega_{max}")
    part.set_xticks(
        ratios,
        [
            rf"{ratio:.2f}" + "\n" + rf"$\lambda_{{{name}}}$" + "\n" + rf"at ${corner}$"
            for ratio, name, corner in zip(ratios, names, corners, strict=True)
        ],
    )
    style.letter_panel(whole, "a", "power coefficient and reserve")
    style.letter_panel(part, "b", r"operating range over $\omega_{min}$ … $\omega_{max}$")
    _draw_reserve_legend(figure, control)
    return figure


def _draw_reserve_legend(figure: Figure, control: GridFormingParameters) -> None:
    from matplotlib.patches import Patch

    spans = (
        (0.0, control.deloading_nominal, "of the available power: reserve for falling ω"),
        (control.deloading_nominal, control.deloading_limit, "of it: given up as ω rises"),
    )
    figure.legend(
        handles=[
            Patch(
                color=style.PALETTE[1 - i],
                alpha=0.22 + 0.1 * i,
                linewidth=0.0,
                label=f"{100 * a:.0f} … {100 * b:.0f} % {use}",
            )
            for i, (a, b, use) in enumerate(spans)
        ],
        loc="outside lower center",
        ncols=2,
        handlelength=1.4,
    )


@style.printed
def plot_bode(loops: Mapping[str, SingleMachine]) -> Figure:
    """Draw the open loops of strategies over angular frequency, with crossovers and phase margins.

    The paper's figures `BodeComparison` and `BodeProposed`. A dot marks the gain crossover; a line from -180° up to
    the phase there is the margin, which the legend states.
    """
    figure = style.new_figure(style.SINGLE_COLUMN_MM, 92.0 + 3.5 * len(loops))
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    angular = np.geomspace(1e-2, 1e2, 600)
    looks = style.strategy_looks(loops)
    for label, loop in loops.items():
        look, margins = looks[label], loop.margins()
        response = loop.response(angular)
        text = (
            f"{label}: {margins.phase_margin_deg:.1f}° at {margins.crossover_rad_s:.2f} rad/s"
            if math.isfinite(margins.phase_margin_deg)
            else f"{label}: no crossover"
        )
        line = {"color": look.colour, "linestyle": look.dashes}
        magnitude.plot(angular, 20.0 * np.log10(np.abs(response)), label=text, **line)
        phase.plot(angular, _phase_deg(response), label=f"_phase {label}", **line)
        if not math.isfinite(margins.phase_margin_deg):
            continue
        crossover, top = margins.crossover_rad_s, margins.phase_margin_deg - 180.0
        dot = {"color": look.colour, "markeredgecolor": "white", "markeredgewidth": 0.6, "zorder": 4.0}
        magnitude.plot(crossover, 0.0, "o", **dot)
        phase.plot(crossover, top, "o", label=f"_margin {label}", **dot)
        phase.vlines(crossover, -180.0, top, color=look.colour, linewidth=0.8, zorder=3)
    magnitude.axhline(0.0, color=style.REFERENCE_GREY, linewidth=0.8, zorder=1)
    phase.axhline(-180.0, color=style.REFERENCE_GREY, linewidth=0.8, zorder=1)
    magnitude.set_ylabel("magnitude [dB]")
    phase.set_ylabel("phase [°]")
    phase.set_xscale("log")
    phase.set_xlim(angular[0], angular[-1])
    bottom = max(-275.0, phase.get_ylim()[0] - 10.0)
    phase.set_yticks(np.arange(-270.0, -89.0, 30.0))
    phase.set_ylim(bottom, -85.0)
    phase.set_xlabel(r"angular frequency $\Omega$ [rad/s]")
    figure.legend(loc="outside lower left", ncols=1, title="phase margin at gain crossover", alignment="left")
    return figure


def _phase_deg(response: npt.NDArray[np.complex128]) -> Floats:
    """Return the phase [deg]; about -180°, since it stays within 180° of that, never jumps."""
    return np.asarray(np.degrees(np.angle(-response)) - 180.0)


@style.printed
def plot_case_study(scenario: Scenario, runs: Mapping[str, Trajectory]) -> Figure:
    """Draw frequency, power, rotor speed and tracking coefficient of each WTG group, one column per group.

    The paper's figures `SimulationLoadIncrease` and `SimulationLoadShed`. The reference strategy is drawn on top and
    thick; a cross marks where a run ended before its time; events are numbered and explained above. Grey lines:
    regulation range, available power and 90 % of it, rotor speed of maximum power, K_opt, K_n and K_pr.

    Args:
        runs: recorded runs of it by strategy, all with the same one to four WTG groups.
    """
    longest = max(runs.values(), key=lambda run: run.time_s.size)
    n_groups = longest.power_pu.shape[1]
    figure = style.new_figure(style.DOUBLE_COLUMN_MM if n_groups > 1 else style.SINGLE_COLUMN_MM, 178.0)
    grid = figure.subplots(4, n_groups, sharex=True, squeeze=False, height_ratios=(1.0, 1.15, 1.15, 0.85))
    looks = style.strategy_looks(runs)
    for group in range(n_groups):
        style.letter_panel(grid[0, group], "abcd"[group], f"GFM-WTG {group + 1} ({longest.wind_m_s[0, group]:.3g} m/s)")
        for row, (label, quantity) in enumerate(_QUANTITIES.items()):
            for name, run in runs.items():
                _draw_run(grid[row, group], name, run, quantity(run)[:, group], looks[name])
            if group == 0:
                grid[row, group].set_ylabel(label)
        _draw_references(list(grid[:, group]), longest, group)
        for axes in grid[:, group]:
            mark_instants(axes, scenario, numbered=axes is grid[0, group])
        grid[3, group].set_xlabel("time [s]")
    grid[0, 0].set_xlim(0.0, scenario.duration_s)
    style.share_limits(list(grid[0]))
    style.share_limits(list(grid[3]))
    nominal = longest.nominal_frequency_hz
    hertz = grid[0, -1].secondary_yaxis("right", functions=(lambda x: nominal * x, lambda x: x / nominal))
    hertz.set_ylabel("frequency [Hz]")
    _draw_strategy_legend(figure, runs, looks)
    explain_events(figure, scenario)
    return figure


_QUANTITIES: dict[str, Callable[[Trajectory], Floats]] = {
    r"frequency $\omega$ [p.u.]": lambda run: run.wtg_frequency_hz / run.nominal_frequency_hz,
    "power p [p.u.]": lambda run: run.power_pu,
    r"rotor speed $\omega_m$ [p.u.]": lambda run: run.rotor_speed_pu,
    "coefficient k [p.u.]": lambda run: run.coefficient_pu,
}


def _draw_run(axes: Axes, name: str, run: Trajectory, values: Floats, look: style.Look) -> None:
    stands_out = name == REFERENCE_STRATEGY
    axes.plot(
        run.time_s,
        values,
        color=look.colour,
        linestyle=look.dashes,
        linewidth=1.7 if stands_out else 1.0,
        zorder=3.5 if stands_out else 3.0,
        label=f"_{name}",
    )
    if run.status != Status.RUNNING:
        mark_end(axes, float(run.time_s[-1]), float(values[-1]), look.colour)


def _draw_references(column: Sequence[Axes], run: Trajectory, group: int) -> None:
    """Draw the limits of one group: constant ones, and those that follow its wind."""
    control, turbine, law = GridFormingParameters(), TurbineParameters(), coordinated_piecewise()
    time, wind = run.time_s, run.wind_m_s[:, group]
    available = available_power_pu(wind)
    best_speed = tracking_point(0.0).tip_speed_ratio * wind / turbine.tip_speed_ratio_per_speed_m_s
    share = 1.0 - control.deloading_limit
    lines = {
        1: {r"$p_{avail}$": available, rf"{share:.1f} $p_{{avail}}$": share * available},
        2: {r"$\lambda_{opt}$": best_speed},
        3: {
            name: np.full(time.size, k)
            for name, k in ((r"$K_{opt}$", law.k_min), ("$K_n$", law.k_nominal), ("$K_{pr}$", law.k_max))
        },
    }
    for row, named in lines.items():
        for name, values in named.items():
            column[row].plot(time, values, linewidth=0.8, zorder=2, **style.REFERENCE)
            style.name_at_right(column[row], name, float(values[-1]))
    low, high = column[0].get_ylim()
    for frequency in (control.frequency_min_pu, control.frequency_max_pu):
        # Drawn where it is in sight or nearly so: the deviations must stay readable.
        if low - 0.3 * (high - low) < frequency < high + 0.3 * (high - low):
            column[0].axhline(frequency, linewidth=0.8, zorder=2, **style.REFERENCE)


def _draw_strategy_legend(figure: Figure, runs: Mapping[str, Trajectory], looks: Mapping[str, style.Look]) -> None:
    from matplotlib.lines import Line2D

    handles = []
    for name in runs:
        width = 1.7 if name == REFERENCE_STRATEGY else 1.0
        handles.append(
            Line2D([], [], color=looks[name].colour, linestyle=looks[name].dashes, linewidth=width, label=name)
        )
    reasons = endings(runs.values())
    if reasons:
        handles.append(Line2D([], [], color="0.25", marker="x", linestyle="none", markeredgewidth=1.4, label=reasons))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(4, len(handles)), handlelength=3.6)
