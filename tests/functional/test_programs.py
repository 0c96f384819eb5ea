"""The kernels of a step as programs, run in plain Python: the twin in JAX consists of them."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.functional.played_cases import cases
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.functional import bank
from wtg_gym.functional.branches import Cells, is_finite, without_branches
from wtg_gym.functional.programs import COTANGENT, Program, Programs, trace
from wtg_gym.gradients import expressions as ex
from wtg_gym.physics.elementary import exponential, select, sine_cosine
from wtg_gym.physics.protection import PROTECTION_INTERVAL_S, Status

Floats = npt.NDArray[np.float64]
OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": lambda a, b: np.float64(a) / b,
    "power": operator.pow,
    "neg": operator.neg,
    "abs": abs,
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": operator.not_,
    "finite": math.isfinite,
    "min": min,
    "max": max,
    "sqrt": math.sqrt,
    "floor": math.floor,
    "ceil": math.ceil,
    "exponential": exponential,
    "sine": lambda a: sine_cosine(a)[0],
    "cosine": lambda a: sine_cosine(a)[1],
    "select": select,
    "fma": lambda a, b, c: a * b + c,
}


class _Record(tuple[Any, ...]):
    """Stands for what kernels load: numbers that belong together."""

    def __new__(cls, *values: Any) -> _Record:
        return super().__new__(cls, values)


def judged(block: Any, x: int, limits: tuple[float, float], trips: bool) -> None:
    status, pair = 0, _Record(0.0, 0.0)
    for i in range(2):
        a, b = block[2 * i], block[2 * i + 1]
        if a < limits[0]:
            continue
        if a > limits[1] or not is_finite(b):
            status = i + 1
            pair = _Record(a, b)
        elif b > 0.0 and not a > 0.5:
            seen = a + b
            if trips:
                seen = -seen
            block[10 + i] = seen
        if status != 0:
            block[20 + x] = status
            for k in range(2):
                block[30 + k] = pair[k]


@pytest.mark.parametrize("trips", [False, True])
@ex.making()
def test_branches_become_choices_with_the_same_outcome(trips: bool) -> None:
    block = Cells(ex.row_of_block)
    without_branches(judged)(block, 0, (-1.0, 2.0), trips)
    program, outcomes = Program(block), set()
    for values in itertools.product((-2.0, 0.0, 1.0, 3.0), (-1.0, 2.0, math.inf), repeat=2):
        plain = {**dict.fromkeys(program.stores, 7.0), **dict(enumerate(values))}
        found = program.run(OPERATIONS, plain)
        judged(plain, 0, (-1.0, 2.0), trips)
        assert found == {row: plain[row] for row in program.stores}
        outcomes.add(tuple(found.values()))
    assert len(outcomes) > 20 and {10, 11, 20, 30, 31} == set(program.stores)


def played(programs: Programs, lanes: TaskLanes, params: bank.EnvParams, place: int, actions: Floats) -> list[Any]:
    """What the programs say at every step of an episode of the bank."""
    inputs, plant, step = programs.inputs, lanes.simulator.plant, lanes.simulator.layout.lane("step")
    between = int(PROTECTION_INTERVAL_S / plant.simulation_dt + 1e-6)
    values = dict(zip(programs.kept, params.start[place], strict=True))
    network, said = params.first_network[place], []
    for k, action in enumerate(actions):
        given = (action, params.wind[place, k], params.wind[place, k + 1], [params.noise[place, k]])
        rows = (inputs.actions, inputs.wind_start, inputs.wind_end, [inputs.noise])
        for own, numbers in zip(rows, given, strict=True):
            values |= zip(own, numbers, strict=True)
        values |= programs.begin.forward.run(OPERATIONS, values)
        for substep, stages in enumerate(programs.stages, start=1):
            network += values[step] >= params.until[network]
            values |= zip((*programs.network, *inputs.lost), params.network[network], strict=True)
            values |= programs.enter.forward.run(OPERATIONS, values)
            for stage in stages:
                values |= zip(inputs.stage, stage, strict=True)
                values = {**dict.fromkeys(programs.staged, 0.0), **values}
                values |= programs.stage.forward.run(OPERATIONS, values)
            values[inputs.samples] = float(substep % between == 0 or substep == len(programs.stages))
            values |= programs.leave.forward.run(OPERATIONS, values)
        values |= programs.end.forward.run(OPERATIONS, values)
        said.append(dict(values))
        if values[programs.reported.terminated] or values[programs.reported.truncated]:
            break
    return said


@pytest.mark.parametrize("control_dt", [0.1, 0.25])
def test_the_programs_play_the_episodes_of_the_environment(control_dt: float) -> None:
    lanes = TaskLanes(EnvSettings(control_dt=control_dt, observation_mode="privileged", version="v0"), 1)
    simulator = lanes.simulator
    programs = trace(simulator.plant, lanes.task, simulator.layout, lanes.n_action, lanes.n_observation)
    scenarios = [scenario for name, scenario in cases(lanes).items() if name in ("far too much load", "lost governor")]
    params = bank.prepare(lanes, programs, scenarios)
    statuses = []
    for place, scenario in enumerate(scenarios):
        actions = np.random.default_rng(place).uniform(-1.0, 1.0, (round(6.0 / control_dt), lanes.n_action))
        found = played(programs, lanes, params, place, actions)
        lanes.start([0], [scenario])
        for own, action in zip(found, actions, strict=False):
            lanes.step(action[np.newaxis])
            block = simulator.blocks[0]
            kept = np.array([own[row] for row in programs.kept])
            assert kept == pytest.approx(block[list(programs.kept)], rel=1e-9, abs=1e-9)
            seen = np.array([own[row] for row in programs.reported.observation])
            assert seen == pytest.approx(block[-lanes.n_observation :], rel=1e-9, abs=1e-9)
            assert own[programs.reported.reward] == pytest.approx(lanes.rewards[0], rel=1e-9)
            assert own[programs.reported.terminated] == float(lanes.outputs.terminated[0])
        statuses.append(int(lanes.statuses()[0]))
        assert len(found) == len(actions) or statuses[-1]
    assert statuses[0] != Status.RUNNING and statuses[1] == Status.RUNNING


@ex.making()
def test_a_program_in_reverse_is_its_derivative() -> None:
    x, y = ex.row_of_block(0), ex.row_of_block(1)
    pulled = Program({5: x * y + ex.exponential(y), 6: ex.select(x < 1.0, x, 2.0 * y)}).pulled()
    found = pulled.run(OPERATIONS, {0: 0.5, 1: -2.0, COTANGENT + 5: 3.0, COTANGENT + 6: 7.0})
    assert found == pytest.approx({0: 3.0 * -2.0 + 7.0, 1: 3.0 * (0.5 + math.exp(-2.0))})


def test_a_bank_needs_scenarios() -> None:
    lanes = TaskLanes(EnvSettings(version="v0"), 1)
    with pytest.raises(ValueError, match="at least one scenario"):
        bank.prepare(lanes, Any, [])  # type: ignore[arg-type]
