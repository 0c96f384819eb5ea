"""An interrupted call has changed every environment or none, and what follows is the same to the last bit."""

import copy
import time

import numpy as np
import pytest

from tests.envs.rollouts import bits
from tests.interruption import interrupt_before
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.sb3 import make_sb3_vec_env

#: Lanes that are worth a thread.
N = 64
#: Episodes of ten steps, so that many steps start some.
SHORT = {"version": "v0", "duration_s": 1.0}


def batch(n_threads: int, **arguments) -> GFMWTGVectorEnv:
    env = GFMWTGVectorEnv(N * n_threads, n_threads=n_threads, **SHORT, **arguments)
    env.reset(seed=0)
    for k in range(4):
        reset_some(env, k)
        step(env, k)
    return env


def monitored(n_threads: int, **more):
    env = make_sb3_vec_env(N * n_threads if n_threads > 1 else 3, seed=0, n_threads=n_threads, **more, **SHORT)
    env.reset()
    return env


def agents(_: int):
    env = pytest.importorskip("wtg_gym.pettingzoo").parallel_env(strategy="mppt", on_failure="trip", **SHORT)
    env.reset(seed=0)
    return env


def single(_: int, render_mode: str | None = None) -> GFMWTGEnv:
    env = GFMWTGEnv(render_mode=render_mode, **SHORT)
    env.reset(seed=0)
    return env


def step(env, k: int):
    return env.step(np.random.default_rng(k).uniform(-1.0, 1.0, (env.num_envs, 4)).astype(np.float32))


def step_or_reset(env, k: int):
    if hasattr(env, "agents"):
        return env.step({agent: np.full(2, 0.1 * k % 1.0) for agent in env.agents}) if env.agents else env.reset()
    return env.reset() if np.any(env.lanes.ended()) else env.step(np.full(4, 0.1 * k % 1.0))


def reset(env: GFMWTGVectorEnv, k: int):
    return env.reset(seed=k if k % 2 else None)


def reset_some(env: GFMWTGVectorEnv, k: int):
    return env.reset(options={"reset_mask": np.random.default_rng(k).random(env.num_envs) < 0.1})


def native(env):
    for name in ("venv", "vector_env", "env", "single_env"):
        env = vars(env).get(name, env)
    return env


def state(env):
    """Return everything of an environment that a call may change, in a form that compares to the bit."""
    names = ("agents", "reset_infos", "episode_returns", "episode_lengths")
    return bits([*native(env).snapshot().lanes[1:], *(getattr(env, name, None) for name in names)])


CASES = {
    "next step": (batch, step),
    "same step": (lambda n: batch(n, autoreset_mode="SameStep"), step),
    "step limit": (lambda n: batch(n, max_episode_steps=2), step),
    "reset": (batch, reset),
    "reset of some": (batch, reset_some),
    "Stable-Baselines3": (monitored, step),
    "score": (lambda _: monitored(1, reward="score"), step),
    "single": (single, step_or_reset),
    "rendering": (lambda n: single(n, "rgb_array"), step_or_reset),
    "PettingZoo": (agents, step_or_reset),
}
THREADED = ("next step", "same step", "step limit", "Stable-Baselines3")


@pytest.mark.parametrize(
    ("name", "n_threads"), [(name, n) for name in CASES for n in ((1, 2, 4) if name in THREADED else (1,))]
)
def test_interrupted_call_is_complete_or_has_not_begun(name, n_threads, monkeypatch):
    # The monitor reports how long an episode took.
    monkeypatch.setattr(time, "time", lambda: 0.0)
    make, call = CASES[name]
    env, rng, n_interrupts, k = make(n_threads), np.random.default_rng(0), 0, 0
    twin = copy.deepcopy(env)
    while n_interrupts < 5:
        k, before = k + 1, state(twin)
        with interrupt_before(0) as instructions:
            expected = call(twin, k)
        try:
            with interrupt_before(int(rng.integers(1, instructions[0], endpoint=True))):
                result = call(env, k)
        except KeyboardInterrupt:
            n_interrupts += 1
            if state(env) == state(twin):
                continue
            assert state(env) == before
            result = call(env, k)
        assert bits(result) == bits(expected)
