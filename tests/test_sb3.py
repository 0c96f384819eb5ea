"""Facts about training with Stable-Baselines3 on many episodes at once."""

from __future__ import annotations

import importlib
import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecCheckNan,
    VecEnv,
    VecMonitor,
    VecNormalize,
    is_vecenv_wrapped,
)

from tests.envs.rollouts import actions_of, calm, rising
from wtg_gym.sb3 import SB3VecEnv, make_sb3_vec_env

ENV_ID = "GFMWTG-14bus-v0"
N = 3
SHORT: dict[str, Any] = {"version": "v0", "duration_s": 5.0, "strategy": "mppt"}
#: The first lane's first episode ends at a stall, the third's earlier than the others.
FAILURE_FIRST: list[dict[str, Any]] = [{"scenario": rising(5.0)}, {}, {"scenario": calm(9.0, 1.5).to_dict()}]


@pytest.fixture(autouse=True)
def one_thread() -> Any:
    """A sum over several threads may depend on which of them ends first."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def dummy(n: int = N, **arguments: Any) -> DummyVecEnv:
    return DummyVecEnv([lambda: gym.make(ENV_ID, **(arguments or SHORT))] * n)


def native(n: int = N, **arguments: Any) -> SB3VecEnv:
    return SB3VecEnv(n, **(arguments or SHORT))


def both() -> tuple[DummyVecEnv, SB3VecEnv]:
    return dummy(), native()


def zeros(env: VecEnv) -> np.ndarray:
    return np.zeros((env.num_envs, *env.action_space.shape), dtype=np.float32)


def same(a: Any, b: Any) -> bool:
    """Whether two values are of the same kind and equal in every bit."""
    if isinstance(a, dict):
        return isinstance(b, dict) and set(a) == set(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and a == b


def small() -> dict[str, Any]:
    """Return a learner's arguments; new ones for each, because it writes into them."""
    return {"policy_kwargs": {"net_arch": [8]}, "seed": 5, "device": "cpu"}


class Curve(BaseCallback):
    """Keeps the rollout buffers and the infos of all steps."""

    def __init__(self) -> None:
        super().__init__()
        self.buffers: list[dict[str, np.ndarray]] = []
        self.episodes: list[dict[str, Any]] = []
        self.ends: list[dict[str, Any]] = []

    def _on_step(self) -> bool:
        for info, done in zip(self.locals["infos"], self.locals["dones"], strict=True):
            if done:
                self.ends.append({key: value for key, value in info.items() if key != "episode"})
                self.episodes.append({key: info["episode"][key] for key in "rl"} if "episode" in info else {})
        return True

    def _on_rollout_end(self) -> None:
        buffer = self.locals["rollout_buffer"]
        names = ("observations", "actions", "rewards", "advantages", "returns", "episode_starts", "log_probs", "values")
        self.buffers.append({name: getattr(buffer, name).copy() for name in names})


def trained(env: VecEnv, n_steps: int = 64, rollouts: int = 3) -> tuple[PPO, Curve]:
    env.set_options(FAILURE_FIRST)
    curve = Curve()
    model = PPO("MlpPolicy", env, n_steps=n_steps, batch_size=32, n_epochs=2, **small())
    model.learn(rollouts * n_steps * env.num_envs, callback=curve)
    return model, curve


def test_every_step_equals_that_of_single_environments_with_the_same_seeds():
    reference, env = both()
    for venv in (reference, env):
        venv.seed(40)
        venv.set_options(FAILURE_FIRST)
    assert same(reference.reset(), env.reset())
    assert same(dict(enumerate(reference.reset_infos)), dict(enumerate(env.reset_infos)))
    ends = []
    for actions in actions_of(1, 130, N).astype(np.float32):
        expected, got = reference.step(actions), env.step(actions)
        for a, b in zip(expected[:3], got[:3], strict=True):
            assert same(a, b)
        for lane, done in enumerate(got[2]):
            assert got[3][lane]["TimeLimit.truncated"] == expected[3][lane]["TimeLimit.truncated"]
            if done:
                assert same(expected[3][lane], got[3][lane])
                ends.append((lane, got[3][lane]["termination_reason"], got[3][lane]["TimeLimit.truncated"]))
        assert same(dict(enumerate(reference.reset_infos)), dict(enumerate(env.reset_infos)))
    assert {(0, "stall", False), (0, "", True), (1, "", True), (2, "", True)} == set(ends)
    assert len(ends) == 7


@pytest.mark.parametrize("suite", ["gusty-v1", "no-wind-sensor-v1"])
def test_lanes_of_v1_equal_single_environments(suite: str):
    settings: dict[str, Any] = {"suite": suite, "duration_s": 3.0}
    reference = DummyVecEnv([lambda: gym.make("wtg_gym:GFMWTG-14bus-v1", **settings)] * 2)
    env = make_sb3_vec_env(2, seed=40, **settings)
    reference.seed(40)
    assert same(reference.reset(), env.reset()) and env.observation_space.shape == (32,)
    for actions in actions_of(1, 70, 2, 8).astype(np.float32):
        for a, b in zip(reference.step(actions)[:3], env.step(actions)[:3], strict=True):
            assert same(a, b)


def test_ppo_learns_the_same_as_with_single_environments():
    (model_a, curve_a), (model_b, curve_b) = [trained(VecMonitor(venv)) for venv in both()]
    reasons = {(end["termination_reason"], end["TimeLimit.truncated"]) for end in curve_b.ends}
    assert reasons == {("stall", False), ("", True)}
    assert len(curve_a.ends) == len(curve_b.ends)
    assert all(same(a, b) for a, b in zip(curve_a.ends, curve_b.ends, strict=True))
    assert curve_a.episodes == curve_b.episodes and all("r" in episode for episode in curve_b.episodes)
    assert len(curve_a.buffers) == 3
    assert all(same(a, b) for a, b in zip(curve_a.buffers, curve_b.buffers, strict=True))
    losses = model_a.logger.name_to_value
    assert "train/loss" in losses and losses == model_b.logger.name_to_value
    parameters_a, parameters_b = model_a.policy.state_dict(), model_b.policy.state_dict()
    assert set(parameters_a) == set(parameters_b)
    assert all(torch.equal(parameters_a[name], parameters_b[name]) for name in parameters_a)


def test_ppo_learns_the_same_as_with_single_environments_in_a_monitor():
    reference = DummyVecEnv([lambda: Monitor(gym.make(ENV_ID, **SHORT))] * N)
    (model_a, curve_a), (model_b, curve_b) = trained(reference), trained(make_sb3_vec_env(N, **SHORT))
    for name, parameter in model_a.policy.state_dict().items():
        assert torch.equal(parameter, model_b.policy.state_dict()[name]), name
    assert [episode["l"] for episode in curve_a.episodes] == [episode["l"] for episode in curve_b.episodes]
    returns = [[episode["r"] for episode in curve.episodes] for curve in (curve_a, curve_b)]
    assert returns[0] == pytest.approx(returns[1], rel=1e-5, abs=1e-5)


def test_sac_takes_the_end_of_time_for_no_failure():
    env = native()
    env.set_options(FAILURE_FIRST)
    model = SAC("MlpPolicy", env, learning_starts=60, batch_size=16, buffer_size=600, train_freq=8, **small())
    model.learn(330)
    buffer = model.replay_buffer
    done, timeout = buffer.dones[: buffer.pos].astype(bool), buffer.timeouts[: buffer.pos].astype(bool)
    assert done.sum() == 6 and timeout.sum() == 5 and not (timeout & ~done).any()
    failure = int(np.flatnonzero(done & ~timeout)[0]) // N
    # The buffer holds the episode's own last observation next, not the first one of the next episode.
    assert not np.array_equal(buffer.next_observations[failure, 0], buffer.observations[failure + 1, 0])


def test_rewards_dones_and_observations_are_new_arrays_of_the_expected_types():
    env = native()
    first = env.reset()
    kept = first.copy()
    one = env.step(zeros(env))
    held = [value.copy() for value in one[:3]]
    env.step(zeros(env) + 1.0)
    assert same(first, kept) and all(same(a, b) for a, b in zip(one[:3], held, strict=True))
    assert [value.dtype for value in one[:3]] == [np.float32, np.float32, np.bool_]
    assert first.shape == one[0].shape == (N, 20) and one[1].shape == one[2].shape == (N,)


def test_infos_are_new_dictionaries_that_a_caller_may_write_into():
    env = native()
    env.reset()
    infos = env.step(zeros(env))[3]
    infos[0]["mine"] = 1
    assert infos[1:] == [{"TimeLimit.truncated": False}] * (N - 1)
    assert env.step(zeros(env))[3] == [{"TimeLimit.truncated": False}] * N


def test_seeds_are_used_once():
    env = native()
    assert env.seed(9) == [9, 10, 11]
    first = env.reset()
    second = env.reset()
    env.seed(9)
    assert same(env.reset(), first) and not same(second, first)
    assert same(env.reset(), second)
    assert len(set(env.seed())) == N


def test_without_a_seed_lanes_differ():
    env = native()
    assert len({observation.tobytes() for observation in env.reset()}) == N


def test_options_are_used_once_and_for_all_lanes_where_they_are_one_dictionary():
    env = native()
    env.set_options({"scenario": calm(9.0, 5.0)})
    env.seed(1)
    observations = env.reset()
    assert same(observations[0], observations[1]) and [info["scenario_seed"] for info in env.reset_infos] == [-1] * N
    env.reset()
    assert all(info["scenario_seed"] >= 0 for info in env.reset_infos)
    env.set_options({"scenario": calm(9.0, 5.0)})
    env.set_options(None)
    env.reset()
    assert all(info["scenario_seed"] >= 0 for info in env.reset_infos)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wind": 9.0}, r"unknown reset options \['wind'\]; known options: scenario"),
        ({"scenarios": []}, r"unknown reset options \['scenarios'\]; known options: scenario"),
        ([{}], "a list of 3"),
        ([{}, {}, None], "a list of 3"),
    ],
)
def test_unknown_options_are_refused_when_they_are_set(options: Any, message: str):
    env = native()
    with pytest.raises(ValueError, match=message):
        env.set_options(options)
    env.reset()


def test_a_scenario_that_does_not_fit_is_refused_before_any_lane_changes():
    env, other = native(), native()
    for venv in (env, other):
        venv.seed(2)
        venv.reset()
    env.set_options([{}, {"scenario": calm(9.0, 5.0)}, {"scenario": 9.0}])
    with pytest.raises(ValueError, match="must be a Scenario"):
        env.reset()
    assert all(same(a, b) for a, b in zip(env.step(zeros(env))[:3], other.step(zeros(other))[:3], strict=True))


def test_steps_that_cannot_be_done_are_refused():
    env = native()
    with pytest.raises(RuntimeError, match="reset"):
        env.step(zeros(env))
    with pytest.raises(RuntimeError, match="step_async"):
        env.step_wait()
    env.reset()
    with pytest.raises(ValueError, match="not finite"):
        env.step(zeros(env) + np.nan)
    with pytest.raises(ValueError, match="shape"):
        env.step(zeros(env)[:2])
    env.step(zeros(env))


def test_attributes_are_those_of_single_environments():
    env, reference = native(), dummy()
    for name in ("observation_space", "action_space", "observation_names", "settings", "render_mode"):
        assert env.get_attr(name) == reference.get_attr(name), name
        assert env.get_attr(name, indices=[0, 2]) == reference.get_attr(name, indices=[0, 2]), name
    assert env.get_attr("settings", 1) == [env.vector_env.settings]
    assert env.observation_space == reference.observation_space and env.action_space == reference.action_space
    assert env.render_mode is None and env.get_images() == [None] * N and env.unwrapped is env
    assert env.env_is_wrapped(Monitor) == [False] * N and env.env_is_wrapped(Monitor, [1]) == [False]
    assert env.has_attr("settings") and not env.has_attr("action_masks")


def test_what_a_lane_has_not_of_its_own_is_refused():
    env = native()
    for name in ("np_random", "step", "reset", "no_such_name"):
        with pytest.raises(AttributeError, match=name):
            env.get_attr(name)
    with pytest.raises(AttributeError, match="cannot set 'suite'"):
        env.set_attr("suite", "gust")
    with pytest.raises(AttributeError, match="cannot call 'reset'"):
        env.env_method("reset", seed=1)
    with pytest.raises(IndexError):
        env.get_attr("settings", [N])


def test_bad_arguments_are_refused_when_it_is_made():
    with pytest.raises(TypeError, match="autoreset_mode cannot be chosen"):
        SB3VecEnv(2, autoreset_mode="NextStep", version="v0")
    with pytest.raises(TypeError, match="unexpected keyword argument"):
        make_sb3_vec_env(2, durations=3.0, version="v0")
    with pytest.raises(ValueError, match="num_envs"):
        SB3VecEnv(0, version="v0")


def test_it_can_be_closed_twice():
    env = native()
    env.reset()
    env.close()
    env.close()


def test_helper_seeds_and_monitors():
    env = make_sb3_vec_env(2, seed=4, n_threads=1, max_episode_steps=6, **SHORT)
    other = SB3VecEnv(2, n_threads=1, **SHORT)
    other.seed(4)
    assert same(env.reset(), other.reset())
    assert is_vecenv_wrapped(env, VecMonitor)
    episodes = [env.step(zeros(env))[3][1].get("episode") for _ in range(6)]
    assert episodes[:5] == [None] * 5 and episodes[5]["l"] == 6
    env.close()


@pytest.mark.filterwarnings("error")
def test_wrappers_of_stable_baselines3_go_around_it():
    env = VecNormalize(VecCheckNan(make_sb3_vec_env(2, seed=0, **SHORT), raise_exception=True))
    env.reset()
    for actions in actions_of(4, 50, 2):
        observations, _, dones, infos = env.step(actions)
    assert dones.all()
    for lane, info in enumerate(infos):
        assert info["episode"]["l"] == 50 and info["TimeLimit.truncated"]
        last = env.unnormalize_obs(info["terminal_observation"])
        assert not np.allclose(last, env.unnormalize_obs(observations)[lane])
    assert env.unwrapped.get_attr("settings") == env.get_attr("settings")
    env.close()


@pytest.mark.filterwarnings("ignore:rich is experimental")
def test_learning_with_a_progress_bar_normalised_observations_and_evaluation():
    env = VecNormalize(make_sb3_vec_env(2, **SHORT))
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=64, **small())
    model.learn(128, progress_bar=True)
    assert len(model.ep_info_buffer) == 2 and model.ep_info_buffer[0]["l"] == 50
    returns, lengths = evaluate_policy(model, make_sb3_vec_env(2, seed=1, **SHORT), 4, return_episode_rewards=True)
    assert lengths == [50] * 4 and all(value < 0.0 for value in returns)


def test_without_stable_baselines3_the_import_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.vec_env", None)
    monkeypatch.delitem(sys.modules, "wtg_gym.sb3")
    with pytest.raises(ImportError, match=r"sb3 needs Stable-Baselines3; in a checkout: pip install '\.\[train\]'"):
        importlib.import_module("wtg_gym.sb3")
