"""Figures of the studies beyond the paper (:mod:`wtg_gym.reproduce.case_studies`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.protection import Status
from wtg_gym.plotting import style
from wtg_gym.plotting.event_marks import mark_end, mark_instants

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from wtg_gym.reproduce.case_studies import DampingStudy, EquilibriumStudy, MachineModelStudy, MarginStudy


#: The wind speeds of the paper's two groups [m/s].
_PAPER_WINDS = (8.0, 11.4)
_SOLID: style.Dashes = "-"
_DASHED: style.Dashes = (0.0, (4.0, 1.6))
#: Points nearer than this share of the span of both axes get one name.
_CLOSE = 0.07


@style.printed
def plot_margins(study: MarginStudy) -> Figure:
    """Draw phase margins over wind speed, one line per strategy; the paper's two wind speeds are marked."""
    bases = {label: label.split(", ")[0] for label in study.phase_margin_deg}
    looks = style.strategy_looks(bases.values())
    n_columns = 2 if max(len(label) for label in bases) <= 30 else 1
    figure = style.new_figure(style.SINGLE_COLUMN_MM, 62.0 + 3.6 * len(bases) / n_columns)
    axes = figure.subplots()
    # A label "strategy, side" gets the strategy's colour; its sides differ by their dashes.
    drawn: dict[str, int] = {}
    for label, margin in study.phase_margin_deg.items():
        base = bases[label]
        has_sides = base != label
        dashes = (_SOLID, _DASHED)[min(drawn.get(base, 0), 1)] if has_sides else looks[base].dashes
        drawn[base] = drawn.get(base, 0) + 1
        axes.plot(study.wind_m_s, margin, color=looks[base].colour, linestyle=dashes, label=label)
    lowest = min(float(margin.min()) for margin in study.phase_margin_deg.values())
    axes.set_ylim(0.0 if lowest >= 0.0 else None, None)
    axes.set_xlim(study.wind_m_s[0], study.wind_m_s[-1])
    _mark_winds(axes)
    axes.set_xlabel("wind speed [m/s]")
    axes.set_ylabel("phase margin [°]")
    figure.legend(loc="outside lower left", ncols=n_columns, handlelength=3.4)
    return figure


@style.printed
def plot_equilibria(study: EquilibriumStudy) -> Figure:
    """Draw, over wind and frequency, where strategies have no equilibrium: the shaded side below each curve."""
    control = GridFormingParameters()
    looks = style.strategy_looks(study.critical_frequency_pu)
    figure = style.new_figure(style.SINGLE_COLUMN_MM, 74.0)
    axes = figure.subplots()
    everything = np.concatenate(list(study.critical_frequency_pu.values()))
    bottom = float(np.nanmin(np.append(everything, control.frequency_min_pu - 0.002)))
    top = control.frequency_setpoint_pu + 0.0008
    for name, series in study.critical_frequency_pu.items():
        look = looks[name]
        axes.plot(study.wind_m_s, series, color=look.colour, linestyle=look.dashes, linewidth=1.4, label=name)
        # The darker, the more strategies have none.
        axes.fill_between(study.wind_m_s, series, bottom, color="0.3", alpha=0.12, linewidth=0.0, zorder=0.5)
    axes.set_ylim(bottom, top)
    axes.set_xlim(study.wind_m_s[0], study.wind_m_s[-1])
    corners = {r"$\omega_{st}$": control.frequency_setpoint_pu, r"$\omega_{min}$": control.frequency_min_pu}
    for name, frequency in corners.items():
        axes.axhline(frequency, linewidth=0.8, zorder=2, **style.REFERENCE)
        at = (study.wind_m_s[-1], frequency)
        axes.annotate(name, at, (-2.0, 1.5), textcoords="offset points", ha="right", color="0.3")
    _mark_winds(axes)
    axes.set_xlabel("wind speed [m/s]")
    axes.set_ylabel(r"frequency $\omega$ [p.u.]")
    nominal = modified_ieee14().frequency_hz
    hertz = axes.secondary_yaxis(
        "right", functions=(lambda x: np.multiply(x, nominal), lambda x: np.divide(x, nominal))
    )
    hertz.set_ylabel("frequency [Hz]")
    figure.legend(
        loc="outside lower center", ncols=3, title="no equilibrium below the line of", title_fontsize=style.SMALL_PT
    )
    return figure


@style.printed
def plot_damping(study: DampingStudy) -> Figure:
    """Draw what τ trades: (a) nadir and (b) lowest rotor speeds over τ, (c) one against the other, τ at the points.

    τ = 0, which has no place on a logarithmic axis, stands apart left of a break; the paper's τ = 0.8 s is filled.
    """
    tau = study.time_constant_s
    n_groups = study.lowest_rotor_speed_pu.shape[1]
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 66.0)
    nadir, rotor, trade = figure.subplots(1, 3)
    _draw_over_tau(nadir, tau, study.nadir_hz, style.PALETTE[0], "o", "")
    nadir.set_ylabel("frequency nadir [Hz]")
    chosen = GridFormingParameters().damping_time_constant_s
    nadir.plot([], [], "o", color=style.PALETTE[0], markersize=4.5, label=rf"$\tau$ = {chosen:g} s (paper)")
    nadir.legend(handles=nadir.get_lines()[-1:], loc="lower right", handlelength=1.0)
    for group in range(n_groups):
        speed = study.lowest_rotor_speed_pu[:, group]
        _draw_over_tau(rotor, tau, speed, style.PALETTE[group % 6], style.MARKERS[group % 8], f"GFM-WTG {group + 1}")
    rotor.set_ylabel("lowest rotor speed [p.u.]")
    rotor.legend(loc="center right", handlelength=1.8)
    slowest = int(np.argmin(study.lowest_rotor_speed_pu.min(axis=0)))
    speed = study.lowest_rotor_speed_pu[:, slowest]
    colour = style.PALETTE[slowest % 6]
    trade.plot(speed, study.nadir_hz, "-", color=colour, linewidth=0.9, label="_trade")
    for x, y, value in zip(speed, study.nadir_hz, tau, strict=True):
        _draw_point(trade, float(x), float(y), float(value), colour, style.MARKERS[slowest % 8])
    _name_time_constants(trade, speed, study.nadir_hz, tau)
    trade.margins(x=0.2, y=0.1)
    trade.set_xlabel(f"lowest rotor speed of WTG {slowest + 1} [p.u.]")
    trade.set_ylabel("frequency nadir [Hz]")
    style.letter_panel(nadir, "a")
    style.letter_panel(rotor, "b")
    style.letter_panel(trade, "c", r"with $\tau$ [s] at the points")
    return figure


def _draw_over_tau(axes: Axes, tau: Floats, values: Floats, colour: str, marker: str, label: str) -> None:
    positive = tau > 0.0
    apart = float(tau[positive].min()) / 2.5
    where = np.where(positive, tau, apart)
    axes.plot(tau[positive], values[positive], color=colour, linewidth=1.0, label=f"_over tau {label}".rstrip())
    axes.plot([], [], color=colour, marker=marker, markerfacecolor="white", label=label)
    for x, y, value in zip(where, values, tau, strict=True):
        _draw_point(axes, float(x), float(y), float(value), colour, marker)
    axes.set_xscale("log")
    ticks = [x for x in (0.1, 1.0, 10.0, 100.0) if tau[positive].min() <= x <= tau.max()]
    names = [f"{x:g}" for x in ticks]
    if not positive.all():
        ticks, names = [apart, *ticks], ["0", *names]
        break_at = apart * 2.5**0.5
        axes.axvline(break_at, color=style.REFERENCE_GREY, linewidth=0.7, linestyle=style.DOTS)
    axes.set_xlim(apart / 1.4, float(tau.max()) * 1.4)
    axes.set_xticks(ticks, names)
    # Minor ticks would run on across the break.
    axes.minorticks_off()
    axes.set_xlabel(r"time constant $\tau$ [s]")


def _name_time_constants(axes: Axes, x: Floats, y: Floats, tau: Floats) -> None:
    """Write τ [s] at the points; one name for neighbours that lie too close for one each."""
    reach_x, reach_y = (_CLOSE * max(float(np.ptp(values)), 1e-12) for values in (x, y))
    runs: list[list[int]] = []
    for i in range(tau.size):
        last = runs[-1][-1] if runs else None
        if last is not None and abs(x[i] - x[last]) < reach_x and abs(y[i] - y[last]) < reach_y:
            runs[-1].append(i)
        else:
            runs.append([i])
    for run in runs:
        text = f"{tau[run[0]]:g} … {tau[run[-1]]:g}" if len(run) > 1 else f"{tau[run[0]]:g}"
        at = (float(x[run].mean()), float(y[run].mean()))
        axes.annotate(text, at, (4.0, 2.0), textcoords="offset points", fontsize=style.SMALL_PT)


def _draw_point(axes: Axes, x: float, y: float, tau: float, colour: str, marker: str) -> None:
    chosen = abs(tau - GridFormingParameters().damping_time_constant_s) < 1e-9
    axes.plot(x, y, marker, color=colour, markerfacecolor=colour if chosen else "white", markersize=4.5, zorder=3)


@style.printed
def plot_machine_models(study: MachineModelStudy) -> Figure:
    """Draw the load increase with two models of the synchronous machines: frequency, and the low-wind group.

    One colour per strategy; solid for the first machine model, dashed for the second; a cross where a run ended.
    """
    from matplotlib.lines import Line2D

    models = list(dict.fromkeys(model for model, _ in study.runs))
    looks = style.strategy_looks(strategy for _, strategy in study.runs)
    first = next(iter(study.runs.values()))
    group = int(np.argmin(first.wind_m_s[0]))
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 66.0)
    panels = figure.subplots(1, 3, sharex=True)
    of_group = f"GFM-WTG {group + 1} ({first.wind_m_s[0, group]:.3g} m/s)"
    for (model, strategy), run in study.runs.items():
        dashes = _SOLID if model == models[0] else _DASHED
        series = (run.frequency_hz, run.power_pu[:, group], run.rotor_speed_pu[:, group])
        for axes, values in zip(panels, series, strict=True):
            colour = looks[strategy].colour
            axes.plot(run.time_s, values, color=colour, linestyle=dashes, label=f"_{model} {strategy}")
            if run.status != Status.RUNNING:
                mark_end(axes, float(run.time_s[-1]), float(values[-1]), colour)
    names = ("frequency [Hz]", "power p [p.u.]", r"rotor speed $\omega_m$ [p.u.]")
    for axes, letter, name in zip(panels, "abc", names, strict=True):
        style.letter_panel(axes, letter, "centre of inertia" if letter == "a" else of_group)
        axes.set_ylabel(name)
        axes.set_xlabel("time [s]")
        mark_instants(axes, study.scenario, numbered=False)
    panels[0].set_xlim(0.0, study.scenario.duration_s)
    handles = [Line2D([], [], color=look.colour, linewidth=2.0, label=name) for name, look in looks.items()]
    handles += [
        Line2D([], [], color="0.2", linestyle=_SOLID if model == models[0] else _DASHED, label=f"{model} machines")
        for model in models
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _mark_winds(axes: Axes) -> None:
    """Mark the paper's wind speeds where they are in sight."""
    low, high = axes.get_xlim()
    for wind in _PAPER_WINDS:
        if low < wind < high:
            axes.axvline(wind, color=style.REFERENCE_GREY, linewidth=0.7, linestyle=style.DOTS, zorder=1)
            axes.annotate(
                f"{wind:g}",
                (wind, 1.0),
                (0.0, 1.0),
                xycoords=axes.get_xaxis_transform(),
                textcoords="offset points",
                ha="center",
                va="bottom",
                fontsize=style.SMALL_PT,
                color="0.3",
            )
