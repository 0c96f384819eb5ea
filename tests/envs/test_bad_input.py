"""Bad settings, scenarios, seeds, actions and snapshots are refused by name, and nothing has moved."""

import copy
import dataclasses
import math
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import actions_of, calm, eventful, single_steps, started, vector_steps
from wtg_gym import ENV_IDS, GFMWTGEnv, GFMWTGVectorEnv, Scenario, TrackingLaw, get_suite
from wtg_gym.envs import EnvSettings
from wtg_gym.physics.sensors import Sensors

NAN = math.nan
ACTIONS = actions_of(40, 60, 3)
NEXT_STEP = AutoresetMode.NEXT_STEP
CALM_V1 = calm(n_wtg=4)
ONE_BIAS = {**CALM_V1.to_dict(), "sensors": {"seed": 1, "wind_bias": [0.0]}}
SENSED = dataclasses.replace(get_suite("standard").scenario(20_000), sensors=Sensors(seed=1, wind_bias=(0.0, 0.0)))
V1: dict[str, Any] = {"version": "v1"}
QUICK = TrackingLaw(name="quick", k_min=0.7, k_nominal=0.6, k_max=0.5, damping_time_constant_s=0.05)
LONG_STEPS = {"control_dt": 0.2, "plant": {"simulation_dt": 0.04}, "scenario": calm().to_dict()}
SLOW = Scenario(name="slow", wind_speed=np.array([[8.0], [4.5]]))

SETTINGS: list[tuple[dict[str, Any], str]] = [
    ({"strategy": "x"}, "unknown strategy 'x'.*mppt.*coordinated-piecewise"),
    ({"action_mode": "x"}, "action_mode 'x'.*k, tau, k.tau"),
    ({"suite": ""}, "unknown suite ''"),
    ({"grid": 5}, "grid must be a name, the path of a file or a Grid, got 5"),
    ({"plant": {"simulation_dt": NAN}}, "simulation_dt = nan s is outside the allowed range 5e-05 … 0.05 s"),
    ({"plant": {1: 2}}, r"unknown settings of a plant \['1'\]"),
    ({"suite": "x"}, "suite 'x'.*paper.*weak-grid"),
    ({"plant": {"physics": "x"}}, "physics 'x'.*paper, extended, nrel-5mw"),
    ({"groups": [{"buss": 2}]}, "buss"),
    ({"plant": {"gruops": 3}}, "gruops"),
    ({"plant": {"control": {"droop": 20.0}}}, "unknown settings of control .'droop'.; .*droop_gain_pu"),
    ({"plant": {"limits": {}}}, "limits must be wtg_gym.physics.parameters.ConverterLimitParameters, got"),
    ({"plant": 3}, "plant must be a Plant or a dictionary .* got 3"),
    ({"plant": {"interval_s": 0.2}}, "interval_s is no part of plant here: give the argument"),
    ({**V1, "plant": {"physics": "paper"}}, "cannot go back to the physics of the paper"),
    ({"duration_s": 2.05}, "duration_s.*2.05.*0.1 s"),
    ({"plant": {"simulation_dt": 0.06}}, "simulation_dt.*0.06.*0.05 s"),
    ({"strategy": QUICK, **LONG_STEPS}, "simulation_dt = 0.04 s .* at most 0.0332 s"),
    ({"weights": {"x": 1}}, "weight.*'x'.*frequency.*cap"),
    ({"weights": {"cap": 0}}, "weights: cap = 0 1/s"),
    ({"suite": "standard-v1"}, "suite 'standard-v1' is of version v1, not v0; choose one of paper"),
    ({"scenario": SENSED}, "has sensors; version v0 measures exactly"),
    ({"scenario": SLOW, "plant": {"physics": "extended"}}, "WTG group 2 of 2 .* 4.5 m/s, below the under-speed trip"),
    ({"sensors": "exact"}, "sensors.*v1.*v0 measures exactly"),
    ({**V1, "suite": "low-wind"}, "suite 'low-wind'.*standard-v1"),
    ({**V1, "sensors": {"noise": 1.0}}, "sensors.*'noise'.*delay_s"),
    ({**V1, "control_dt": 0.075}, "delay_s of the sensors = 0.1 s.*control intervals of 0.075 s"),
    ({**V1, "control_dt": 0.25}, "control_dt.*0.25.*0.1 s"),
    ({"reward": "gain"}, "reward 'gain'.*score, cost"),
    ({**V1, "sensors": "exact", "scenario": CALM_V1}, "sensors.*scenario.*leave out one"),
    ({**V1, "scenario": ONE_BIAS}, r"wind_bias of the sensors.*WTG group \(4\).*1"),
    ({**V1, "groups": 4}, "20 turbines of 5 MW, give .* % of a load of 220 MW; allowed is a penetration of 40 … 78 %"),
]
BATCH = [
    ({"num_envs": 0}, "num_envs.*1 … 1000000.*0"),
    ({"n_threads": 1.5}, "n_threads.*1.5"),
    ({"autoreset_mode": "x"}, "'x'"),
    ({"max_episode_steps": 0}, "max_episode_steps.*0"),
    ({"render_mode": "human"}, "unknown render_mode of GFMWTGVectorEnv 'human'"),
]
SCENARIOS: list[tuple[dict[str, Any], str]] = [
    ({"seed": 2**70}, "Scenario.seed must be a whole number in 0 … 9223372036854775807"),
    ({"wind_speed": [[8.0]]}, "wind for 1 WTG group.*2 groups"),
    ({"duration_s": 2.05}, "duration_s.*2.05.*0.1 s"),
    ({"duration_s": 4.1}, "4.1 s.*longer than the 4 s"),
    ({"load_noise_bus": 99}, "bus 99.*14"),
    ({"events": [{"kind": "line_trip", "time_s": 1.0, "from_bus": 7, "to_bus": 8}]}, "split"),
    ({"load_level": 0.3, "wind_speed": [[25.0]] * 2}, "cannot start"),
]
RESETS: dict[bool, list[dict[str, Any]]] = {
    False: [
        *({"seed": seed} for seed in (NAN, 1.5, "a", -1, [1])),
        *({"options": options} for options in ({"foo": 1}, {"scenarios": [calm()]}, {"scenario": None}, 3)),
    ],
    True: [
        *({"seed": seed} for seed in (NAN, 1.5, "ab", True, -1, [1], [1, NAN], [1, -1], [1, 2, 3])),
        *({"options": options} for options in ({"foo": 1}, {"scenario": calm()}, {"scenarios": None})),
        *({"options": options} for options in ({"scenarios": [calm()]}, {"scenarios": [calm(), 3]})),
        *({"options": {"reset_mask": mask}} for mask in ([True], [1, 0], [False, False])),
    ],
}
#: Actions that are not finite, of another shape, and no numbers.
WRONG: list[Any] = [
    *([0.0, NAN, 0.0, 0.0], np.array([0.0, 0.0, 0.0, np.inf], dtype=np.float32), [10**400] * 4),
    *([0.0] * 3, np.zeros((4, 1)), [[0.0], [0.0, 0.0], 0.0, 0.0], 0.0, None),
    *(["0.1"] * 4, [{}] * 4, np.zeros(4, dtype=np.complex128)),
]
OTHER_SETTINGS = [
    ({"weights": {"duty": 0.0}, "on_failure": "trip"}, "weights, plant"),
    ({"strategy": "mppt"}, "strategy"),
    (V1, "strategy, weights, plant, version, control_dt, reward"),
]


@pytest.mark.parametrize(("arguments", "message"), SETTINGS, ids=lambda value: str(value)[:40])
def test_wrong_setting_is_refused_with_what_is_allowed_in_one_line(arguments, message):
    for kind in (GFMWTGEnv, lambda **given: GFMWTGVectorEnv(2, **given)):
        with pytest.raises(ValueError, match=message) as refused:
            kind(**{"version": "v0", **arguments})
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("arguments", "message"), BATCH, ids=str)
def test_wrong_argument_of_a_batch_is_refused_with_what_is_allowed(arguments, message):
    with pytest.raises(ValueError, match=message):
        GFMWTGVectorEnv(**{"version": "v0", "num_envs": 2, **arguments})


@pytest.mark.parametrize("make", [GFMWTGEnv, GFMWTGVectorEnv, lambda **given: gym.make(ENV_IDS[0], **given)])
def test_unknown_keyword_is_a_type_error_that_lists_the_known_ones(make):
    with pytest.raises(TypeError, match=r"__init__\(\) got an unexpected keyword argument 'stratgy'") as caught:
        make(stratgy="mppt")
    assert all(field.name in str(caught.value) for field in dataclasses.fields(EnvSettings))
    assert "did you mean 'strategy'?" in str(caught.value)


def test_wrong_scenarios_are_refused_and_running_episodes_go_on():
    env, batch = GFMWTGEnv(duration_s=4.0, version="v0"), GFMWTGVectorEnv(3, duration_s=4.0, version="v0")
    single_steps(env, ACTIONS[:7, 0], AutoresetMode.DISABLED, seed=0), vector_steps(batch, ACTIONS[:7], seed=0)
    twins = copy.deepcopy((env, batch))
    for changes, message in SCENARIOS:
        refused = {**calm().to_dict(), **changes}
        with pytest.raises(ValueError, match=message):
            GFMWTGEnv(scenario=refused, duration_s=4.0, version="v0").reset()
        with pytest.raises(ValueError, match=message):
            env.reset(options={"scenario": refused})
        with pytest.raises(ValueError, match=message):
            batch.reset(options={"scenarios": [calm(), refused, calm()]})
    rest = ACTIONS[7:20]
    assert single_steps(env, rest[:, 0], NEXT_STEP) == single_steps(twins[0], rest[:, 0], NEXT_STEP)
    assert vector_steps(batch, rest) == vector_steps(twins[1], rest)


@pytest.mark.parametrize("batch", RESETS)
def test_wrong_seeds_and_options_are_refused_and_leave_the_stream_of_scenarios_alone(batch):
    kind: Any = (lambda **given: GFMWTGVectorEnv(2, **given)) if batch else GFMWTGEnv
    env, twin = (started(kind(duration_s=4.0, version="v0"), seed=5) for _ in range(2))
    for wrong in RESETS[batch]:
        with pytest.raises((ValueError, gym.error.Error), match=r"(?i)seed|scenario|reset_mask"):
            env.reset(**wrong)
    assert np.all(env.reset()[1]["scenario_seed"] == twin.reset()[1]["scenario_seed"])


@pytest.mark.parametrize("mode", [None, NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.filterwarnings("error")
def test_wrong_actions_are_refused_and_no_env_has_moved(mode):
    if mode is None:
        env: Any = GFMWTGEnv(scenario=eventful().to_dict(), version="v0")
        single_steps(env, ACTIONS[:20, 0], AutoresetMode.DISABLED, seed=0)
        wrong = WRONG
    else:
        # Up to the end of an episode, where environments wait for their reset.
        env = GFMWTGVectorEnv(3, duration_s=2.0, autoreset_mode=mode, version="v0")
        vector_steps(env, ACTIONS[:20], seed=0)
        wrong = [*([[0.0] * 4, action, [0.0] * 4] for action in WRONG), None, 0.0, np.zeros(12), np.zeros((2, 4))]
    twin = copy.deepcopy(env)
    for action in wrong:
        with pytest.raises(ValueError, match="action"):
            env.step(action)
    if mode is None:
        rest = ACTIONS[20:40, 0], AutoresetMode.DISABLED
        assert single_steps(env, *rest) == single_steps(twin, *rest)
    else:
        assert vector_steps(env, ACTIONS[20:]) == vector_steps(twin, ACTIONS[20:])


@pytest.mark.parametrize("kind", [list, np.float64, np.int8, object])
def test_anything_that_is_numbers_is_an_action_which_is_clipped_and_not_kept(kind):
    env, twin = (started(GFMWTGEnv(duration_s=2.0, version="v0"), seed=0) for _ in range(2))
    given = [1, 0, 3, 0] if kind is list else np.array([1, 0, 3, 0], dtype=kind)
    before = list(given)
    assert env.step(given)[0].tobytes() == twin.step(np.array([1, 0, 1, 0], dtype=np.float32))[0].tobytes()
    assert list(given) == before
    given[0] = 0
    assert env.step(np.zeros(4))[0].tobytes() == twin.step(np.zeros(4))[0].tobytes()


def test_step_without_a_reset_is_a_runtime_error():
    env = GFMWTGEnv(duration_s=1.0, version="v0")
    with pytest.raises(RuntimeError, match=r"reset\(\)"):
        env.step(np.zeros(4))
    single_steps(env, ACTIONS[:10, 0], NEXT_STEP, seed=0)
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"reset\(\)"):
            env.step(np.zeros(4))
    env.reset()
    env.step(np.zeros(4))


@pytest.mark.parametrize("mode", AutoresetMode)
def test_step_of_a_batch_whose_envs_were_not_all_reset_is_a_runtime_error(mode):
    env, zeros = GFMWTGVectorEnv(2, duration_s=2.0, autoreset_mode=mode, version="v0"), np.zeros((2, 4))
    with pytest.raises(RuntimeError, match=r"reset\(\)"):
        env.step(zeros)
    env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    with pytest.raises(RuntimeError, match=r"\[1\].*reset\(\)"):
        env.step(zeros)
    env.reset(seed=0, options={"scenarios": [calm(duration_s=2.0), calm(duration_s=1.0)]})
    for _ in range(10):
        *_, truncated, _ = env.step(zeros)
    assert truncated.tolist() == [False, True]
    if mode == AutoresetMode.DISABLED:
        with pytest.raises(RuntimeError, match=r"\[1\].*reset\(\)"):
            env.step(zeros)
        assert env.reset(options={"reset_mask": truncated})[1]["time_s"].tolist() == [1.0, 0.0]
    env.step(zeros)


@pytest.mark.parametrize(("settings", "named"), OTHER_SETTINGS, ids=str)
def test_snapshot_of_other_settings_is_refused_and_changes_nothing(settings, named):
    env, other = (GFMWTGEnv(**{"version": "v0", "duration_s": 4.0, **given}) for given in ({}, settings))
    env.reset(seed=3), other.reset(seed=8)
    before = other.snapshot()
    with pytest.raises(ValueError, match=f"of an environment with other settings: {named}$"):
        other.restore(env.snapshot())
    for wrong in (None, (1, 2, 3), GFMWTGVectorEnv(1, version="v0").snapshot()):
        with pytest.raises(ValueError, match=r"snapshot\(\) of a GFMWTGEnv returned, got "):
            other.restore(wrong)
    assert pickle.dumps(other.snapshot()) == pickle.dumps(before)
