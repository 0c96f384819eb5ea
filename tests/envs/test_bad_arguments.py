"""Facts about wrong arguments: each is named, with what is allowed, before anything runs."""

from __future__ import annotations

import dataclasses
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, get_type_hints

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.rollouts import calm
from wtg_gym.envs import EnvArguments, EnvSettings, GFMWTGEnv, GFMWTGVectorEnv

ROOT = Path(__file__).resolve().parents[2]
NAN = math.nan
SCENARIO = calm().to_dict()


def complaint(**arguments: Any) -> str:
    """Return the message of the ValueError that arguments raise, at the latest in the first reset."""
    with pytest.raises(ValueError) as caught:
        GFMWTGEnv(**arguments).reset(seed=0)
    return str(caught.value)


# Argument, wrong value, and what the message must name besides.
SETTINGS = [
    ("strategy", "x", ["'x'", "mppt", "coordinated-piecewise"]),
    ("strategy", None, ["None"]),
    ("strategy", 3.5, ["3.5"]),
    ("strategy", ["mppt"], ["2", "1"]),
    ("strategy", [], ["2", "0"]),
    ("strategy", ["mppt", "x"], ["'x'", "mppt"]),
    ("strategy", ["mppt", ["mppt"]], ["['mppt']"]),
    ("strategy", ["mppt", None], ["None"]),
    ("strategy", "nowhere.toml", ["nowhere.toml"]),
    ("action_mode", "x", ["'x'", "k, tau, k+tau"]),
    ("action_mode", ["k"], ["k, tau, k+tau"]),
    ("action_mode", None, ["None", "k, tau, k+tau"]),
    ("observation_mode", "x", ["'x'", "local, privileged"]),
    ("suite", "x", ["'x'", "paper", "weak-grid"]),
    ("suite", None, ["None", "paper"]),
    ("suite", ["standard"], ["paper"]),
    ("split", "x", ["'x'", "train, validation, test"]),
    ("machine_model", "x", ["'x'", "genrou, classical"]),
    ("on_failure", "x", ["'x'", "terminate, trip"]),
    ("groups", 0, ["0", "1 … 1024"]),
    ("groups", -1, ["-1", "1 … 1024"]),
    ("groups", True, ["True", "1 … 1024"]),
    ("groups", 2.0, ["2.0", "bus"]),
    ("groups", None, ["None", "bus"]),
    ("groups", "2", ["'2'", "bus"]),
    ("groups", [], ["[]", "bus"]),
    ("groups", [3], ["3", "bus"]),
    ("groups", [{"buss": 2}], ["buss", "n_turbines"]),
    ("groups", [{"bus": 99}], ["bus 99", "14"]),
    ("groups", [{"bus": 2.5}], ["bus 2.5", "14"]),
    ("groups", [{"bus": "2"}], ["bus '2'", "14"]),
    ("groups", [{"bus": True}], ["True"]),
    ("groups", [{"bus": 2, "n_turbines": NAN}], ["n_turbines", "nan"]),
    ("groups", [{"bus": 2, "n_turbines": 0}], ["n_turbines", "= 0"]),
    ("groups", [{"bus": 2, "n_turbines": "x"}], ["n_turbines", "'x'"]),
    ("duration_s", NAN, ["nan", "3600 s"]),
    ("duration_s", 0.05, ["0.05", "3600 s"]),
    ("duration_s", -1, ["-1", "3600 s"]),
    ("duration_s", "60", ["'60'", "3600 s"]),
    ("duration_s", math.inf, ["inf", "3600 s"]),
    ("duration_s", 2.05, ["2.05", "0.1 s"]),
    ("control_dt", 0.07, ["0.07", "0.025 s"]),
    ("control_dt", 0.001, ["0.001", "0.025 … 10 s"]),
    ("control_dt", NAN, ["nan", "10 s"]),
    ("control_dt", None, ["None", "10 s"]),
    ("control_dt", "0.1", ["'0.1'", "10 s"]),
    ("simulation_dt", 0.03, ["0.1", "0.03 s"]),
    ("simulation_dt", 0.05, ["0.05", "0.04 s"]),
    ("simulation_dt", 0, ["0 s", "0.04 s"]),
    ("simulation_dt", NAN, ["nan", "0.04 s"]),
    ("simulation_dt", "x", ["'x'", "0.04 s"]),
    ("weights", {"x": 1}, ["'x'", "frequency", "duty", "cap"]),
    ("weights", {"duty": NAN}, ["'duty'", "nan"]),
    ("weights", {"duty": -1}, ["'duty'", "-1"]),
    ("weights", {"duty": "a"}, ["'duty'", "'a'"]),
    ("weights", {"duty": None}, ["'duty'", "None"]),
    ("weights", {"cap": 0}, ["'cap'", "= 0"]),
    ("weights", 3, ["3"]),
    ("weights", "x", ["'x'"]),
    ("weights", [1], ["[1]"]),
    ("render_mode", "ansi", ["'ansi'", "None", "'human'", "'rgb_array'"]),
    ("scenario", "x", ["'x'"]),
    ("scenario", 3, ["3"]),
    ("scenario", [1], ["[1]"]),
]


@pytest.mark.parametrize(("name", "value", "named"), SETTINGS, ids=lambda value: str(value)[:30])
def test_wrong_setting_is_named_with_what_is_allowed(name: str, value: Any, named: list[str]):
    message = complaint(**{name: value})
    # A split bus or one of several weights is named rather than the whole argument.
    stem = {"groups": "group|bus", "weights": "weight", "strategy": "strateg|law", "simulation_dt": "dt"}
    assert re.search(stem.get(name, name), message), message
    assert [word for word in named if word not in message] == [], message


STEP = {"kind": "load_step", "time_s": 1.0, "bus": 2, "power_mw": 5.0}
RAMP = {**STEP, "kind": "load_ramp", "duration_s": 1.0}
LINE = {"kind": "line_trip", "time_s": 1.0, "from_bus": 1, "to_bus": 2}

# Changed values of a scenario and what the message must name.
SCENARIOS = [
    ({"foo": 1}, ["foo", "wind_speed"]),
    ({"wind_speed": [[-1.0], [8.0]]}, ["wind_speed", "-1 m/s", "3 … 25 m/s"]),
    ({"wind_speed": [[8.0] * 9, [8.0] * 8 + [26.0]]}, ["wind_speed", "group 1", "0.8 s", "26 m/s", "3 … 25 m/s"]),
    ({"wind_speed": [[NAN], [8.0]]}, ["wind_speed", "nan"]),
    ({"wind_speed": [[8.0]]}, ["1", "2 groups"]),
    ({"wind_speed": [[8.0]] * 3}, ["3", "2 groups"]),
    ({"wind_speed": [8.0, 8.0]}, ["wind_speed", "(2,)"]),
    ({"wind_speed": None}, ["wind_speed"]),
    ({"wind_speed": [[8.0], [8.0, 9.0]]}, ["wind_speed"]),
    ({"wind_speed": "x"}, ["wind_speed"]),
    ({"wind_dt_s": 0}, ["wind_dt_s", "= 0"]),
    ({"seed": "x"}, ["seed", "'x'"]),
    ({"seed": 1.5}, ["seed", "1.5"]),
    ({"seed": NAN}, ["seed", "nan"]),
    ({"seed": 2**70}, ["seed"]),
    ({"duration_s": NAN}, ["duration_s", "nan"]),
    ({"duration_s": 2.05}, ["duration_s", "2.05", "0.1 s"]),
    ({"load_level": 0}, ["load_level", "0.3 … 1.5"]),
    ({"governor_droop": 0}, ["governor_droop", "0.005 … 1 p.u."]),
    ({"inertia_scale": NAN}, ["inertia_scale", "nan"]),
    ({"load_noise_bus": 99}, ["bus 99"]),
    ({"load_noise_mw": [1.0]}, ["load_noise_mw", "1 MW"]),
    ({"load_noise_mw": [0.0, NAN]}, ["load_noise_mw", "nan MW", "-10000 … 10000 MW"]),
    ({"load_noise_mw": "x"}, ["load_noise_mw"]),
    ({"events": 3}, ["event"]),
    ({"events": [3]}, ["event", "3", "load_step"]),
    ({"events": [{**STEP, "kind": "x"}]}, ["'x'", "load_step, load_ramp, load_trip, line_trip"]),
    ({"events": [{"kind": "load_step", "time_s": 1.0}]}, ["bus", "power_mw"]),
    ({"events": [{**STEP, "foo": 1}]}, ["foo"]),
    ({"events": [{**STEP, "bus": 99}]}, ["bus 99", "14"]),
    ({"events": [{**STEP, "time_s": 1.005}]}, ["1.005", "0.025 s"]),
    ({"events": [{**STEP, "time_s": -1.0}]}, ["-1 s"]),
    ({"events": [{**STEP, "time_s": NAN}]}, ["nan"]),
    ({"events": [{**STEP, "power_mw": NAN}]}, ["nan MW"]),
    ({"events": [{**RAMP, "duration_s": 1.005}]}, ["1.005", "0.025 s"]),
    ({"events": [{**LINE, "to_bus": 14}]}, ["1-14", "1-2"]),
    ({"events": [{**LINE, "from_bus": 7, "to_bus": 8}]}, ["split"]),
    ({"events": [LINE, {**LINE, "to_bus": 5, "time_s": 2.0}]}, ["split"]),
    ({"events": [{"kind": "load_trip", "time_s": t, "bus": 4} for t in (1.0, 2.0)]}, ["4", "twice"]),
]


@pytest.mark.parametrize(("changes", "named"), SCENARIOS, ids=lambda value: str(value)[:40])
def test_wrong_scenario_is_named_with_what_is_allowed(changes: dict, named: list[str]):
    message = complaint(scenario={**SCENARIO, **changes}, duration_s=4.0)
    assert [word for word in named if word not in message] == [], message


@pytest.mark.parametrize(("changes", "named"), SCENARIOS, ids=lambda value: str(value)[:40])
def test_wrong_scenario_is_refused_in_reset_too(changes: dict, named: list[str]):
    env = GFMWTGEnv(duration_s=4.0)
    with pytest.raises(ValueError) as caught:
        env.reset(options={"scenario": {**SCENARIO, **changes}})
    assert [word for word in named if word not in str(caught.value)] == [], caught.value


@pytest.mark.parametrize(
    "changes",
    [
        {"wind_speed": [[8.0]]},
        {"duration_s": 2.05},
        {"duration_s": 4.1},
        {"events": [{**STEP, "time_s": 1.005}]},
        {"events": [{**STEP, "bus": 99}]},
        {"events": [{**LINE, "from_bus": 7, "to_bus": 8}]},
        {"load_noise_bus": 99},
    ],
    ids=lambda value: str(value)[:40],
)
def test_fixed_scenario_that_cannot_be_played_is_refused_when_the_environment_is_made(changes: dict):
    with pytest.raises(ValueError):
        GFMWTGEnv(scenario={**SCENARIO, **changes}, duration_s=4.0)


def test_scenario_longer_than_the_episode_is_refused():
    message = complaint(scenario={**SCENARIO, "duration_s": 4.1}, duration_s=4.0)
    assert "4.1 s" in message and "4 s" in message
    env = GFMWTGEnv(duration_s=4.0)
    with pytest.raises(ValueError, match=r"4\.1 s, longer than the 4 s"):
        env.reset(options={"scenario": calm(duration_s=4.1)})


@pytest.mark.parametrize("make", [GFMWTGEnv, GFMWTGVectorEnv, lambda **given: gym.make("GFMWTG-14bus-v0", **given)])
def test_unknown_keyword_is_a_type_error_in_the_words_of_python_that_lists_the_known_ones(make: Any):
    with pytest.raises(TypeError, match=r"__init__\(\) got an unexpected keyword argument 'stratgy'") as caught:
        make(stratgy="mppt")
    assert all(field.name in str(caught.value) for field in dataclasses.fields(EnvSettings))
    with pytest.raises(TypeError):
        GFMWTGEnv("mppt")


def test_type_checkers_know_exactly_the_settings_with_their_types():
    settings, keywords = get_type_hints(EnvSettings), get_type_hints(EnvArguments)
    assert {field.name: settings[field.name] for field in dataclasses.fields(EnvSettings)} == keywords
    assert EnvArguments.__required_keys__ == frozenset()


def test_misspelled_setting_does_not_pass_mypy(tmp_path: Path):
    program = tmp_path / "program.py"
    program.write_text("from wtg_gym import GFMWTGEnv\n\nGFMWTGEnv(suite='gust')\nGFMWTGEnv(suit='gust')\n")
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--cache-dir",
        str(tmp_path),
        "--config-file",
        str(ROOT / "pyproject.toml"),
    ]
    done = subprocess.run([*command, str(program)], cwd=ROOT, capture_output=True, text=True)
    errors = [line for line in done.stdout.splitlines() if "error:" in line]
    assert len(errors) == 1 and 'program.py:4: error: Unexpected keyword argument "suit"' in errors[0], done.stdout


BATCH = [
    ({"num_envs": 0}, ["0", "1 … 1000000"]),
    ({"num_envs": -1}, ["-1", "1 … 1000000"]),
    ({"num_envs": 2.0}, ["2.0", "1 … 1000000"]),
    ({"num_envs": True}, ["True", "1 … 1000000"]),
    ({"n_threads": 0}, ["threads", "0"]),
    ({"n_threads": 1.5}, ["threads", "1.5"]),
    ({"n_threads": True}, ["threads", "True"]),
    ({"autoreset_mode": "x"}, ["'x'", "NextStep", "SameStep", "Disabled"]),
    ({"autoreset_mode": None}, ["None", "NextStep", "SameStep", "Disabled"]),
    ({"max_episode_steps": 0}, ["max_episode_steps", "0"]),
    ({"max_episode_steps": 20.5}, ["max_episode_steps", "20.5"]),
    ({"max_episode_steps": NAN}, ["max_episode_steps", "nan"]),
    ({"max_episode_steps": "20"}, ["max_episode_steps", "'20'"]),
    ({"max_episode_steps": 20, "control_dt": None}, ["control_dt", "None"]),
    ({"max_episode_steps": 20, "control_dt": "x"}, ["control_dt", "'x'"]),
    ({"strategy": "x"}, ["'x'", "mppt"]),
    ({"render_mode": "human"}, ["'human'", "None", "'rgb_array'"]),
]


@pytest.mark.parametrize(("arguments", "named"), BATCH, ids=lambda value: str(value)[:40])
def test_wrong_argument_of_a_batch_is_named_with_what_is_allowed(arguments: dict, named: list[str]):
    with pytest.raises(ValueError) as caught:
        GFMWTGVectorEnv(**{"num_envs": 2, **arguments})
    assert [word for word in named if word not in str(caught.value)] == [], caught.value


# Gymnasium raises its own error for seeds; either is fine that speaks of the seed.
SEED_ERRORS = (ValueError, gym.error.Error)


@pytest.mark.parametrize("seed", [NAN, 1.5, "a", -1, [1]])
def test_wrong_seed_is_refused(seed: Any):
    with pytest.raises(SEED_ERRORS, match=r"(?i)seed"):
        GFMWTGEnv(duration_s=2.0).reset(seed=seed)


@pytest.mark.parametrize("seed", [NAN, 1.5, "ab", -1, [1], [1, NAN], [1, "a"], [1, -1], [1, 2, 3]], ids=str)
def test_wrong_seed_of_a_batch_is_refused_and_changes_no_lane(seed: Any):
    env, twin = (GFMWTGVectorEnv(2, duration_s=2.0) for _ in range(2))
    env.reset(seed=5), twin.reset(seed=5)
    with pytest.raises(SEED_ERRORS, match=r"(?i)seed"):
        env.reset(seed=seed)
    assert env.reset()[1]["scenario_seed"].tolist() == twin.reset()[1]["scenario_seed"].tolist()


@pytest.mark.parametrize(
    "options", [{"foo": 1}, {"scenarios": [SCENARIO]}, {"scenario": None}, {"scenario": "x"}, 3, ["scenario"]], ids=str
)
def test_wrong_reset_options_are_refused(options: Any):
    with pytest.raises(ValueError, match="scenario"):
        GFMWTGEnv(duration_s=4.0).reset(options=options)


@pytest.mark.parametrize(
    "options",
    [
        {"foo": 1},
        {"scenario": SCENARIO},
        {"scenarios": [SCENARIO]},
        {"scenarios": SCENARIO},
        {"scenarios": 3},
        {"scenarios": [SCENARIO, 3]},
        {"reset_mask": [True]},
        {"reset_mask": [1, 0]},
        {"reset_mask": [False, False]},
    ],
    ids=lambda value: str(value)[:40],
)
def test_wrong_reset_options_of_a_batch_are_refused_and_change_no_lane(options: Any):
    env, twin = (GFMWTGVectorEnv(2, duration_s=4.0) for _ in range(2))
    env.reset(seed=5), twin.reset(seed=5)
    with pytest.raises(ValueError, match=r"scenario|reset_mask"):
        env.reset(options=options)
    (a, x, *_), (b, y, *_) = env.step(np.ones((2, 4))), twin.step(np.ones((2, 4)))
    assert a.tobytes() == b.tobytes() and x.tolist() == y.tolist()
