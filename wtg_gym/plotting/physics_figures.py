"""Figures of the study of what the paper's model leaves out (:mod:`wtg_gym.analysis.physics_study`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.analysis.physics_study import COMPARED, SUITES_OF_ALL
from wtg_gym.analysis.plant_forms import HONEST, PAPER
from wtg_gym.analysis.voltage_limits import VOLTAGE_LIMIT_PU
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law
from wtg_gym.plotting import style
from wtg_gym.plotting.event_marks import mark_end, mark_instants
from wtg_gym.reproduce.loops import PAPER_SYNCHRONISING_COEFFICIENT, single_machine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from wtg_gym.analysis.physics_study import PhysicsStudy

#: Of the paper's groups: the one at 11.4 m/s, whose current is largest, and the one at 8 m/s, which stalls.
_FAST, _SLOW = 0, 1


@style.printed
def plot_plant_runs(study: PhysicsStudy) -> Figure:
    """Draw the paper's load increase in its own plant and in the honest one: frequency, rotor speed and current."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 118.0)
    axes = figure.subplots(3, 2, sharex=True)
    for column, (plant, title) in enumerate(((PAPER, "the paper's plant"), (HONEST, "all parts together"))):
        for strategy in COMPARED:
            run, look = study.increase[plant][strategy], style.STRATEGY_LOOKS[strategy]
            series = run.frequency_hz, run.rotor_pu[:, _SLOW], run.current_pu[:, _FAST]
            for panel, values in zip(axes[:, column], series, strict=True):
                panel.plot(run.times_s, values, color=look.colour, linestyle=look.dashes, label=strategy)
                if run.failed:
                    mark_end(panel, run.end_s, float(values[-1]), look.colour)
        style.letter_panel(axes[0, column], "ab"[column], title)
        axes[2, column].set_xlabel("time [s]")
        for panel in axes[:, column]:
            mark_instants(panel, study.scenario, numbered=False)
            panel.set_xlim(0.0, study.scenario.duration_s)
    for row, label in zip(
        axes, ("frequency [Hz]", "rotor speed at 8 m/s\n[p.u.]", "current at 11.4 m/s\n[p.u.]"), strict=True
    ):
        row[0].set_ylabel(label)
        style.share_limits(row)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(COMPARED))
    return figure


@style.printed
def plot_plant_parts(study: PhysicsStudy) -> Figure:
    """Draw, for each plant, when the paper's load increase ends in a failure, and the failures in two suites."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 112.0)
    left, right = figure.subplots(1, 2, sharey=True)
    plants = list(study.increase)
    rows = np.arange(len(plants))
    duration_s = study.scenario.duration_s
    for index, strategy in enumerate(COMPARED):
        look = {"color": style.STRATEGY_LOOKS[strategy].colour, "marker": style.MARKERS[index], "linestyle": "none"}
        at = rows + 0.2 * (index - 1.5)
        runs = [study.increase[plant][strategy] for plant in plants]
        lasts = np.array([not run.failed for run in runs])
        left.plot([run.end_s for run in runs if run.failed], at[~lasts], label=strategy, **look)
        left.plot(np.full(lasts.sum(), duration_s), at[lasts], **{**look, "markerfacecolor": "none"})
        counts = [[study.counts[plant][suite][strategy] for suite in SUITES_OF_ALL] for plant in plants]
        share = [100.0 * sum(c.failures for c in both) / sum(c.n_scenarios for c in both) for both in counts]
        right.plot(share, at, **look)
    for panel, letter, text in (
        (left, "a", "failure in the load increase"),
        (right, "b", f"failures in {' and '.join(SUITES_OF_ALL)}"),
    ):
        style.letter_panel(panel, letter, text)
        for row in rows[:-1]:
            panel.axhline(row + 0.5, color="0.9", linewidth=0.5)
        panel.grid(axis="y", visible=False)
    left.set_yticks(rows, plants)
    left.set_ylim(len(plants) - 0.5, -0.5)
    left.set_xlabel("time [s]; hollow: none")
    left.set_xlim(0.0, 1.06 * duration_s)
    right.set_xlabel("share of runs [%]")
    figure.legend(loc="outside lower center", ncols=len(COMPARED))
    return figure


@style.printed
def plot_stiffness(study: PhysicsStudy) -> Figure:
    """Draw the reference's phase margin over K_p, and where the groups of the paper's case lie."""
    figure = style.new_figure(style.SINGLE_COLUMN_MM, 84.0)
    axes = figure.subplots()
    law = get_law(REFERENCE_STRATEGY)
    coefficients = np.linspace(0.8, 2.6, 73)
    winds = study.scenario.wind_speed[:, 0]
    for group, wind in enumerate(winds):
        margins = [single_machine(law, float(wind), float(k)).margins().phase_margin_deg for k in coefficients]
        axes.plot(coefficients, margins, color="0.35", linestyle=("-", "--")[group], label=f"{wind:g} m/s, constant E")
    forms = {
        f"constant E, V = {study.held.bus_voltage_pu:g}": study.held,
        f"constant E ≤ {VOLTAGE_LIMIT_PU:g}": study.limited,
        f"voltage control, V = {study.regulated.bus_voltage_pu:g}": study.regulated,
        "and NREL 5 MW turbine": study.nrel,
    }
    for index, (name, form) in enumerate(forms.items()):
        axes.plot(
            form.synchronising_coefficient,
            form.phase_margin_deg,
            color=style.PALETTE[index],
            marker=style.MARKERS[index],
            linestyle="none",
            label=name,
        )
    axes.axvline(PAPER_SYNCHRONISING_COEFFICIENT, color=style.REFERENCE_GREY, linewidth=0.8, linestyle=":")
    axes.annotate(
        "the paper's",
        (PAPER_SYNCHRONISING_COEFFICIENT, 0.02),
        (3.0, 0.0),
        xycoords=axes.get_xaxis_transform(),
        textcoords="offset points",
        color="0.3",
    )
    axes.set_ylim(40.0, 72.0)
    axes.set_xlim(coefficients[0], coefficients[-1])
    axes.set_xlabel("$K_p$ at constant E [p.u./rad]")
    axes.set_ylabel("phase margin [°]")
    figure.legend(loc="outside lower center", ncols=2)
    return figure
