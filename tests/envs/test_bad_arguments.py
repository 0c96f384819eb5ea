"""Wrong arguments are named with what is allowed, before anything runs: one case for each rule."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, get_type_hints

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.rollouts import calm
from wtg_gym import ENV_IDS
from wtg_gym.envs import EnvArguments, EnvSettings, GFMWTGEnv, GFMWTGVectorEnv

NAN = math.nan
SCENARIO = calm().to_dict()

# Argument, wrong value, and what the message must name.
SETTINGS = [
    ("strategy", "x", ["strategy", "'x'", "mppt", "coordinated-piecewise"]),
    ("strategy", 3.5, ["strateg", "3.5"]),
    ("strategy", ["mppt"], ["law", "2", "1"]),
    ("strategy", ["mppt", None], ["strateg", "None"]),
    ("strategy", "nowhere.toml", ["law", "nowhere.toml"]),
    ("action_mode", "x", ["action_mode", "'x'", "k, tau, k+tau"]),
    ("action_mode", ["k"], ["action_mode", "k, tau, k+tau"]),
    ("observation_mode", "x", ["observation_mode", "'x'", "local, privileged"]),
    ("suite", "x", ["suite", "'x'", "paper", "weak-grid"]),
    ("split", "x", ["split", "'x'", "train, validation, test"]),
    ("machine_model", "x", ["machine_model", "'x'", "genrou, classical"]),
    ("physics", "x", ["physics", "'x'", "paper, extended, nrel-5mw"]),
    ("on_failure", "x", ["on_failure", "'x'", "terminate, trip"]),
    ("groups", 0, ["group", "0", "1 … 1024"]),
    ("groups", "2", ["group", "'2'", "bus"]),
    ("groups", [], ["group", "[]", "bus"]),
    ("groups", [{"buss": 2}], ["buss", "n_turbines"]),
    ("groups", [{}], ["bus", "{}"]),
    ("groups", np.bool_(True), ["group", "True", "bus"]),
    ("groups", [{"bus": 99}], ["bus 99", "14"]),
    ("groups", [{"bus": True}], ["bus", "True"]),
    ("groups", [{"bus": 2, "n_turbines": NAN}], ["n_turbines", "nan"]),
    ("duration_s", NAN, ["duration_s", "nan", "3600 s"]),
    ("duration_s", "60", ["duration_s", "'60'", "3600 s"]),
    ("duration_s", 2.05, ["duration_s", "2.05", "0.1 s"]),
    ("control_dt", 0.001, ["control_dt", "0.001", "0.025 … 10 s"]),
    ("control_dt", None, ["control_dt", "None", "10 s"]),
    ("control_dt", 0.07, ["control_dt", "0.07", "0.025 s"]),
    ("simulation_dt", 0.05, ["simulation_dt", "0.05", "0.04 s"]),
    ("simulation_dt", "x", ["simulation_dt", "'x'", "0.04 s"]),
    ("simulation_dt", 0.03, ["0.1", "0.03 s"]),
    ("weights", {"x": 1}, ["weight", "'x'", "frequency", "duty", "cap"]),
    ("weights", {"duty": -1}, ["'duty'", "-1"]),
    ("weights", {"duty": "a"}, ["'duty'", "'a'"]),
    ("weights", {"cap": 0}, ["'cap'", "= 0"]),
    ("weights", 3, ["weights", "3"]),
    ("render_mode", "ansi", ["render_mode", "'ansi'", "None", "'human'", "'rgb_array'"]),
    ("scenario", "x", ["scenario", "'x'"]),
]


def absent(words: list[str], error: pytest.ExceptionInfo[ValueError]) -> list[str]:
    """Return the words that a message does not name."""
    return [word for word in words if word not in str(error.value)]


@pytest.mark.parametrize(("name", "value", "named"), SETTINGS, ids=lambda value: str(value)[:30])
def test_wrong_setting_is_named_with_what_is_allowed(name: str, value: Any, named: list[str]):
    with pytest.raises(ValueError) as error:
        GFMWTGEnv(**{"version": "v0", name: value})
    assert absent(named, error) == [], error.value


STEP = {"kind": "load_step", "time_s": 1.0, "bus": 2, "power_mw": 5.0}
LINE = {"kind": "line_trip", "time_s": 1.0, "from_bus": 1, "to_bus": 2}

# Changed values of a scenario and what the message must name: rules of the plant and of the environment, and one of
# the scenario's own, which tests/physics/test_scenario.py has.
SCENARIOS = [
    ({"wind_speed": [[8.0]]}, ["1", "2 groups"]),
    ({"wind_speed": [[8.0] * 9, [8.0] * 8 + [26.0]]}, ["wind_speed", "group 2", "0.8 s", "26 m/s", "3 … 25 m/s"]),
    ({"duration_s": 2.05}, ["duration_s", "2.05", "0.1 s"]),
    ({"duration_s": 4.1}, ["4.1 s", "longer than the 4 s"]),
    ({"load_noise_bus": 99}, ["bus 99", "14"]),
    ({"events": [{**STEP, "bus": 99}]}, ["bus 99", "14"]),
    ({"events": [{**STEP, "time_s": 1.005}]}, ["1.005", "0.025 s"]),
    ({"events": [{**STEP, "kind": "load_ramp", "duration_s": 1.005}]}, ["1.005", "0.025 s"]),
    ({"events": [{**LINE, "to_bus": 14}]}, ["1-14", "1-2"]),
    ({"events": [LINE, {**LINE, "to_bus": 5, "time_s": 2.0}]}, ["split"]),
    ({"events": [{"kind": "load_trip", "time_s": t, "bus": 4} for t in (1.0, 2.0)]}, ["4", "twice"]),
]


@pytest.mark.parametrize(("changes", "named"), SCENARIOS, ids=lambda value: str(value)[:40])
def test_wrong_scenario_is_refused_when_the_environment_is_made_and_in_reset(changes: dict, named: list[str]):
    scenario, env = {**SCENARIO, **changes}, GFMWTGEnv(duration_s=4.0, version="v0")
    for refused in (
        lambda: GFMWTGEnv(scenario=scenario, duration_s=4.0, version="v0"),
        lambda: env.reset(options={"scenario": scenario}),
    ):
        with pytest.raises(ValueError) as error:
            refused()
        assert absent(named, error) == [], error.value


@pytest.mark.parametrize(
    "make", [GFMWTGEnv, GFMWTGVectorEnv, *(lambda i=i, **given: gym.make(i, **given) for i in ENV_IDS)]
)
def test_unknown_keyword_is_a_type_error_in_the_words_of_python_that_lists_the_known_ones(make: Any):
    with pytest.raises(TypeError, match=r"__init__\(\) got an unexpected keyword argument 'stratgy'") as caught:
        make(stratgy="mppt")
    assert all(field.name in str(caught.value) for field in dataclasses.fields(EnvSettings))
    with pytest.raises(TypeError):
        GFMWTGEnv("mppt", version="v0")


@pytest.mark.parametrize("kind", [GFMWTGEnv, GFMWTGVectorEnv])
def test_type_checkers_know_exactly_the_settings_with_their_types(kind: Any):
    settings, keywords = get_type_hints(EnvSettings), get_type_hints(EnvArguments)
    assert {field.name: settings[field.name] for field in dataclasses.fields(EnvSettings)} == keywords
    assert EnvArguments.__required_keys__ == frozenset()
    # This is what makes a misspelled setting an error of mypy.
    assert "Unpack[EnvArguments]" in kind.__init__.__annotations__.values()


BATCH = [
    ({"num_envs": 0}, ["num_envs", "0", "1 … 1000000"]),
    ({"num_envs": 2.0}, ["num_envs", "2.0", "1 … 1000000"]),
    ({"num_envs": True}, ["num_envs", "True", "1 … 1000000"]),
    ({"n_threads": 0}, ["n_threads", "0"]),
    ({"n_threads": 1.5}, ["n_threads", "1.5"]),
    ({"autoreset_mode": "x"}, ["'x'", "NextStep", "SameStep", "Disabled"]),
    ({"max_episode_steps": 0}, ["max_episode_steps", "0"]),
    ({"max_episode_steps": NAN}, ["max_episode_steps", "nan"]),
    ({"max_episode_steps": "20"}, ["max_episode_steps", "'20'"]),
    ({"max_episode_steps": 20, "control_dt": None}, ["control_dt", "None"]),
    ({"strategy": "x"}, ["'x'", "mppt"]),
    ({"render_mode": "human"}, ["'human'", "None", "'rgb_array'"]),
]


@pytest.mark.parametrize(("arguments", "named"), BATCH, ids=lambda value: str(value)[:40])
def test_wrong_argument_of_a_batch_is_named_with_what_is_allowed(arguments: dict, named: list[str]):
    with pytest.raises(ValueError) as error:
        GFMWTGVectorEnv(**{"version": "v0", "num_envs": 2, **arguments})
    assert absent(named, error) == [], error.value


# Gymnasium raises its own error for seeds.
SEED_ERRORS = (ValueError, gym.error.Error)


@pytest.mark.parametrize("seed", [NAN, 1.5, "a", -1, [1]])
def test_wrong_seed_is_refused(seed: Any):
    with pytest.raises(SEED_ERRORS, match=r"(?i)seed"):
        GFMWTGEnv(duration_s=2.0, version="v0").reset(seed=seed)


OPTIONS = [
    {"foo": 1},
    {1: 1, "a": 2},
    {"scenarios": [SCENARIO]},
    {"scenario": None},
    {"scenario": {**SCENARIO, "load_noise_bus": 99}},
    3,
]


@pytest.mark.parametrize("options", OPTIONS, ids=lambda value: str(value)[:40])
def test_wrong_reset_options_are_refused_and_leave_the_stream_of_scenarios_alone(options: Any):
    env, twin = (GFMWTGEnv(duration_s=4.0, version="v0") for _ in range(2))
    env.reset(seed=5), twin.reset(seed=5)
    with pytest.raises(ValueError, match=r"scenario|bus 99"):
        env.reset(seed=9, options=options)
    assert env.reset()[1]["scenario_seed"] == twin.reset()[1]["scenario_seed"]


BATCH_SEEDS = [NAN, 1.5, "ab", True, -1, [1], [1, NAN], [1, "a"], [1, -1], [1, 2, 3]]
BATCH_OPTIONS = [
    {"foo": 1},
    {1: 1, "a": 2},
    {"scenarios": None},
    {"scenario": SCENARIO},
    {"scenarios": [SCENARIO]},
    {"scenarios": 3},
    {"scenarios": [SCENARIO, 3]},
    {"reset_mask": [True]},
    {"reset_mask": [1, 0]},
    {"reset_mask": [False, False]},
]


def test_wrong_seeds_and_options_of_a_batch_are_refused_and_change_no_lane():
    env, twin = (GFMWTGVectorEnv(2, duration_s=4.0, version="v0") for _ in range(2))
    env.reset(seed=5), twin.reset(seed=5)
    for seed in BATCH_SEEDS:
        with pytest.raises(SEED_ERRORS, match=r"(?i)seed"):
            env.reset(seed=seed)
    for options in BATCH_OPTIONS:
        with pytest.raises(ValueError, match=r"scenario|reset_mask"):
            env.reset(options=options)
    (a, x, *_), (b, y, *_) = env.step(np.ones((2, 4))), twin.step(np.ones((2, 4)))
    assert a.tobytes() == b.tobytes() and x.tolist() == y.tolist()
    assert env.reset()[1]["scenario_seed"].tolist() == twin.reset()[1]["scenario_seed"].tolist()
