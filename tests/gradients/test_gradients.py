"""Gradients of an episode's cost: the kernels', checked by JAX and by central differences of the environment."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.gradients import expressions as ex
from wtg_gym.gradients.adjoint import replay
from wtg_gym.gradients.generated import programs_of
from wtg_gym.gradients.tape import Gradient, Tape
from wtg_gym.physics.elementary import exponential, fma, sine_cosine
from wtg_gym.physics.scenario import Scenario

Floats = npt.NDArray[np.float64]
N_LANES = 3


@functools.cache
def tape_of(**settings: Any) -> Tape:
    return Tape(EnvSettings(**settings), N_LANES, 1)


def drawn(tape: Tape, first: int = 1_000_000) -> list[Scenario]:
    return tape.lanes.scenarios(list(range(first, first + N_LANES)))


def actions_of(tape: Tape, n_steps: int, scale: float = 0.4) -> Floats:
    shape = (n_steps, N_LANES, tape.lanes.n_action)
    return np.random.default_rng(1).uniform(-scale, scale, shape)


def played(tape: Tape, scenarios: list[Scenario], actions: Floats, law: Floats | None = None) -> Floats:
    """Terms of the cost of every lane (n_lanes, n_terms), by the environment alone."""
    tape.start(scenarios)
    if law is not None:
        tape.set_law(law)
    return np.sum([tape.step(own)[1] for own in actions], axis=0)


def slopes(tape: Tape, scenarios: list[Scenario], actions: Floats, way: Floats, h: float = 1e-5) -> Floats:
    """Central differences of the terms along a way through the actions (n_lanes, n_terms)."""
    up, down = (played(tape, scenarios, actions + sign * h * way) for sign in (1.0, -1.0))
    return (up - down) / (2.0 * h)


def along(found: Gradient, way: Floats) -> Floats:
    return np.einsum("kla,kla->l", found.actions, way)


def compiled_by_python(source: str) -> Any:
    space: dict[str, Any] = {"fma": fma, "sine_cosine": sine_cosine, "exponential": exponential}
    exec(source, {**space, "math": math, "inf": math.inf}, space)
    return space["traced"]


def test_the_traced_right_hand_side_is_that_of_the_kernel() -> None:
    lanes = TaskLanes(EnvSettings(), 1)
    lanes.start([0], lanes.scenarios([1_000_000]))
    simulator = lanes.simulator
    rng = np.random.default_rng(0)
    for _ in range(30):
        lanes.step(rng.uniform(-1.0, 1.0, (1, lanes.n_action)))
    program = programs_of(simulator.plant, lanes.task, simulator.layout.n_rows, lanes.n_action).rates
    block = simulator.blocks[0].copy()
    compiled_by_python(ex.function_source("traced", ("fraction",), program))(block, 0.0, (0,))
    simulator.evaluate()
    rates = simulator.rates()
    assert np.abs(rates).max() > 1e-3
    assert block[simulator.layout.rate_rows] == pytest.approx(rates, rel=1e-12, abs=1e-12)


def test_a_step_is_replayed_to_the_last_bit() -> None:
    tape = tape_of()
    scenarios = drawn(tape)
    tape.start(scenarios)
    for own in actions_of(tape, 60):
        tape.step(own)
    simulator, steps = tape.lanes.simulator, tape._rules.steps
    width, n = simulator.width, steps.states.size
    lane = [int(simulator.layout.lane(name)) for name in ("step", "active", "status", "coi", "least_voltage")]
    for block, after in zip(tape._blocks, [*tape._blocks[1:], simulator.blocks], strict=True):
        # Actions and events have long been tested; the next step's rows hold those of this one.
        work = block[0].copy()
        for rows in (simulator.layout.wtg("k_offset"), simulator.layout.wtg("inv_tau")):
            for row in rows:
                work[row * width : (row + 1) * width] = after[0][row * width : (row + 1) * width]
        path, ran = np.empty((4, 5, n * width)), np.empty((4, width))
        inputs, held = np.empty((4, steps.inputs.size * width)), np.empty((4, steps.droops.size * width))
        replay(work, 0, simulator.plant, simulator.data, steps, path, inputs, held, ran, simulator.lanes)
        for row in (*steps.states.tolist(), *lane, *steps.outputs.tolist()):
            ours = work.reshape(-1, width)[row, :N_LANES]
            assert np.array_equal(ours, after[0].reshape(-1, width)[row, :N_LANES]), row


def test_the_gradient_is_that_of_jax() -> None:
    pytest.importorskip("jax", reason="JAX, the second opinion on gradients, is not installed here")
    import jax

    from tests.gradients.jax_reference import JaxEpisode

    tape = tape_of()
    scenarios, actions = drawn(tape), actions_of(tape, 25)
    found = tape.gradient(scenarios, actions)
    episode = JaxEpisode(tape)
    tape.start(scenarios)
    law = tape.law()
    for own in actions:
        tape.step(own)
    by_jax = episode.terms(actions, law)
    assert pytest.approx(found.terms, rel=1e-10, abs=1e-12) == np.asarray(by_jax.sum(0)).T
    by_actions, by_law = jax.grad(lambda *given: episode.terms(*given).sum(), argnums=(0, 1))(actions, law)
    assert np.abs(by_actions).max() > 1e-2
    assert np.abs(found.actions - by_actions).max() <= 1e-10 * np.abs(by_actions).max()
    assert np.abs(found.law - by_law).max() <= 1e-10 * np.abs(by_law).max()


@pytest.mark.parametrize("term", [*COST_TERMS[:-1], None])
def test_the_gradient_is_that_of_central_differences(term: str | None) -> None:
    tape = tape_of()
    scenarios, actions = drawn(tape), actions_of(tape, 300)
    way = np.random.default_rng(2).normal(size=actions.shape)
    found = tape.gradient(scenarios, actions, None if term is None else {term: 1.0})
    measured = _measured_slopes()
    expected = measured.sum(axis=1) if term is None else measured[:, COST_TERMS.index(term)]
    assert along(found, way) == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


@functools.cache
def _measured_slopes() -> Floats:
    tape = tape_of()
    actions = actions_of(tape, 300)
    return slopes(tape, drawn(tape), actions, np.random.default_rng(2).normal(size=actions.shape))
