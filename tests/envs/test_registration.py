"""Facts about making the environment: ids, specs, the two checkers; one random generator each, from the seed."""

import functools
import json
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_sb3

import wtg_gym
from tests.envs.rollouts import digest, eventful
from wtg_gym.envs import EnvSettings, GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.pettingzoo import parallel_env
from wtg_gym.sb3 import SB3VecEnv
from wtg_gym.scenarios import SPLITS, SUITES, get_suite

ENV_ID = "GFMWTG-14bus-v0"
HEAVY = ("torch", "onnx", "onnxruntime", "matplotlib", "pandas", "stable_baselines3", "rich", "baselines", "agents")
BOTH_IDS = pytest.mark.parametrize("env_id", wtg_gym.ENV_IDS)
ROOT = Path(__file__).resolve().parents[2]

MODES = [
    {"action_mode": "k", "observation_mode": "local"},
    {"action_mode": "tau", "observation_mode": "privileged"},
    {"action_mode": "k+tau", "render_mode": "rgb_array"},
]
ARGUMENTS = [
    {"version": "v0"},
    {"suite": "gust", "split": "test", "duration_s": 2.0},
    {"version": "v0", "strategy": ["mppt", "coordinated-linear"], "observation_mode": "privileged"},
    {"version": "v0", "scenario": eventful().to_dict(), "weights": {"duty": 2.0, "cap": 20.0}},
    {"version": "v0", "groups": [{"bus": 2, "n_turbines": 7.5}, {"bus": 3}], "plant": {"machine_model": "classical"}},
    {"suite": "gusty-v1", "sensors": {"delay_s": [0.2, 0.4], "wind_sensor": False}},
    {"sensors": "exact", "plant": {"physics": "nrel-5mw"}, "control_dt": 0.2, "action_mode": "tau"},
    {"scenario": get_suite("faults-v1").scenario(20_000, duration_s=4.0).to_dict()},
]


@BOTH_IDS
@pytest.mark.parametrize("modes", MODES, ids=lambda modes: "-".join(modes.values()))
# An error for every warning but Gymnasium's that there is an id with a higher number.
@pytest.mark.filterwarnings("error", "ignore:.*is out of date:DeprecationWarning")
def test_both_checkers_have_no_complaint(modes, env_id, monkeypatch):
    # What renders is made with every render mode, so with a window too.
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make(env_id, duration_s=2.0, **modes).unwrapped
    check_env(env)
    check_sb3(env, warn=True)
    env.close()


def test_version_v1_is_meant_where_none_is_named():
    assert wtg_gym.ENV_ID == "GFMWTG-14bus-v1"
    assert (EnvSettings().task.version, EnvSettings().suite_name) == ("v1", "standard-v1")
    assert EnvSettings(version="v0").suite_name == "standard"
    assert EnvSettings(suite="standard").task.version == "v0"
    for env in (GFMWTGEnv(), GFMWTGVectorEnv(2), parallel_env().single_env, SB3VecEnv(2).vector_env):
        assert env.settings.suite_name == "standard-v1"


@BOTH_IDS
def test_an_id_is_not_made_with_another_version(env_id):
    other = {"v0": "v1", "v1": "v0"}[env_id[-2:]]
    for make in (gym.make, functools.partial(gym.make_vec, num_envs=2)):
        with pytest.raises(ValueError, match=f"^{env_id} cannot be made with version = {other!r}"):
            make(env_id, version=other)
    assert gym.make(env_id, version=env_id[-2:]).unwrapped.settings.task.version == env_id[-2:]


def test_in_another_process_the_id_with_the_module_needs_no_import_loads_nothing_heavy_and_finds_the_same_bits():
    code = (
        f"import sys, gymnasium; env = gymnasium.make('wtg_gym:{ENV_ID}'); print(env.reset(seed=0)[0].shape,"
        f"[m for m in {HEAVY} if m in sys.modules]);"
        "from tests.envs.rollouts import digest; print(digest(17), digest(1), digest(17, version='v1'))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    made, bits = run.stdout.splitlines()
    assert made == "(20,) []" and bits.split() == [digest(17), digest(1), digest(17, version="v1")]


@pytest.mark.parametrize("arguments", ARGUMENTS)
def test_spec_survives_json_with_its_arguments(arguments):
    env = gym.make(f"GFMWTG-14bus-{EnvSettings(**arguments).task.version}", **arguments)
    again = EnvSpec.from_json(env.spec.to_json())
    assert json.loads(again.to_json()) == json.loads(env.spec.to_json())
    copied = gym.make(again)
    assert copied.unwrapped.settings == env.unwrapped.settings
    for twin in (env, copied):
        twin.reset(seed=4)
    action = np.full(env.action_space.shape, 0.3, dtype=np.float32)
    (a, x, *_), (b, y, *_) = env.step(action), copied.step(action)
    assert a.tobytes() == b.tobytes() and x == y


def test_max_episode_steps_cuts_a_batch_as_it_cuts_a_single_environment():
    batch, single = gym.make_vec(ENV_ID, 2, max_episode_steps=7), gym.make(ENV_ID, max_episode_steps=7)
    assert isinstance(batch.unwrapped, GFMWTGVectorEnv)
    batch.reset(seed=1), single.reset(seed=2)
    for step in range(1, 8):
        observations, rewards, _, truncated, _ = batch.step(np.full((2, 4), 0.5, dtype=np.float32))
        observation, reward, _, is_truncated, _ = single.step(np.full(4, 0.5, dtype=np.float32))
        assert truncated[1] == is_truncated == (step == 7)
        assert observations[1].tobytes() == observation.tobytes() and rewards[1] == reward


def test_a_seed_gives_one_stream_of_scenarios_and_none_a_new_one():
    env, fresh = (GFMWTGEnv(duration_s=2.0, version="v0") for _ in range(2))
    streams = [[own.reset(seed=seed)[1]["scenario_seed"] for seed in (5, *[None] * 9)] for own in (env, env, fresh)]
    assert streams[0] == streams[1] == streams[2] and len(set(streams[0])) == 10
    assert len({GFMWTGEnv(duration_s=2.0, version="v0").reset()[1]["scenario_seed"] for _ in range(5)}) == 5
    batch = GFMWTGVectorEnv(5, duration_s=2.0, version="v0")
    seen = np.concatenate([batch.reset()[1]["scenario_seed"], batch.reset()[1]["scenario_seed"]])
    assert len(set(seen.tolist())) == 10


@pytest.mark.parametrize("suite", SUITES)
def test_scenarios_come_from_the_asked_split_alone_which_is_train_by_default(suite):
    for split in SPLITS:
        asked = {"suite": suite} if split == "train" else {"suite": suite, "split": split}
        batch, env = GFMWTGVectorEnv(2, duration_s=2.0, **asked), GFMWTGEnv(duration_s=2.0, **asked)
        drawn = [*batch.reset(seed=1)[1]["scenario_seed"], *(env.reset()[1]["scenario_seed"] for _ in range(2))]
        assert all(int(seed) in get_suite(suite).seeds(split) for seed in drawn)


def test_reset_plays_the_scenario_of_a_seed_of_the_suite():
    single, batch = GFMWTGEnv(duration_s=4.0), GFMWTGVectorEnv(2, duration_s=4.0)
    scenario = get_suite("standard-v1").scenario(10_003, duration_s=4.0)
    (expected, info), (observation, other) = (single.reset(options={"scenario": of}) for of in (scenario, 10_003))
    assert observation.tobytes() == expected.tobytes() and other == info
    observations, infos = batch.reset(options={"scenarios": [20_000, 10_003]})
    assert observations[1].tobytes() == expected.tobytes() and infos["scenario_seed"].tolist() == [20_000, 10_003]


def test_fixed_scenario_is_the_same_in_every_episode_and_tells_its_seed():
    env = GFMWTGEnv(scenario=eventful().to_dict(), duration_s=4.0, version="v0")
    starts = [env.reset(seed=seed) for seed in (1, 2, None)]
    assert len({observation.tobytes() for observation, _ in starts}) == 1
    assert [info["scenario_seed"] for _, info in starts] == [-1] * 3
    env = GFMWTGEnv(scenario=eventful(seed=77).to_dict(), version="v0")
    assert env.reset()[1]["scenario_seed"] == 77
