"""The environment as functions of JAX plays what the environment plays, and its gradients are those of the tape."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.functional.played_cases import cases
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task_records import Info
from wtg_gym.gradients import Tape
from wtg_gym.physics.protection import Status

jax = pytest.importorskip("jax", reason="JAX is not installed here: pip install '.[jax]'")
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp  # noqa: E402

from wtg_gym.functional import EnvParams, EnvState, FunctionalEnv  # noqa: E402

Floats = npt.NDArray[np.float64]
N_STEPS = 600


@functools.cache
def env() -> FunctionalEnv:
    return FunctionalEnv(EnvSettings(version="v0"), n_scenarios=2)


@functools.cache
def params() -> EnvParams:
    return env().bank(list(cases(TaskLanes(EnvSettings(version="v0"), 1)).values()))


@functools.cache
def actions() -> Floats:
    """Random ones, that go beyond what is allowed."""
    shape = (N_STEPS, params().n_scenarios, env().num_actions)
    return np.random.default_rng(0).uniform(-1.2, 1.2, shape)


def started(places: Any) -> EnvState:
    state: EnvState = jax.vmap(lambda place: env().start(place, params())[1])(jnp.asarray(places))
    return state


def rolled_out(states: EnvState, actions: Any) -> Any:
    """What every step of episodes side by side returns, and the states after it."""
    key = jax.random.key(0)

    def step(states: EnvState, own: Any) -> Any:
        seen, states, *rest = jax.vmap(lambda state, action: env().step_env(key, state, action, params()))(states, own)
        return states, (seen, states, *rest)

    return jax.lax.scan(step, states, actions)[1]


@functools.cache
def played() -> Any:
    """The whole episodes of all cases."""
    return jax.tree.map(np.asarray, jax.jit(rolled_out)(started(range(params().n_scenarios)), actions()))


def test_whole_episodes_are_those_of_the_environment() -> None:
    lanes = TaskLanes(EnvSettings(version="v0"), params().n_scenarios)
    scenarios = cases(lanes)
    lanes.start(list(range(len(scenarios))), list(scenarios.values()))
    simulator, rows = lanes.simulator, list(env().rows)
    seen, states, rewards, done, info = played()
    ran, ends = np.ones(lanes.n_lanes, dtype=bool), np.full(lanes.n_lanes, N_STEPS)
    for k, own in enumerate(actions()):
        lanes.step(own)
        blocks = simulator._view.transpose(0, 2, 1).reshape(-1, simulator.layout.n_rows)[: lanes.n_lanes]
        assert np.abs(seen[k] - blocks[:, -lanes.n_observation :])[ran].max() <= 1e-9
        assert np.abs(seen[k] - lanes.observations)[ran].max() <= 1e-6
        assert np.abs(states.rows[k] - blocks[:, rows])[ran].max() <= 1e-9
        assert rewards[k][ran] == pytest.approx(lanes.rewards[ran], rel=1e-9, abs=1e-12)
        assert not rewards[k][~ran].any()
        assert np.array_equal(info["terminated"][k], lanes.outputs.terminated)
        assert np.array_equal(info["truncated"][k], lanes.outputs.truncated)
        assert np.array_equal(info["status"][k], lanes.statuses())
        for name, numbers in zip(Info._fields, lanes.outputs.infos.T, strict=True):
            assert info[name][k][ran] == pytest.approx(numbers[ran], rel=1e-9, abs=1e-9), name
        ends[ran & done[k]] = k + 1
        ran &= ~done[k]
    assert np.array_equal(done, info["terminated"] | info["truncated"]) and not ran.any()
    assert np.array_equal(info["scenario_seed"][0], lanes.scenario_seeds)
    # Some end early, and what the cases are named after has happened.
    by_name = dict(zip(scenarios, lanes.statuses().tolist(), strict=True))
    assert by_name["far too much load"] != Status.RUNNING and by_name["far too little load"] != Status.RUNNING
    assert sum(status == Status.RUNNING for status in by_name.values()) >= 6
    assert (ends < 100).sum() >= 2 and (ends == N_STEPS).sum() >= 6


def test_an_episode_alone_is_that_of_a_batch_and_compiled_code_that_of_python() -> None:
    key, steps = jax.random.key(0), 3
    seen, states, rewards, *_ = played()
    alone, place = env().start(1, params())[1], 1
    assert np.array_equal(env().start(1, params())[0], params().observation[1])
    with jax.disable_jit():
        for k in range(steps):
            found = env().step_env(key, alone, actions()[k, place], params())
            alone = found[1]
            assert np.abs(found[0] - seen[k, place]).max() <= 1e-12
            assert np.abs(alone.rows - states.rows[k, place]).max() <= 1e-11
            assert found[2] == pytest.approx(rewards[k, place], rel=1e-11)
            assert alone.time == k + 1 == states.time[k, place]


def test_an_episode_that_ends_is_followed_by_another() -> None:
    seen, states, rewards, done, _ = played()
    last = int(np.argmax(done[:, 0]))
    state = EnvState(*(array[last - 1, 0] for array in states))
    keys = jax.random.split(jax.random.key(1), 20)
    first, fresh = env().reset(keys[0], params())
    assert fresh.time == 0 and np.array_equal(first, params().observation[fresh.scenario])
    found = jax.vmap(env().step, (0, None, None, None))(keys, state, actions()[last, 0], params())
    observation, after, reward, ended, info = jax.tree.map(np.asarray, found)
    assert ended.all() and info["terminated"].all() and not info["truncated"].any()
    assert reward == pytest.approx(np.full(20, rewards[last, 0]), rel=1e-9)
    assert np.abs(info["final_observation"] - seen[last, 0]).max() <= 1e-12
    # Each key chooses a scenario, and not all the same one.
    assert (after.time == 0).all() and len(set(after.scenario.tolist())) > 5
    assert np.array_equal(observation, params().observation[after.scenario])
    assert np.array_equal(after.rows, params().start[after.scenario])
    assert np.array_equal(after.network, params().first_network[after.scenario])


def test_gradients_are_those_of_the_tape() -> None:
    n_steps, places = 30, [1, 0, 8]
    tape = Tape(EnvSettings(version="v0"), len(places), 1)
    scenarios = list(cases(tape.lanes).values())
    given = actions()[:n_steps, places]
    expected = tape.gradient([scenarios[place] for place in places], given)

    def cost(given: Any) -> Any:
        return -rolled_out(started(places), given)[2].sum(axis=0)

    costs, pull = jax.vjp(jax.jit(cost), jnp.asarray(given))
    (found,) = pull(jnp.ones(len(places)))
    assert costs == pytest.approx(expected.terms.sum(axis=1), rel=1e-10)
    assert np.abs(expected.actions).max() > 1e-2
    assert np.abs(found - expected.actions).max() <= 1e-10 * np.abs(expected.actions).max()
    # Actions beyond what is allowed change nothing.
    assert not found[np.abs(given) > 1.0].any() and found[np.abs(given) < 1.0].any()


def test_spaces_and_default_parameters() -> None:
    assert env().name == "GFMWTG-14bus-v0" and env().default_params.n_scenarios == 2
    assert env().default_params.max_steps_in_episode == N_STEPS
    assert env().default_params.scenario_seed.tolist() == list(
        TaskLanes(EnvSettings(version="v0"), 1).suite.seeds("train")[:2]
    )
    space = env().action_space(params())
    assert space.shape == (env().num_actions,) and space.contains(space.sample(jax.random.key(0)))
    assert not space.contains(jnp.full(space.shape, 2.0))
    seen = env().observation_space(params())
    assert seen.shape == (len(env().observation_names),) and seen.contains(jnp.asarray(params().observation[0]))


def test_a_fixed_scenario_is_the_bank() -> None:
    scenario = next(iter(cases(TaskLanes(EnvSettings(version="v0"), 1)).values()))
    own = FunctionalEnv(EnvSettings(scenario=scenario, version="v0")).default_params
    assert own.n_scenarios == 1 and np.array_equal(own.start[0], params().start[0])


@pytest.mark.parametrize(
    "settings", [{"version": "v1"}, {"physics": "extended"}, {"physics": "nrel-5mw"}, {"on_failure": "trip"}]
)
def test_other_versions_and_physics_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"got version=.*{next(iter(settings.values()))!r}"):
        FunctionalEnv(EnvSettings(**{"version": "v0", **settings}))


def test_floats_of_32_bits_are_refused() -> None:
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="jax_enable_x64"):
            FunctionalEnv(EnvSettings(version="v0"))
    finally:
        jax.config.update("jax_enable_x64", True)
