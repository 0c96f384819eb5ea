"""Whatever a user holds can be pickled and copied, and the copies do the same to the last bit."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.rollouts import actions_of, bits, eventful
from wtg_gym import evaluate
from wtg_gym.envs import EnvSettings
from wtg_gym.gradients import Tape
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import get_law
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.sb3 import make_sb3_vec_env
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks.cost import COST_TERMS

SHORT: dict[str, Any] = {"version": "v0", "duration_s": 2.0}


def started(env: Any) -> Any:
    env.reset(seed=0)
    return env


def parallel_env() -> Any:
    return started(pytest.importorskip("wtg_gym.pettingzoo").parallel_env(**SHORT))


def monitored() -> Any:
    env = make_sb3_vec_env(3, seed=0, reward="score", **SHORT)
    env.reset()
    return env


def batch_steps(env: Any) -> Any:
    # The last value of a step of Stable-Baselines3 has the time that an episode took.
    return [env.step(actions)[:3] for actions in actions_of(0, 25, env.num_envs).astype(np.float32)]


def single_steps(env: Any) -> Any:
    return [*(env.step(actions[0]) for actions in actions_of(0, 15)), env.reset()]


def joint_steps(env: Any) -> Any:
    actions = actions_of(0, 15, len(env.possible_agents), 2)
    return [*(env.step(dict(zip(env.possible_agents, each, strict=True))) for each in actions), env.reset()]


def gradient(tape: Tape) -> Any:
    tape.play([eventful()] * 2, actions_of(0, 5, 2))
    return tape.pull(4, np.zeros((2, tape.n_carried)), np.ones((2, len(COST_TERMS))))


STANDARD = get_suite("standard")
SEED = STANDARD.seeds("validation").start
KINDS: dict[str, tuple[Callable[[], Any], Callable[[Any], Any]]] = {
    "gym.make": (lambda: started(gym.make("wtg_gym:GFMWTG-14bus-v1", duration_s=10.0, action_mode="k")), single_steps),
    "agents": (parallel_env, joint_steps),
    "Stable-Baselines3": (monitored, batch_steps),
    "entry": (lambda: load_entries("linear-feedback")[0], lambda entry: entry.to_dict()),
    "policy": (lambda: load_entries("linear-feedback")[0].policy, lambda policy: policy.predict(np.ones((2, 20)))),
    "results": (
        lambda: evaluate("mppt", "standard", seeds=[SEED], duration_s=2.0),
        lambda results: (results.entries, results.episodes, results.scores),
    ),
    "scenario": (eventful, Scenario.to_dict),
    "suite": (lambda: STANDARD, lambda suite: (suite.hash, suite.scenario(SEED).to_dict())),
    "settings": (lambda: EnvSettings(**SHORT), repr),
    "plant": (Plant, repr),
    "law": (lambda: get_law("coordinated-tuned"), repr),
    "tape": (lambda: Tape(EnvSettings(version="v0", duration_s=4.0), 2), gradient),
}


@pytest.mark.parametrize("kind", KINDS)
def test_pickles_and_copies_do_the_same_to_the_last_bit(kind):
    make, outcome = KINDS[kind]
    original = make()
    copies = [pickle.loads(pickle.dumps(original)), copy.deepcopy(original)]
    expected = bits(outcome(original))
    for each in copies:
        assert bits(outcome(each)) == expected
