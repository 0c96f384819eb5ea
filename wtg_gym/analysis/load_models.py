"""Loads of constant impedance, current or power: the paper's load increase with each of them.

The simulator has admittances only. After every simulation step those of all loads, and of those that an event has
switched on, are set to Y_0 (V_0/V)^n with n = 0, 1, 2, until they fit the voltages that they cause; the next step runs
with them. Below 0.7 p.u. a load is an impedance again, as usual: a constant power has no solution at a low voltage.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import group_laws

#: Exponent n of the load models.
LOAD_MODELS = {"constant impedance": 0, "constant current": 1, "constant power": 2}
#: Below it a load is an impedance [p.u. of its initial voltage].
_LEAST_VOLTAGE = 0.7
_ITERATIONS = 20
_TOLERANCE = 1e-10


@dataclass(frozen=True, kw_only=True)
class LoadRun:
    """A run with loads of a kind."""

    model: str  # name of the kind
    strategy: str  # of all groups
    #: status, end_s: why and when it ended [s].
    status: Status
    end_s: float
    #: nadir_hz, final_hz: lowest and last frequency of the centre of inertia [Hz].
    nadir_hz: float
    final_hz: float
    least_voltage_pu: float  # of any bus, after the events [p.u.]


def run_with_loads(
    model: str,
    scenario: Scenario,
    strategy: str,
    settings: PlantSettings | None = None,
    *,
    simulation_dt: float = 0.025,
) -> LoadRun:
    """Run a scenario without load noise with loads of a kind, in the paper's plant.

    Args:
        model: a key of :data:`LOAD_MODELS`.
        simulation_dt: step of the integration, and between two settings of the loads [s].
    """
    settings = dataclasses.replace(settings or PlantSettings(), control_dt=simulation_dt, simulation_dt=simulation_dt)
    simulator = Simulator(settings, duration_s=scenario.duration_s)
    simulator.start(0, scenario, group_laws(strategy, len(settings.groups), settings.turbine))
    simulator.evaluate()
    exponent, layout = LOAD_MODELS[model], simulator.layout
    rows, data = simulator.blocks[0], simulator.data
    # A copy: both are written below.
    load_y, event_y = data.load_y[0].copy(), data.events["admittance"][0].copy()
    buses = data.events["bus"][0]
    start = np.abs(simulator.bus_voltages())
    least = start.min()
    hertz, nadir = settings.case.frequency_hz, settings.case.frequency_hz
    for _ in range(simulator.n_intervals):
        simulator.advance()
        before = np.abs(simulator.bus_voltages())
        for _ in range(_ITERATIONS):
            factor = np.maximum(before / start, _LEAST_VOLTAGE) ** -exponent
            data.load_y[0] = load_y * factor
            data.events["admittance"][0] = event_y * factor[buses]
            voltage = np.abs(simulator.bus_voltages())
            if np.abs(voltage - before).max() < _TOLERANCE:
                break
            before = voltage
        # The network is reduced again before the next step.
        rows[layout.lane("next_change")] = rows[layout.lane("step")]
        least = min(least, float(before.min()))
        nadir = min(nadir, hertz * float(simulator.lane_values("coi")[0]))
        if simulator.lane_values("status")[0] != Status.RUNNING:
            break
    return LoadRun(
        model=model,
        strategy=strategy,
        status=Status(int(simulator.lane_values("status")[0])),
        end_s=float(simulator.lane_values("step")[0]) * simulation_dt,
        nadir_hz=nadir,
        final_hz=hertz * float(simulator.lane_values("coi")[0]),
        least_voltage_pu=least,
    )
