"""Facts about wrong actions and steps at the wrong time: refused, and nothing has moved."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import actions_of, calm, eventful, single_steps, vector_steps
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv

ACTIONS = actions_of(40, 60, 3)

#: For each rule an action of a single environment that breaks it.
WRONG: dict[str, Any] = {
    "nan": [0.0, math.nan, 0.0, 0.0],
    "infinite": [0.0, 0.0, 0.0, -math.inf],
    "single precision": np.array([0.0, 0.0, 0.0, np.inf], dtype=np.float32),
    "short": [0.0] * 3,
    "column": np.zeros((4, 1)),
    "scalar": 0.0,
    "none": None,
    "text": ["0.1"] * 4,
    "objects": [{}] * 4,
    "ragged": [[0.0], [0.0, 0.0], 0.0, 0.0],
    "complex": np.zeros(4, dtype=np.complex128),
    "huge integer": [10**400] * 4,
}


def accepted(env: GFMWTGEnv | GFMWTGVectorEnv, wrong: dict[str, Any]) -> list[str]:
    """Return the names of the wrong actions that a step does not refuse with a ValueError about actions."""
    names = []
    for name, action in wrong.items():
        try:
            env.step(action)
            names.append(name)
        except ValueError as error:
            if "action" not in str(error):
                names.append(name)
    return names


@pytest.mark.filterwarnings("error")
def test_wrong_actions_are_refused_and_nothing_has_moved():
    env = GFMWTGEnv(scenario=eventful().to_dict(), version="v0")
    single_steps(env, ACTIONS[:7, 0], AutoresetMode.DISABLED, seed=0)
    twin = copy.deepcopy(env)
    assert accepted(env, WRONG) == []
    after = single_steps(env, ACTIONS[7:40, 0], AutoresetMode.DISABLED)
    assert after == single_steps(twin, ACTIONS[7:40, 0], AutoresetMode.DISABLED)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.filterwarnings("error")
def test_wrong_actions_of_one_lane_are_refused_and_no_lane_has_moved(mode: AutoresetMode):
    fine = [0.0] * 4
    wrong = {name: [fine, action, fine] for name, action in WRONG.items()}
    wrong |= {"none": None, "scalar": 0.0, "complex": np.zeros((3, 4), dtype=np.complex128)}
    env = GFMWTGVectorEnv(3, duration_s=2.0, autoreset_mode=mode, version="v0")
    # Up to the end of an episode, where lanes wait for their reset.
    vector_steps(env, ACTIONS[:20], seed=0)
    twin = copy.deepcopy(env)
    assert accepted(env, wrong) == []
    assert vector_steps(env, ACTIONS[20:]) == vector_steps(twin, ACTIONS[20:])


def test_message_names_the_shape_or_the_value_and_the_lane_and_what_is_allowed():
    env, single = GFMWTGVectorEnv(3, duration_s=2.0, version="v0"), GFMWTGEnv(duration_s=2.0, version="v0")
    env.reset(seed=0), single.reset(seed=0)
    for shape in ((4,), (2, 4), (3, 3), (12,), (1, 3, 4)):
        with pytest.raises(ValueError, match=r"\(3, 4\)"):
            env.step(np.zeros(shape))
    with pytest.raises(ValueError, match=r"\(4,\).*\(3,\)"):
        single.step(np.zeros(3))
    actions = np.zeros((3, 4))
    actions[2, 1] = math.nan
    with pytest.raises(ValueError, match=r"nan.*lane 2.*-1 … 1"):
        env.step(actions)


@pytest.mark.parametrize("kind", [list, tuple, np.float32, np.float64, np.int8, bool, object])
def test_anything_that_is_numbers_is_an_action(kind: Any):
    env, twin = (GFMWTGEnv(duration_s=2.0, version="v0") for _ in range(2))
    env.reset(seed=0), twin.reset(seed=0)
    values = [1, 0, 1, 0]
    given = kind(values) if kind in (list, tuple) else np.array(values, dtype=kind)
    assert env.step(given)[0].tobytes() == twin.step(np.array(values, dtype=np.float32))[0].tobytes()


@pytest.mark.parametrize("value", [1.0 + 1e-9, 1e308])
def test_action_out_of_range_is_clipped(value: float):
    for sign in (1.0, -1.0):
        env, twin = (GFMWTGEnv(scenario=eventful().to_dict(), version="v0") for _ in range(2))
        far = np.full((40, 4), sign * value)
        one = single_steps(env, far, AutoresetMode.DISABLED, seed=0)
        assert one == single_steps(twin, np.clip(far, -1.0, 1.0), AutoresetMode.DISABLED, seed=0)


def test_given_action_is_neither_changed_nor_kept():
    env, twin = (GFMWTGEnv(scenario=eventful().to_dict(), version="v0") for _ in range(2))
    env.reset(seed=0), twin.reset(seed=0)
    action = np.full(4, 3.0)
    env.step(action), twin.step(np.full(4, 3.0))
    assert action.tolist() == [3.0] * 4
    action[:] = -1.0
    assert env.step(np.zeros(4))[0].tobytes() == twin.step(np.zeros(4))[0].tobytes()


def test_step_before_the_first_reset_is_a_runtime_error():
    with pytest.raises(RuntimeError, match=r"reset\(\)"):
        GFMWTGEnv(duration_s=2.0, version="v0").step(np.zeros(4))
    for mode in AutoresetMode:
        with pytest.raises(RuntimeError, match=r"reset\(\)"):
            GFMWTGVectorEnv(2, duration_s=2.0, autoreset_mode=mode, version="v0").step(np.zeros((2, 4)))


def test_step_of_a_batch_of_which_a_lane_was_never_started_is_a_runtime_error():
    for mode in AutoresetMode:
        env = GFMWTGVectorEnv(2, duration_s=2.0, autoreset_mode=mode, version="v0")
        env.reset(seed=0, options={"reset_mask": np.array([True, False])})
        with pytest.raises(RuntimeError, match=r"\[1\].*reset\(\)"):
            env.step(np.zeros((2, 4)))


def test_step_after_the_end_is_a_runtime_error_until_the_next_reset():
    env = GFMWTGEnv(duration_s=1.0, version="v0")
    single_steps(env, ACTIONS[:9, 0], AutoresetMode.DISABLED, seed=0)
    *_, truncated, _ = env.step(np.zeros(4))
    assert truncated
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"reset\(\)"):
            env.step(np.zeros(4))
    env.reset()
    env.step(np.zeros(4))


def test_step_of_a_batch_with_an_ended_lane_and_resets_disabled_is_a_runtime_error():
    env = GFMWTGVectorEnv(3, duration_s=2.0, autoreset_mode="Disabled", version="v0")
    env.reset(seed=0, options={"scenarios": [calm(duration_s=2.0), calm(duration_s=1.0), calm(duration_s=2.0)]})
    for _ in range(10):
        *_, truncated, _ = env.step(np.zeros((3, 4)))
    assert truncated.tolist() == [False, True, False]
    with pytest.raises(RuntimeError, match=r"\[1\].*reset\(\)"):
        env.step(np.zeros((3, 4)))
    _, infos = env.reset(options={"reset_mask": truncated})
    assert infos["time_s"].tolist() == [1.0, 0.0, 1.0]
    env.step(np.zeros((3, 4)))


STEP = {"kind": "load_step", "time_s": 1.0, "bus": 2, "power_mw": 5.0}
REFUSED: dict[str, dict[str, Any]] = {
    "not a scenario": {"seed": 2**70},
    "event off the grid": {"events": [{**STEP, "time_s": 1.005}]},
    "unknown bus": {"events": [{**STEP, "bus": 99}]},
    "length off the grid": {"duration_s": 2.05},
    "split network": {"events": [{"kind": "line_trip", "time_s": 1.0, "from_bus": 7, "to_bus": 8}]},
    "no equilibrium": {"load_level": 0.3},
}


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("n_lanes", [None, 3])
def test_refused_reset_does_not_bend_the_running_episodes(n_lanes: int | None, name: str):
    refused = {**calm(25.0).to_dict(), **REFUSED[name]}
    if n_lanes is None:
        env: Any = GFMWTGEnv(duration_s=4.0, version="v0")
        single_steps(env, ACTIONS[:7, 0], AutoresetMode.DISABLED, seed=0)
        actions, options = ACTIONS[7:20, 0], {"scenario": refused}
    else:
        env = GFMWTGVectorEnv(n_lanes, duration_s=4.0, version="v0")
        vector_steps(env, ACTIONS[:7], seed=0)
        actions, options = ACTIONS[7:20], {"scenarios": [calm(), refused, calm()]}
    twin = copy.deepcopy(env)
    with pytest.raises(ValueError):
        env.reset(options=options)
    for action in actions:
        try:
            observation, reward, *_ = env.step(action)
        except RuntimeError as error:
            assert "reset()" in str(error)
            return
        expected, other, *_ = twin.step(action)
        assert observation.tobytes() == expected.tobytes() and np.all(reward == other)
