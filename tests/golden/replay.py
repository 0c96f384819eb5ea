"""Run a golden case here, and compare it with its trace.

The trace's rows and the events may come at any time. Whole steps are counted from each event on, and the last one
before an event ends at it. A row between two steps is reached by a shortened step on a copy of the state.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from tests.golden.case import Case
from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.dynamics import advance_step, evaluate_rates
from wtg_gym.physics.kernel_data import Plant
from wtg_gym.physics.layout import Floats, Lanes
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.reduction import bus_voltages, combine_load_noise, refresh_network
from wtg_gym.physics.scenario import LoadStep, Scenario
from wtg_gym.physics.simulator import Simulator

#: Instants closer than this are one [s].
_INSTANT = 1e-9


def replay(case: Case, events: Sequence[LoadStep], time_s: npt.ArrayLike, step_s: float) -> dict[str, Floats]:
    """Run a case and return every column that a trace may hold, each (n,).

    A value at the instant of an event is the one before it; of several rows at that instant, the first.

    Args:
        case, events: what runs, and what happens.
        time_s: instants of the rows, not decreasing from 0 s on (n,) [s].
        step_s: integration step, 0.05 … 40 ms [s].
    """
    times = np.asarray(time_s, dtype=np.float64)
    run = _Run(case, events, step_s)
    table = np.empty((times.size, len(case.columns)))
    row, clock = 0, 0.0
    for rank, end in enumerate((*run.instants, np.inf)):
        if rank:
            run.strike(rank)
        for step, after in _steps(clock, min(end, float(times[-1])), step_s):
            while times[row] < after - _INSTANT:
                table[row] = run.look(float(times[row]) - clock)
                row += 1
            run.step(run.block, step)
            clock = after
        first = True
        while row < times.size and times[row] <= end + _INSTANT and (first or times[row] < end - _INSTANT):
            # Of two rows at the instant of an event the second is the one after it.
            first = times[row] < end - _INSTANT
            table[row] = run.look(0.0)
            row += 1
        if row == times.size:
            break
        clock = end
    return {name: table[:, i] for i, name in enumerate(case.columns)}


def differences(case: Case, trace: Mapping[str, Floats], found: Mapping[str, Floats]) -> dict[str, float]:
    """Return the largest difference of each quantity that a trace holds; angles count modulo a turn."""
    largest: dict[str, float] = {}
    for name, quantity in case.columns.items():
        if name in trace:
            gap = np.abs(found[name] - trace[name])
            if quantity in ("delta", "th"):
                gap = np.abs(np.remainder(gap + np.pi, 2.0 * np.pi) - np.pi)
            largest[quantity] = max(largest.get(quantity, 0.0), float(gap.max()))
    return largest


def _steps(start: float, end: float, step_s: float) -> Iterator[tuple[float, float]]:
    """Whole steps from `start` on and what is left before `end`, each with the time after it."""
    count = int((end - start) / step_s + 1e-6)
    for i in range(count):
        yield step_s, start + (i + 1) * step_s
    left = end - (start + count * step_s)
    if left > _INSTANT:
        yield left, end


class _Run:
    """A case under way: the simulator's own kernels, with steps of any length."""

    def __init__(self, case: Case, events: Sequence[LoadStep], step_s: float) -> None:
        self.instants = sorted({event.time_s for event in events})
        settings = PlantSettings(case=case.network, groups=(), control_dt=step_s, simulation_dt=step_s)
        # Nothing is played here: this is the shortest run that a scenario may have.
        duration_s = step_s * math.ceil(0.1 / step_s)
        # The rank of an event's instant stands for its time: strike() sets the clock.
        ranked = tuple(
            dataclasses.replace(event, time_s=step_s * (1 + self.instants.index(event.time_s))) for event in events
        )
        self.simulator = Simulator(settings, duration_s=duration_s)
        scenario = Scenario(
            name=case.network.name,
            wind_speed=np.zeros((0, 1)),
            events=ranked,
            duration_s=duration_s,
            load_noise_bus=case.network.bus_numbers[0],
        )
        self.simulator.start(0, scenario, ())
        self.block, self.plant = self.simulator.blocks[0], self.simulator.plant
        self._require_power_flow(case)

    def _require_power_flow(self, case: Case) -> None:
        """Refuse a case whose power flow is not that of its own network."""
        own, given = self._bus_voltages(self.block), np.array(list(case.voltage.values()))
        slack = case.network.bus_index(case.network.slack_bus)
        assert np.abs(own / own[slack] - given / given[slack]).max() < 1e-5, f"{case.network.name}: other voltages"
        found = dict(zip(case.columns, self.look(0.0), strict=True))
        for key, power in case.power.items():
            assert abs(complex(found[f"Pe{key}"], found[f"Qe{key}"]) - power) < 1e-4, f"machine {key}: other power"

    def _bus_voltages(self, block: Floats) -> npt.NDArray[np.complex128]:
        return bus_voltages(block, 0, 0, self.plant, self.simulator.data, 0.0, 1)

    def strike(self, rank: int) -> None:
        """Let the events of an instant happen."""
        self.block[self.simulator.layout.lane("step")] = rank
        refresh_network(self.block, 0, 0, self.plant, self.simulator.data, 1)
        combine_load_noise(self.block, self.plant.constants[0], np.zeros(1), self.simulator.lanes)

    def step(self, block: Floats, step_s: float) -> None:
        """Advance a block by one step of any length [s]."""
        constants = self.plant.constants.copy()
        constants["simulation_dt"] = step_s
        _advance(block, self.plant._replace(constants=constants), self.simulator.lanes)

    def look(self, ahead_s: float) -> Floats:
        """Return all columns as they are `ahead_s` from now, without going there."""
        block = self.block.copy()
        if ahead_s > _INSTANT:
            self.step(block, ahead_s)
        evaluate_rates(block[None, :], self.plant, self.simulator.lanes)
        layout = self.simulator.layout
        n, first = layout.n_sync, layout.rows.voltage
        machines = self.plant.constants["machines"][0]
        reference = block[layout.lane("angle")]
        emf, current = block[first : first + 4 * n].reshape(2, n, 2) @ [1.0, 1j]
        impedance = machines["resistance"] + 1j * machines["internal_reactance"]
        power = (emf - impedance * current) * current.conj()
        voltage = self._bus_voltages(block)
        return np.concatenate(
            [
                block[layout.machine("speed")],
                power.real,
                power.imag,
                block[layout.machine("torque")],
                block[layout.machine("angle")] + reference,
                np.abs(voltage),
                np.angle(voltage * np.exp(1j * reference)),
            ]
        )


@compiled
def _advance(block: Floats, plant: Plant, lanes: Lanes) -> None:
    advance_step(block, plant.constants[0], 0, lanes)
