"""Run the case of a parameter file and compare it with a trace of another simulator.

The trace's rows and the events may come at any time. Whole steps are counted from each event on, and the last one
before an event ends at it. A row between two steps is reached by a shortened step on a copy of the state.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wtg_gym.analysis.case_file import ReferenceCase
from wtg_gym.analysis.trace_file import Trace, known_columns
from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.dynamics import advance_step, evaluate_rates
from wtg_gym.physics.layout import Lanes
from wtg_gym.physics.plant import SIMULATION_DT_RANGE, PlantSettings
from wtg_gym.physics.plant_constants import Plant
from wtg_gym.physics.reduction import bus_voltages, combine_load_noise, refresh_network
from wtg_gym.physics.scenario import LoadStep, Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.ranges import require_range

Floats = npt.NDArray[np.float64]

#: Largest disagreement of our power flow with the file's own [p.u., rad].
_POWER_FLOW_TOLERANCE = 1e-5
#: Largest disagreement of a machine's power with the file's own [p.u.].
_POWER_TOLERANCE = 1e-4
#: Instants closer than this are one [s].
_INSTANT = 1e-9


@dataclass(frozen=True)
class Difference:
    """The largest difference of one quantity over a trace.

    `quantity` is "w", "Pe", "V" …; `size` the difference in its unit; `column` and `time_s` where it is.
    """

    quantity: str
    size: float
    column: str
    time_s: float


def replay(case: ReferenceCase, events: Sequence[LoadStep], time_s: npt.ArrayLike, step_s: float) -> dict[str, Floats]:
    """Run a case and return every column that a trace may hold, each (n,).

    A value at the instant of an event is the one before it; of several rows at that instant, the first.

    Args:
        case: network and machines.
        events: what happens.
        time_s: instants of the rows, at least one, not decreasing from 0 s on (n,) [s].
        step_s: integration step, 0.05 … 40 ms [s].

    Raises:
        ValueError: the step is out of range or too long for the case, or the case has no equilibrium or another one
            than its file.
    """
    require_range("integration step", step_s, *SIMULATION_DT_RANGE, "s")
    times = np.asarray(time_s, dtype=np.float64)
    run = _Run(case, events, step_s)
    names = list(known_columns(case))
    table = np.empty((times.size, len(names)))
    row, clock = 0, 0.0
    for rank, end in enumerate((*run.instants, np.inf)):
        if rank:
            run.strike(rank)
        for step, after in _steps(clock, min(end, float(times[-1])), step_s):
            while times[row] < after - _INSTANT:
                table[row] = run.look(float(times[row]) - clock)
                row += 1
            run.advance(step)
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
    return {name: table[:, i] for i, name in enumerate(names)}


def replay_closely(
    case: ReferenceCase,
    events: Sequence[LoadStep],
    time_s: npt.ArrayLike,
    step_s: float,
    tolerance: Mapping[str, float],
) -> tuple[dict[str, Floats], float, dict[str, float]]:
    """Run a case with a step so fine that its error is small beside the tolerances.

    The step is halved, at most down to 0.05 ms, until halving it once more changes every judged quantity by less than
    a tenth of its tolerance.

    Args:
        case, events, time_s: as for :func:`replay`.
        step_s: the coarsest step [s].
        tolerance: the judged quantities and their tolerances [p.u.].

    Returns:
        the columns, their step [s], and the change by the last halving, by quantity [p.u.].
    """
    times, finest = np.asarray(time_s, dtype=np.float64), SIMULATION_DT_RANGE[0]
    coarse = replay(case, events, times, step_s)
    while True:
        finer = max(0.5 * step_s, finest)
        fine = replay(case, events, times, finer)
        change = {d.quantity: d.size for d in differences(case, Trace(times, coarse), fine)}
        settled = all(change[quantity] <= 0.1 * limit for quantity, limit in tolerance.items())
        if settled or finer <= finest:
            return fine, finer, change
        coarse, step_s = fine, finer


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

    def __init__(self, case: ReferenceCase, events: Sequence[LoadStep], step_s: float) -> None:
        self.instants = sorted({event.time_s for event in events})
        settings = PlantSettings(case=case.network, groups=(), control_dt=step_s, simulation_dt=step_s)
        # Nothing is played here: this is the shortest run that a scenario may have.
        duration_s = step_s * math.ceil(0.1 / step_s)
        # The rank of an event's instant stands for its time: strike() sets the clock.
        ranked = tuple(
            dataclasses.replace(event, time_s=settings.simulation_dt * (1 + self.instants.index(event.time_s)))
            for event in events
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

    def _require_power_flow(self, case: ReferenceCase) -> None:
        voltage = self._bus_voltages()
        for number, value in zip(case.network.bus_numbers, voltage, strict=True):
            magnitude, angle = case.voltage[number]
            slack = voltage[case.network.bus_index(case.network.slack_bus)]
            turned = np.angle(value / slack) + case.voltage[case.network.slack_bus][1]
            off = max(abs(abs(value) - magnitude), abs(math.remainder(turned - angle, 2.0 * math.pi)))
            if off > _POWER_FLOW_TOLERANCE:
                raise ValueError(
                    f"{case.network.name}: the file's V and theta are not a power flow of its own network and powers: "
                    f"at bus {number} they are {magnitude:.6f} p.u. and {angle:.6f} rad, the solution is "
                    f"{abs(value):.6f} p.u. and {turned:.6f} rad"
                )
        found = dict(zip(known_columns(case), self.look(0.0), strict=True))
        for key, power in case.power.items():
            own = complex(found[f"Pe{key}"], found[f"Qe{key}"])
            if abs(own - power) > _POWER_TOLERANCE:
                raise ValueError(
                    f"{case.network.name}: the power of machine {key} in the file's power flow is {power:.6f} p.u., "
                    f"the solution at its V and theta is {own:.6f} p.u."
                )

    def _bus_voltages(self, block: Floats | None = None) -> npt.NDArray[np.complex128]:
        at = self.block if block is None else block
        return bus_voltages(at, 0, 0, self.plant, self.simulator.data, 0.0, 1)

    def strike(self, rank: int) -> None:
        """Let the events of an instant happen."""
        self.block[self.simulator.layout.lane("step")] = rank
        refresh_network(self.block, 0, 0, self.plant, self.simulator.data, 1)
        combine_load_noise(self.block, self.plant.constants[0], np.zeros(1), self.simulator.lanes)

    def advance(self, step_s: float) -> None:
        """Advance by one step of any length [s]."""
        self._step(self.block, step_s)

    def _step(self, block: Floats, step_s: float) -> None:
        constants = self.plant.constants.copy()
        constants["simulation_dt"] = step_s
        _advance(block, self.plant._replace(constants=constants), self.simulator.lanes)

    def look(self, ahead_s: float) -> Floats:
        """Return all columns as they are `ahead_s` from now, without going there."""
        block = self.block.copy()
        if ahead_s > _INSTANT:
            self._step(block, ahead_s)
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


def differences(case: ReferenceCase, trace: Trace, columns: Mapping[str, Floats]) -> tuple[Difference, ...]:
    """Return the largest difference of each quantity that a trace holds, between it and our columns."""
    found: dict[str, Difference] = {}
    for name, quantity in known_columns(case).items():
        if name not in trace.columns:
            continue
        gap = np.abs(columns[name] - trace.columns[name])
        if quantity in ("delta", "th"):
            # Angles count modulo a turn.
            gap = np.abs(np.remainder(gap + np.pi, 2.0 * np.pi) - np.pi)
        at = int(np.argmax(np.where(np.isfinite(gap), gap, np.inf)))
        size = float(gap[at]) if np.isfinite(gap[at]) else np.inf
        if quantity not in found or size > found[quantity].size:
            found[quantity] = Difference(quantity, size, name, float(trace.time_s[at]))
    return tuple(found.values())
