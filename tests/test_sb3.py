"""Facts about training with Stable-Baselines3 on many episodes at once."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from tests.envs.rollouts import actions_of, bits, calm, rising
from wtg_gym import Entry, export_onnx, get_law, load_entries
from wtg_gym.policies.entry_folder import example_law
from wtg_gym.sb3 import DeterministicPolicy, SB3VecEnv, make_sb3_vec_env

ENV_ID = "GFMWTG-14bus-v0"
N = 3
SHORT = {"version": "v0", "duration_s": 5.0, "strategy": "mppt"}


def dummy(n: int = N) -> DummyVecEnv:
    return DummyVecEnv([lambda: gym.make(ENV_ID, **SHORT)] * n)


def native(n: int = N) -> SB3VecEnv:
    return SB3VecEnv(n, **SHORT)


def zeros(env: VecEnv) -> np.ndarray:
    return np.zeros((env.num_envs, *env.action_space.shape), dtype=np.float32)


def test_every_step_equals_that_of_single_environments_with_the_same_seeds():
    reference, env = dummy(), native()
    for venv in (reference, env):
        venv.seed(40)
    assert bits(reference.reset()) == bits(env.reset())
    assert bits(dict(enumerate(reference.reset_infos))) == bits(dict(enumerate(env.reset_infos)))
    # The first environment's first episode ends at a stall, the third's earlier than the others.
    first, third = rising(5.0), calm(9.0, 1.5)
    reference.seed(40)
    reference.set_options([{"scenario": first}, {}, {"scenario": third}])
    options = {"reset_mask": np.array([True, False, True]), "scenarios": [first, first, third]}
    env.vector_env.reset(seed=[40, 41, 42])
    assert bits(reference.reset()) == bits(env.vector_env.reset(seed=[40, 41, 42], options=options)[0])
    ends = []
    for actions in actions_of(1, 130, N).astype(np.float32):
        expected, got = reference.step(actions), env.step(actions)
        assert bits(expected[:3]) == bits(got[:3])
        for env_index, (done, info, other) in enumerate(zip(*got[2:], expected[3], strict=True)):
            assert info["TimeLimit.truncated"] == other["TimeLimit.truncated"]
            if done:
                assert bits(other) == bits(info)
                assert bits(reference.reset_infos[env_index]) == bits(env.reset_infos[env_index])
                ends.append((env_index, info["termination_reason"], info["TimeLimit.truncated"]))
    assert {(0, "stall", False), (0, "", True), (1, "", True), (2, "", True)} == set(ends)
    assert len(ends) == 7


def test_what_cannot_be_done_is_refused():
    env = native()
    for call, kind, text in (
        (lambda: env.step(zeros(env)), RuntimeError, "reset"),
        (env.step_wait, RuntimeError, "step_async"),
        (lambda: env.get_attr("np_random"), AttributeError, "np_random"),
        (lambda: env.get_attr("no_such_name"), AttributeError, "no_such_name"),
        (lambda: env.get_attr("settings", [N]), IndexError, ""),
        (lambda: env.set_attr("suite", "gust"), AttributeError, "cannot set 'suite'"),
        (lambda: env.env_method("reset", seed=1), AttributeError, "cannot call 'reset'"),
        (lambda: SB3VecEnv(2, autoreset_mode="NextStep"), TypeError, "autoreset_mode cannot be chosen"),
        (lambda: make_sb3_vec_env(2, durations=3.0), TypeError, "unexpected keyword argument"),
        (lambda: SB3VecEnv(0), ValueError, "num_envs"),
    ):
        with pytest.raises(kind, match=text):
            call()
    env.set_options({"scenario": calm(9.0, 5.0)})
    with pytest.raises(ValueError, match="no reset options"):
        env.reset()
    env.set_options()
    env.reset()
    for actions, text in ((zeros(env) + np.nan, "not finite"), (zeros(env)[:2], "shape")):
        with pytest.raises(ValueError, match=text):
            env.step(actions)
    env.close()
    env.close()


def test_attributes_are_those_of_single_environments():
    env, reference = native(), dummy()
    for name in ("observation_space", "action_space", "observation_names", "action_names", "settings", "render_mode"):
        assert env.get_attr(name) == reference.get_attr(name), name
        assert env.get_attr(name, indices=[0, 2]) == reference.get_attr(name, indices=[0, 2]), name
    assert env.observation_space == reference.observation_space and env.action_space == reference.action_space
    assert env.render_mode is None and env.get_images() == [None] * N and env.unwrapped is env
    assert env.env_is_wrapped(Monitor) == [False] * N and env.env_is_wrapped(Monitor, [1]) == [False]


def learner(**arguments) -> PPO:
    return PPO("MlpPolicy", make_sb3_vec_env(2, **arguments), n_steps=4, batch_size=8)


def test_a_learner_is_played_on_the_law_that_it_learned_on(tmp_path):
    model = learner(strategy="coordinated-tuned", action_mode="k")
    with pytest.raises(ValueError, match="learned with strategy 'coordinated-tuned', the entry has 'mppt'"):
        Entry(name="mine", policy=model, strategy="mppt", action_mode="k")
    assert Entry(name="mine", policy=model, action_mode="k").law == get_law("coordinated-tuned")
    with pytest.raises(ValueError, match="learned with action_mode 'k', the entry has"):
        Entry(name="mine", policy=model, strategy="coordinated-tuned")
    Entry(name="mine", policy=model, strategy="coordinated-tuned", action_mode="k")
    with pytest.raises(ValueError, match="learned with strategy 'coordinated-tuned', the entry has 'mppt'"):
        export_onnx(DeterministicPolicy(model), tmp_path, name="mine", strategy="mppt")
    (entry,) = load_entries(export_onnx(DeterministicPolicy(model), tmp_path, name="mine"))
    assert (entry.law.name, entry.action_mode) == ("coordinated-tuned", "k")
    model.save(tmp_path / "model.zip")
    with pytest.raises(ValueError, match="a learner without an environment, as after load"):
        Entry(name="mine", policy=PPO.load(tmp_path / "model.zip"), action_mode="k")
    with pytest.raises(ValueError, match="a learner without an environment, as after load"):
        export_onnx(DeterministicPolicy(PPO.load(tmp_path / "model.zip")), tmp_path, name="mine", action_mode="k")


def test_a_learner_is_played_and_exported_in_its_own_version(tmp_path):
    model = learner(version="v0", strategy="mppt")
    (entry,) = load_entries(export_onnx(DeterministicPolicy(model), tmp_path, name="mine"))
    assert entry.environment == Entry(name="mine", policy=model).environment == ENV_ID


def test_laws_of_a_learner_may_be_files_or_objects(tmp_path):
    file = tmp_path / "my_law.toml"
    file.write_text(example_law())
    own = get_law(file)
    for strategy in (file, str(file), own, [own] * 4):
        model = learner(strategy=strategy)
        assert Entry(name="mine", policy=model, strategy=file).law == own
        assert Entry(name="mine", policy=model).law == own
        with pytest.raises(ValueError, match="a built-in one, the learner's was 'reserve-7'"):
            export_onnx(DeterministicPolicy(model), tmp_path, name="mine")
    several = learner(strategy=["mppt", "coordinated-tuned", "mppt", "mppt"])
    with pytest.raises(ValueError, match="mppt, coordinated-tuned, mppt, mppt"):
        Entry(name="mine", policy=several, strategy="mppt")
