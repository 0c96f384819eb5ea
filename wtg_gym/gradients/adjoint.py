"""Back through one control step: replay it from its start, then pull cotangents back through its kernels in turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from wtg_gym.envs.actions import apply_actions
from wtg_gym.envs.measuring import arrived_row, newest_row
from wtg_gym.envs.task_records import TASK, load_sensor_input, parts_of, read_task
from wtg_gym.gradients.generated import Rules, Steps, compiled_with
from wtg_gym.systems.compiled import compiled, inlined
from wtg_gym.physics.currents import unit_currents
from wtg_gym.physics.dynamics import derivatives, keep_energy, unit_voltages
from wtg_gym.systems.elementary import fma
from wtg_gym.physics.integration import apply_network_changes, end_step, enter_interval, protections_sample
from wtg_gym.physics.kernel_data import LaneData, Plant
from wtg_gym.physics.layout import LANE, Floats, Lanes, read_turbine, rows_of
from wtg_gym.physics.sensors import noise_key, normal

#: The way back through the sweeps that hold currents ends where no cotangent changes by more than this share of the
#: lane's largest. They come some thirty times at most; if ever this many were too few, not a number comes back.
_SWEEPS = 1000
_SETTLED = 1e-13


@compiled
def _evaluate(work: Floats, plant: Plant, fraction: float, lanes: Lanes) -> None:
    derivatives(work, plant.constants[0], fraction, lanes)


@compiled
def _find_currents(work: Floats, plant: Plant, lanes: Lanes) -> None:
    unit_voltages(work, plant.constants[0], lanes)
    unit_currents(work, plant.constants[0], lanes)


@inlined
def _copy(source: Floats, row: int, target: Floats, target_row: int, width: int) -> None:
    for x in range(width):
        target[target_row * width + x] = source[row * width + x]


@inlined
def _ahead(stage: int, h: float) -> float:
    """Return how far a stage's rates move the states for the next one [s]."""
    return h if stage == 2 else 0.5 * h


@inlined
def _enter_bases(work: Floats, steps: Steps, start: Floats, width: int) -> None:
    """Write the states at a step's start to where the end of the step looks for them."""
    for k in range(steps.ends.size):
        _copy(start, steps.ends[k], work, steps.bases[k], width)


@inlined
def _keep_energies(work: Floats, plant: Plant, steps: Steps, path: Floats, lanes: Lanes) -> None:
    c, width = plant.constants[0], len(lanes)
    turbine = read_turbine(c["turbine"])
    _enter_bases(work, steps, path[0], width)
    for j in range(c["share"].shape[0]):
        for x in range(width):
            keep_energy(work, c, j, x, turbine, width)


@inlined
def _note_measurement(work: Floats, c: Any, task: Any, steps: Steps, n_rows: int, lanes: Lanes) -> None:
    """Go back through the ring of measurements, and draw the random numbers of the one that is taken.

    The cotangent of what is shown goes to the place in the ring that it was copied from; then that of the newest place
    goes to what was measured.
    """
    width, parts = len(lanes), parts_of(c, task)
    interval = (parts.lane + TASK.interval) * width
    for x in range(width):
        before = work[interval + x]
        work[interval + x] = work[steps.interval[0] * width + x]
        seed = load_sensor_input(work, parts.sensor_input * width + x, width).seed
        key = noise_key(int(seed), int(work[interval + x]))
        for j in range(steps.measured.size):
            arrived = arrived_row(work, x, j, c, task, width)
            newest = newest_row(work, x, j, c, task, width)
            for k in range(steps.seen.shape[1]):
                shown = work[(n_rows + steps.measured[j] + k) * width + x]
                work[(n_rows + arrived + k) * width + x] += shown
                work[(n_rows + steps.seen[j, k]) * width + x] = work[(n_rows + newest + k) * width + x]
                work[(n_rows + newest + k) * width + x] = 0.0
            for k in range(steps.noise.shape[1]):
                work[steps.noise[j, k] * width + x] = normal(key, j * steps.noise.shape[1] + k)
        work[interval + x] = before


@compiled
def replay(
    work: Floats,
    first_lane: int,
    plant: Plant,
    data: LaneData,
    steps: Steps,
    path: Floats,
    inputs: Floats,
    held: Floats,
    ran: Floats,
    lanes: Lanes,
) -> None:
    """Advance a block by a control interval like :func:`~wtg_gym.physics.integration.advance_interval`.

    Args:
        work, first_lane, plant, data, lanes: as there.
        steps: which rows move.
        path: takes the states of each step's stages, and at its end (n_substeps, 5, n_states · width).
        inputs: takes the other rows that each step reads (n_substeps, n_inputs · width).
        held: takes 1 where a machine's governor is lost at the step's start (n_substeps, n_machines · width).
        ran: takes 1 for lanes that the step moves (n_substeps, width).
    """
    c = plant.constants[0]
    width, h, n = len(lanes), c["simulation_dt"], steps.states.size
    part = 1.0 / c["n_substeps"]
    noise_y, total = np.empty(width), np.empty(n * width)
    active = (rows_of(c).lane + LANE.active) * width
    enter_interval(work, first_lane, c, data, noise_y, lanes)
    for step in range(c["n_substeps"]):
        for i in range(steps.droops.size):
            _copy(work, steps.droops[i], held[step], i, width)
        apply_network_changes(work, first_lane, plant, data, noise_y, lanes)
        for i in range(steps.droops.size):
            for x in range(width):
                lost = held[step, i * width + x] > 0.0 and work[steps.droops[i] * width + x] == 0.0
                held[step, i * width + x] = 1.0 if lost else 0.0
        for i in range(steps.inputs.size):
            _copy(work, steps.inputs[i], inputs[step], i, width)
        for x in range(width):
            ran[step, x] = work[active + x]
        for i in range(n):
            _copy(work, steps.states[i], path[step, 0], i, width)
        for stage in range(4):
            offset = 0.0 if stage == 0 else 1.0 if stage == 3 else 0.5
            _evaluate(work, plant, (step + offset) * part, lanes)
            for i in range(n):
                for x in range(width):
                    at = i * width + x
                    base, rate = path[step, 0, at], work[steps.rates[i] * width + x]
                    if stage == 3:
                        end = fma(h / 6.0, total[at] + rate, base)
                        end = min(max(end, steps.low[i]), steps.high[i])
                    else:
                        total[at] = rate if stage == 0 else fma(2.0, rate, total[at])
                        end = fma(_ahead(stage, h), rate, base)
                    end = end if ran[step, x] > 0.5 else base
                    path[step, stage + 1, at] = end
                    work[steps.states[i] * width + x] = end
        if c["extension"].shape[0] > 0:
            _keep_energies(work, plant, steps, path[step], lanes)
        end_step(work, c, protections_sample(c, step), lanes)
    _evaluate(work, plant, 1.0, lanes)


@inlined
def _pull_lost_governors(work: Floats, steps: Steps, lost: Floats, n_rows: int, width: int) -> None:
    """The reference of a governor that is lost here is where its gate was; no droop acts from here on."""
    for i in range(steps.references.size):
        for x in range(width):
            if lost[i * width + x] > 0.5:
                work[(n_rows + steps.droops[i]) * width + x] = 0.0
                at = (n_rows + steps.references[i]) * width + x
                work[(n_rows + steps.gates[i]) * width + x] += work[at]
                work[at] = 0.0


def build_pull_limits(rules: Rules) -> Any:
    """Return the compiled function that goes back through the limits of currents."""
    n_rows, pull_sweep = rules.n_rows, rules.pull_sweep

    def pull_limits(work: Floats, steps: Steps, lanes: Lanes) -> None:
        """Go back through the sweeps that held the currents of some lanes.

        As the sweeps end at a fixed point, each has the derivatives of the last: this is the adjoint of that point,
        approached as the sweeps approached it. Lanes without a limited current keep their bits.
        """
        width, n, m = len(lanes), steps.limited.size, steps.sources.size
        settled, last = np.ones(width, dtype=np.bool_), np.empty((n + m) * width)
        for j in range(steps.reactances.size):
            for x in range(width):
                settled[x] &= not work[steps.reactances[j] * width + x] > 0.0
        if settled.all():
            return
        for i in range(m):
            for x in range(width):
                work[(n_rows + steps.sources[i]) * width + x] = 0.0
        for _ in range(_SWEEPS):
            for i in range(n):
                _copy(work, n_rows + steps.limited[i], last, i, width)
            for i in range(m):
                _copy(work, n_rows + steps.sources[i], last, n + i, width)
            pull_sweep(work, lanes)
            for x in range(width):
                largest, change = 0.0, 0.0
                for i in range(n + m):
                    row = steps.limited[i] if i < n else steps.sources[i - n]
                    at = (n_rows + row) * width + x
                    if settled[x]:
                        work[at] = last[i * width + x]
                    largest, change = max(largest, abs(work[at])), max(change, abs(work[at] - last[i * width + x]))
                settled[x] |= not change > _SETTLED * largest
            if settled.all():
                break
        for i in range(m):
            for x in range(width):
                # The sweeps began with the voltages that they reduce: those are the first of the rows, group by group.
                from_source = work[(n_rows + steps.sources[i]) * width + x] if settled[x] else np.nan
                work[(n_rows + steps.limited[i]) * width + x] += from_source

    return compiled_with(pull_limits, rules.digest)


def _build_pull_rates(rules: Rules) -> Any:
    pull_network, pull_units, pull_limits = rules.pull_network, rules.pull_rates, build_pull_limits(rules)

    def pull_rates(work: Floats, plant: Plant, fraction: float, steps: Steps, lanes: Lanes) -> None:
        """Go back through the right-hand side."""
        c = plant.constants[0]
        if c["extension"].shape[0] == 0:
            pull_units(work, fraction, c["cells"], lanes)
        else:
            _find_currents(work, plant, lanes)
            pull_units(work, fraction, c["cells"], lanes)
            pull_limits(work, steps, lanes)
            pull_network(work, lanes)

    return compiled_with(pull_rates, rules.digest)


def _build_pull_steps(rules: Rules, pull_rates: Any) -> Any:
    n_rows, pull_finish, pull_coi = rules.n_rows, rules.pull_finish, rules.pull_coi

    def pull_steps(
        work: Floats, plant: Plant, steps: Steps, path: Floats, inputs: Floats, held: Floats, ran: Floats, lanes: Lanes
    ) -> None:
        """Go back through the simulation steps of a control interval: the adjoint of the Runge-Kutta method."""
        c = plant.constants[0]
        width, h, n = len(lanes), c["simulation_dt"], steps.states.size
        active = (rows_of(c).lane + LANE.active) * width
        part = 1.0 / c["n_substeps"]
        end, through = np.empty(n * width), np.empty(n * width)
        for step in range(c["n_substeps"] - 1, -1, -1):
            for i in range(steps.inputs.size):
                _copy(inputs[step], i, work, steps.inputs[i], width)
            if step == c["n_substeps"] - 1:
                # With the units that were connected in this step: protections act after it.
                pull_coi(work, lanes)
            if c["extension"].shape[0] > 0:
                for i in range(n):
                    _copy(path[step, 4], i, work, steps.states[i], width)
                _enter_bases(work, steps, path[step, 0], width)
                for x in range(width):
                    work[active + x] = ran[step, x]
                pull_finish(work, lanes)
            for i in range(n):
                for x in range(width):
                    # A state at its limit does not follow.
                    reached = path[step, 4, i * width + x]
                    free = (reached > steps.low[i] and reached < steps.high[i]) or ran[step, x] < 0.5
                    given = work[(n_rows + steps.states[i]) * width + x] if free else 0.0
                    end[i * width + x] = given
                    through[i * width + x] = given
            for k in range(steps.ends.size):
                for x in range(width):
                    through[steps.ends[k] * width + x] += work[(n_rows + steps.bases[k]) * width + x]
            for stage in range(3, -1, -1):
                offset = 0.0 if stage == 0 else 1.0 if stage == 3 else 0.5
                weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
                for i in range(n):
                    _copy(path[step, stage], i, work, steps.states[i], width)
                    for x in range(width):
                        # The rates of a stage move the end, and the next stage, whose cotangent was pulled last.
                        seed = weight * end[i * width + x]
                        if stage < 3:
                            seed += _ahead(stage, h) * work[(n_rows + steps.states[i]) * width + x]
                        work[(n_rows + steps.rates[i]) * width + x] = seed if ran[step, x] > 0.5 else 0.0
                pull_rates(work, plant, (step + offset) * part, steps, lanes)
                for i in range(n):
                    for x in range(width):
                        through[i * width + x] += work[(n_rows + steps.states[i]) * width + x]
            for i in range(n):
                _copy(through, i, work, n_rows + steps.states[i], width)
            _pull_lost_governors(work, steps, held[step], n_rows, width)

    return compiled_with(pull_steps, rules.digest)


def _build_pull_outputs(rules: Rules, pull_rates: Any) -> Any:
    n_rows = rules.n_rows

    def pull_outputs(work: Floats, plant: Plant, steps: Steps, lanes: Lanes) -> None:
        """Go back through the evaluation at the end of a control interval, whose outputs are charged and observed."""
        width, n = len(lanes), steps.states.size
        end = np.empty(n * width)
        for i in range(n):
            _copy(work, n_rows + steps.states[i], end, i, width)
            for x in range(width):
                work[(n_rows + steps.rates[i]) * width + x] = 0.0
        pull_rates(work, plant, 1.0, steps, lanes)
        for i in range(n):
            for x in range(width):
                work[(n_rows + steps.states[i]) * width + x] += end[i * width + x]
        for i in range(steps.outputs.size):
            for x in range(width):
                work[(n_rows + steps.outputs[i]) * width + x] = 0.0

    return compiled_with(pull_outputs, rules.digest)


def build_pull(rules: Rules) -> Any:
    """Return the compiled function that goes back through one control step."""
    n_rows, find_interval = rules.n_rows, rules.find_interval
    # A plant without WTG groups has none.
    first_action = int(rules.actions[0]) if rules.actions.size else n_rows
    pull_act, pull_charge, pull_rates = rules.pull_act, rules.pull_charge, _build_pull_rates(rules)
    pull_steps, pull_outputs = _build_pull_steps(rules, pull_rates), _build_pull_outputs(rules, pull_rates)

    def pull(
        works: Floats,
        first: int,
        last: int,
        plant: Plant,
        data: LaneData,
        task: Any,
        actions: Floats,
        steps: Steps,
        lanes: Lanes,
    ) -> None:
        """Go back through one control step of the blocks first … last - 1.

        Args:
            works: blocks as they stood before the step, and behind them the cotangents after it; on return those
                before it, and those of the actions (n_blocks, 2 · n_rows · width).
            plant, data, task, lanes: as for :func:`~wtg_gym.envs.task.step_blocks`.
            actions: of the step (n_lanes, n_action).
            steps: which rows move.
        """
        c, t, width = plant.constants[0], read_task(task[0]), len(lanes)
        own, of_task = rows_of(c).lane, rows_of(c).extra
        n, n_sub = steps.states.size, c["n_substeps"]
        path, ran = np.empty((n_sub, 5, n * width)), np.empty((n_sub, width))
        inputs, held = np.empty((n_sub, steps.inputs.size * width)), np.empty((n_sub, steps.droops.size * width))
        for b in range(first, last):
            work = works[b]
            count = min(width, actions.shape[0] - b * width)
            given = actions[b * width : b * width + count]
            apply_actions(work, c, t, given, lanes)
            for x in range(width):
                for a in range(actions.shape[1]):
                    work[(first_action + a) * width + x] = given[x, a] if x < count else 0.0
                work[(of_task + TASK.was_active) * width + x] = work[(own + LANE.active) * width + x]
            replay(work, b * width, plant, data, steps, path, inputs, held, ran, lanes)
            if task[0]["sensed"].shape[0] > 0:
                find_interval(work, lanes)
                _note_measurement(work, c, t, steps, n_rows, lanes)
            pull_charge(work, lanes)
            pull_outputs(work, plant, steps, lanes)
            pull_steps(work, plant, steps, path, inputs, held, ran, lanes)
            pull_act(work, lanes)

    return compiled_with(pull, rules.digest)
