"""Back through one control step: replay it from its start, then pull cotangents back through its kernels in turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from wtg_gym.envs.task import apply_actions
from wtg_gym.envs.task_records import TASK, read_task
from wtg_gym.gradients.generated import Rules, Steps, compiled_with
from wtg_gym.physics.compiled import compiled, inlined
from wtg_gym.physics.dynamics import derivatives
from wtg_gym.physics.elementary import fma
from wtg_gym.physics.integration import apply_network_changes, enter_interval
from wtg_gym.physics.layout import LANE, Floats, LaneData, Lanes, Plant, rows_of
from wtg_gym.physics.protection import PROTECTION_INTERVAL_S, look_at_grid, track_extremes, update_status


@compiled
def _evaluate(work: Floats, plant: Plant, fraction: float, lanes: Lanes) -> None:
    derivatives(work, plant.constants[0], fraction, lanes)


@inlined
def _copy(source: Floats, row: int, target: Floats, target_row: int, width: int) -> None:
    for x in range(width):
        target[target_row * width + x] = source[row * width + x]


@inlined
def _ahead(stage: int, h: float) -> float:
    """Return how far a stage's rates move the states for the next one [s]."""
    return h if stage == 2 else 0.5 * h


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
    width, rows, h, n = len(lanes), rows_of(c), c["simulation_dt"], steps.states.size
    part = 1.0 / c["n_substeps"]
    noise_y, total = np.empty(width), np.empty(n * width)
    active, clock = (rows.lane + LANE.active) * width, (rows.lane + LANE.step) * width
    between_looks = max(1, int(PROTECTION_INTERVAL_S / h + 1e-6))
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
        for x in range(width):
            work[clock + x] += 1.0 if ran[step, x] > 0.5 else 0.0
        track_extremes(work, c, lanes)
        if (step + 1) % between_looks == 0 or step + 1 == c["n_substeps"]:
            look_at_grid(work, c, lanes)
            update_status(work, c, width)
    _evaluate(work, plant, 1.0, lanes)


def build_pull(rules: Rules) -> Any:
    """Return the compiled function that goes back through one control step."""
    pull_act, pull_rates, pull_charge, n_rows = rules.pull_act, rules.pull_rates, rules.pull_charge, rules.n_rows
    first_action = int(rules.actions[0]) if rules.actions.size else n_rows

    def pull_steps(
        work: Floats, plant: Plant, steps: Steps, path: Floats, inputs: Floats, held: Floats, ran: Floats, lanes: Lanes
    ) -> None:
        """Go back through the simulation steps of a control interval: the adjoint of the Runge-Kutta method."""
        c = plant.constants[0]
        width, h, n = len(lanes), c["simulation_dt"], steps.states.size
        part = 1.0 / c["n_substeps"]
        end, through = np.empty(n * width), np.empty(n * width)
        for step in range(c["n_substeps"] - 1, -1, -1):
            for i in range(steps.inputs.size):
                _copy(inputs[step], i, work, steps.inputs[i], width)
            for i in range(n):
                for x in range(width):
                    # A state at its limit does not follow.
                    reached = path[step, 4, i * width + x]
                    free = (reached > steps.low[i] and reached < steps.high[i]) or ran[step, x] < 0.5
                    given = work[(n_rows + steps.states[i]) * width + x] if free else 0.0
                    end[i * width + x] = given
                    through[i * width + x] = given
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
                pull_rates(work, (step + offset) * part, lanes)
                for i in range(n):
                    for x in range(width):
                        through[i * width + x] += work[(n_rows + steps.states[i]) * width + x]
            for i in range(n):
                _copy(through, i, work, n_rows + steps.states[i], width)
            for i in range(steps.references.size):
                for x in range(width):
                    # The reference of a governor that is lost here is where its gate was; no droop acts from here on.
                    if held[step, i * width + x] > 0.5:
                        work[(n_rows + steps.droops[i]) * width + x] = 0.0
                        at = (n_rows + steps.references[i]) * width + x
                        work[(n_rows + steps.gates[i]) * width + x] += work[at]
                        work[at] = 0.0

    def pull_outputs(work: Floats, steps: Steps, lanes: Lanes) -> None:
        """Go back through the evaluation at the end of a control interval, whose outputs are charged and observed."""
        width, n = len(lanes), steps.states.size
        end = np.empty(n * width)
        for i in range(n):
            _copy(work, n_rows + steps.states[i], end, i, width)
            for x in range(width):
                work[(n_rows + steps.rates[i]) * width + x] = 0.0
        pull_rates(work, 1.0, lanes)
        for i in range(n):
            for x in range(width):
                work[(n_rows + steps.states[i]) * width + x] += end[i * width + x]
        for i in range(steps.outputs.size):
            for x in range(width):
                work[(n_rows + steps.outputs[i]) * width + x] = 0.0

    compiled_outputs = compiled_with(pull_outputs, rules.digest)
    compiled_steps = compiled_with(pull_steps, rules.digest)

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
            pull_charge(work, lanes)
            compiled_outputs(work, steps, lanes)
            compiled_steps(work, plant, steps, path, inputs, held, ran, lanes)
            pull_act(work, lanes)

    return compiled_with(pull, rules.digest)
