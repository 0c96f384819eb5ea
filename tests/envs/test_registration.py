"""Facts about making the environment: ids, specs and the two checkers."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import wtg_gym
from tests.envs.rollouts import actions_of, eventful
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv

ENV_ID = "GFMWTG-14bus-v0"
ROOT = Path(__file__).resolve().parents[2]


#: Every mode of action and of observation.
MODES = pytest.mark.parametrize(
    "modes",
    [
        {"action_mode": "k", "observation_mode": "local"},
        {"action_mode": "tau", "observation_mode": "privileged"},
        {"action_mode": "k+tau", "observation_mode": "local"},
    ],
    ids=lambda modes: "-".join(modes.values()),
)


@MODES
@pytest.mark.filterwarnings("error")
def test_gymnasium_checker_has_no_complaint(modes: dict[str, str]):
    env = gym.make(ENV_ID, duration_s=2.0, **modes)
    check_env(env.unwrapped)
    env.close()


@MODES
def test_stable_baselines3_checker_has_no_complaint(modes: dict[str, str], recwarn: Any):
    from stable_baselines3.common.env_checker import check_env as check_sb3

    recwarn.clear()
    check_sb3(GFMWTGEnv(duration_s=2.0, **modes), warn=True)
    assert [str(warning.message) for warning in recwarn] == []


@pytest.mark.filterwarnings("error")
def test_make_after_import_and_make_with_the_module_in_the_id_are_the_same():
    first, second = gym.make(ENV_ID, duration_s=2.0), gym.make(f"wtg_gym:{ENV_ID}", duration_s=2.0)
    assert isinstance(first.unwrapped, GFMWTGEnv) and isinstance(second.unwrapped, GFMWTGEnv)
    assert wtg_gym.ENV_ID == ENV_ID == first.spec.id == second.spec.id
    (a, _), (b, _) = first.reset(seed=1), second.reset(seed=1)
    assert a.tobytes() == b.tobytes()


def test_id_with_the_module_works_without_an_import_and_needs_neither_learner_nor_plotting():
    code = (
        f"import sys, gymnasium; env = gymnasium.make('wtg_gym:{ENV_ID}'); print(env.reset(seed=0)[0].shape,"
        "[m for m in ('torch', 'stable_baselines3', 'matplotlib') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout == "(20,) []\n"


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"suite": "gust", "split": "test", "duration_s": 2.0},
        {"strategy": ["mppt", "coordinated-linear"], "action_mode": "tau", "observation_mode": "privileged"},
        {"scenario": eventful().to_dict(), "weights": {"duty": 2.0, "cap": 20.0}, "on_failure": "trip"},
        {"groups": [{"bus": 2, "n_turbines": 7.5}, {"bus": 3}], "machine_model": "classical"},
        {"control_dt": 0.2, "simulation_dt": 0.025, "duration_s": 4},
    ],
)
def test_spec_survives_json_with_its_arguments(arguments: dict[str, Any]):
    env = gym.make(ENV_ID, **arguments)
    again = EnvSpec.from_json(env.spec.to_json())
    assert json.loads(again.to_json()) == json.loads(env.spec.to_json())
    copied = gym.make(again)
    assert copied.unwrapped.settings == env.unwrapped.settings
    for twin in (env, copied):
        twin.reset(seed=4)
    action = np.full(env.action_space.shape, 0.3, dtype=np.float32)
    (a, x, *_), (b, y, *_) = env.step(action), copied.step(action)
    assert a.tobytes() == b.tobytes() and x == y


def test_arguments_reach_the_environment_through_make():
    env = gym.make(ENV_ID, suite="gust", split="validation", duration_s=3.0, scenario=None, action_mode="k")
    assert env.unwrapped.settings.suite == "gust" and env.action_space.shape == (2,)
    assert env.reset(seed=0)[1]["scenario_seed"] in range(10_000, 10_100)
    three = gym.make(ENV_ID, groups=3, suite="gust")
    assert three.action_space.shape == (6,) and three.observation_space.shape == (30,)
    assert len([name for name in three.unwrapped.observation_names if name.startswith("wtg2.")]) == 10
    fixed = gym.make(ENV_ID, scenario=eventful(duration_s=4.0).to_dict())
    assert fixed.unwrapped.lanes.duration_s == 4.0


def test_make_vec_gives_the_native_batch_in_the_asked_mode():
    for mode in AutoresetMode:
        env = gym.make_vec(ENV_ID, num_envs=3, duration_s=2.0, autoreset_mode=mode)
        assert isinstance(env.unwrapped, GFMWTGVectorEnv) and env.num_envs == 3
        assert env.metadata["autoreset_mode"] == mode
        assert env.reset(seed=1)[0].shape == env.observation_space.shape == (3, 20)
    assert gym.make_vec(ENV_ID, num_envs=2).metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert GFMWTGVectorEnv.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_native_batch_equals_gymnasiums_own_of_single_environments(mode: AutoresetMode):
    actions = actions_of(2, 45, 3).astype(np.float32)
    kinds = [
        gym.make_vec(ENV_ID, 3, duration_s=2.0, autoreset_mode=mode),
        gym.make_vec(ENV_ID, 3, "sync", vector_kwargs={"autoreset_mode": mode}, duration_s=2.0),
    ]
    n_final = 0
    for env in kinds:
        env.reset(seed=7)
    for action in actions:
        (a, x, *ends, info), (b, y, *other_ends, other_info) = (env.step(np.clip(action, -1, 1)) for env in kinds)
        assert a.tobytes() == b.tobytes() and x.tobytes() == y.tobytes()
        assert [end.tolist() for end in ends] == [end.tolist() for end in other_ends]
        assert set(info) == set(other_info)
        for key in set(info) - {"final_obs", "final_info"}:
            assert info[key].tolist() == other_info[key].tolist(), key
        if "final_obs" in info:
            n_final += 1
            assert [x.tobytes() for x in info["final_obs"]] == [x.tobytes() for x in other_info["final_obs"]]
            final, other_final = info["final_info"], other_info["final_info"]
            assert {key: final[key].tolist() for key in final} == {
                key: other_final[key].tolist() for key in other_final
            }
    assert n_final == (2 if mode == AutoresetMode.SAME_STEP else 0)


@pytest.mark.parametrize("n_steps", [15, 5])
def test_max_episode_steps_cuts_a_batch_as_it_cuts_a_single_environment(n_steps: int):
    batch = gym.make_vec(ENV_ID, num_envs=2, max_episode_steps=n_steps)
    assert isinstance(batch.unwrapped, GFMWTGVectorEnv)
    single = gym.make(ENV_ID, max_episode_steps=n_steps)
    observations, _ = batch.reset(seed=1)
    observation, _ = single.reset(seed=2)
    assert observations[1].tobytes() == observation.tobytes()
    for step in range(1, n_steps + 1):
        observations, rewards, _, truncated, _ = batch.step(np.full((2, 4), 0.5, dtype=np.float32))
        observation, reward, _, is_truncated, _ = single.step(np.full(4, 0.5, dtype=np.float32))
        assert truncated[1] == is_truncated == (step == n_steps)
        assert observations[1].tobytes() == observation.tobytes(), f"at step {step}"
        assert rewards[1] == reward


def test_spec_tells_the_steps_of_an_episode():
    for arguments, n_steps in (({}, 600), ({"duration_s": 30.0}, 300), ({"duration_s": 4, "control_dt": 0.2}, 20)):
        assert gym.make(ENV_ID, **arguments).spec.max_episode_steps == n_steps
        assert gym.make_vec(ENV_ID, num_envs=2, **arguments).spec.max_episode_steps == n_steps
    assert gym.make(ENV_ID, max_episode_steps=50).spec.max_episode_steps == 50
    assert gym.make_vec(ENV_ID, num_envs=2, max_episode_steps=50).spec.max_episode_steps == 50
    assert gym.spec(ENV_ID).max_episode_steps is None


def test_environment_itself_ends_an_episode_and_a_copy_from_its_spec_ends_it_at_the_same_step():
    env = gym.make(ENV_ID, duration_s=2.0)
    assert env.has_wrapper_attr("_max_episode_steps") is False
    copied = gym.make(env.spec)
    env.reset(seed=3), copied.reset(seed=3)
    for action in actions_of(4, 20).astype(np.float32)[:, 0]:
        a, b = env.step(action), copied.step(action)
        assert a[0].tobytes() == b[0].tobytes() and a[1:] == b[1:]
    assert a[2:4] == (False, True)


def test_time_aware_observation_counts_to_the_end_of_the_episode():
    env = gym.wrappers.TimeAwareObservation(gym.make(ENV_ID, duration_s=2.0), normalize_time=True)
    times = [env.reset(seed=0)[0][-1]]
    truncated = False
    while not truncated:
        observation, _, _, truncated, _ = env.step(np.zeros(4, dtype=np.float32))
        times.append(observation[-1])
    assert times == pytest.approx([step / 20 for step in range(21)])


@pytest.mark.filterwarnings("error")
def test_statistics_wrappers_see_the_ends_of_a_batch():
    env = gym.wrappers.vector.RecordEpisodeStatistics(gym.make_vec(ENV_ID, num_envs=2, duration_s=2.0))
    env.reset(seed=0)
    for _ in range(20):
        *_, truncated, infos = env.step(np.zeros((2, 4), dtype=np.float32))
    assert truncated.all() and infos["episode"]["l"].tolist() == [20, 20]
    assert (infos["episode"]["r"] <= 0.0).all()
