"""Several controllers in one scenario, side by side: frequency, power of all turbines, slowest rotor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.evaluation.recording import Recording
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.plotting import style
from wtg_gym.plotting.event_marks import explain_events, mark_end, mark_instants
from wtg_gym.plotting.policy_runs import Quantity, draw_legend

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@style.printed
def plot_one_event(scenario: Scenario, runs: Mapping[str, Recording], plant: PlantSettings) -> Figure:
    """Draw frequency [Hz], power of all turbines [MW] and the slowest rotor's speed [p.u.] over time.

    A cross marks where a run ended before its time. Grey lines: limits at which a run fails.
    """
    looks = style.strategy_looks(runs)
    rated_mw = np.array([group.n_turbines * plant.turbine.rated_power_mw for group in plant.groups])
    nominal_hz, protection = plant.case.frequency_hz, plant.protection
    panels: dict[str, tuple[Quantity, tuple[float, ...]]] = {
        "frequency [Hz]": (
            lambda run: run.frequency_hz[0],
            (nominal_hz * protection.frequency_min_pu, nominal_hz * protection.frequency_max_pu),
        ),
        "power of all turbines [MW]": (lambda run: run.power_pu[0] @ rated_mw, ()),
        "slowest rotor [p.u.]": (lambda run: run.rotor_speed_pu[0].min(axis=1), (protection.rotor_speed_min_pu,)),
    }
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 72.0)
    for axes, letter, (label, (quantity, limits)) in zip(
        figure.subplots(1, len(panels), sharex=True), "abc", panels.items(), strict=True
    ):
        style.letter_panel(axes, letter, label)
        for name, run in runs.items():
            values = quantity(run)
            axes.plot(run.time_s, values, color=looks[name].colour, linestyle=looks[name].dashes)
            last = int(np.flatnonzero(np.isfinite(values))[-1])
            if last < run.time_s.size - 1:
                mark_end(axes, float(run.time_s[last]), float(values[last]), looks[name].colour)
        # A run that fails ends a step before the limit.
        axes.margins(y=0.12)
        low, high = axes.get_ylim()
        for limit in limits:
            if low < limit < high:
                axes.axhline(limit, color=style.REFERENCE_GREY, linewidth=0.7)
                style.name_at_right(axes, "limit", limit)
        mark_instants(axes, scenario, numbered=True)
        axes.set_xlim(0.0, scenario.duration_s)
        axes.set_xlabel("time [s]")
    draw_legend(figure, runs, looks)
    explain_events(figure, scenario)
    return figure
