"""README's picture: laws, a trained policy and a planner side by side in one scenario.

    python docs/studies/one_event.py [--output DOCS]

draws DOCS/images/one-event.svg.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from output import folder as output_folder
from planner import Planning, plan

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.plotting import save_figure, style
from wtg_gym.plotting.event_marks import explain_events, mark_end, mark_instants
from wtg_gym.policies.play import play, started_lanes
from wtg_gym.scenarios import get_suite

SUITE, SEED = "standard-v1", 20_000
ENTRIES = ("coordinated-piecewise", "coordinated-tuned", "gradient-v1-0")


class Recording(NamedTuple):
    """An episode, a sample at the start and one per control step; not a number after an early end."""

    time_s: Floats  # (n,)
    frequency_hz: Floats  # of the centre of inertia (n,)
    power_pu: Floats  # on each group's base (n, n_wtg)
    rotor_speed_pu: Floats  # (n, n_wtg)


def recorded(lanes: TaskLanes, steps: Iterable[np.ndarray]) -> Recording:
    """Record one started episode while `steps` plays it, which yields after every step whether it was made."""

    def sample() -> Floats:
        groups = [lanes.simulator.wtg_values(name)[0] for name in ("power", "rotor_speed")]
        return np.concatenate([lanes.nominal_hz * lanes.simulator.lane_values("coi"), *groups])

    samples = [sample(), *(sample() for made in steps if made[0])]
    n = 1 + round(lanes.duration_s / lanes.settings.control_dt)
    samples += [np.full_like(samples[0], np.nan)] * (n - len(samples))
    frequency_hz, power_pu, rotor_speed_pu = np.split(np.array(samples), [1, 1 + lanes.n_wtg], axis=1)
    return Recording(np.arange(n) * lanes.settings.control_dt, frequency_hz[:, 0], power_pu, rotor_speed_pu)


@style.printed
def plot_one_event(scenario: Scenario, runs: Mapping[str, Recording], plant: PlantSettings) -> Figure:
    """Draw frequency [Hz], power of all turbines [MW] and the slowest rotor's speed [p.u.] over time.

    A cross marks where a run ended before its time. Grey lines: limits at which a run fails.
    """
    looks = style.strategy_looks(runs)
    rated_mw = np.array([group.n_turbines * plant.turbine.rated_power_mw for group in plant.groups])
    nominal_hz, protection = plant.case.frequency_hz, plant.protection
    panels = {
        "frequency [Hz]": (
            lambda run: run.frequency_hz,
            (nominal_hz * protection.frequency_min_pu, nominal_hz * protection.frequency_max_pu),
        ),
        "power of all turbines [MW]": (lambda run: run.power_pu @ rated_mw, ()),
        "slowest rotor [p.u.]": (lambda run: run.rotor_speed_pu.min(axis=1), (protection.rotor_speed_min_pu,)),
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
                style.draw_reference(axes, limit, "limit")
        mark_instants(axes, scenario, numbered=True)
        axes.set_xlim(0.0, scenario.duration_s)
        axes.set_xlabel("time [s]")
    handles = [
        Line2D([], [], color=looks[name].colour, linestyle=looks[name].dashes, linewidth=1.6, label=name)
        for name in runs
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(4, len(handles)), handlelength=3.0)
    explain_events(figure, scenario)
    return figure


if __name__ == "__main__":
    docs = output_folder(__doc__)
    settings, suite = EnvSettings(suite=SUITE, split="test"), get_suite(SUITE)
    scenarios = suite.scenarios([SEED])
    runs = {}
    for entry in (entry for name in ENTRIES for entry in load_entries(name, benchmark=suite.benchmark)):
        with started_lanes(entry, settings, scenarios) as (lanes, _):
            runs[entry.name] = recorded(lanes, play(entry, lanes))
    lanes = TaskLanes(replace(settings, action_mode="k+tau", observation_mode="privileged"), 1)
    with closing(lanes.simulator):
        lanes.start([0], scenarios)
        runs["planner-measured"] = recorded(lanes, plan(lanes, Planning(knowledge="measured")))
    save_figure(plot_one_event(scenarios[0], runs, settings.plant()), docs / "images" / "one-event", ["svg"])
