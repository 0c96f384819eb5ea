"""Cases that step environments: ours, Gymnasium's own, and Stable-Baselines3's vector environments."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from wtg_gym.analysis.benchmarks.timing import Case, Stepper, repeat, step_batch, step_single
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.plant import PHYSICS
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import BENCHMARKS, Benchmark

#: The id under which importing `wtg_gym` registers our environment.
OURS = "GFMWTG-14bus-v0"
#: Every rate is divided by that of this environment: physics of a few lines, in pure Python.
YARDSTICK = "Pendulum-v1"


def installed(*packages: str) -> bool:
    """Return whether all of some packages are installed."""
    return all(importlib.util.find_spec(package) is not None for package in packages)


def yardstick() -> Case:
    """Return the case that every other one is compared with."""
    return Case("environments", YARDSTICK, 1, partial(_single, YARDSTICK))


def environment_cases() -> Iterator[Case]:
    """Yield the environments other than the yardstick; Stable-Baselines3's where it is installed."""
    part = "environments"
    yield Case(part, "CartPole-v1", 1, partial(_single, "CartPole-v1"))
    for env_id, benchmark in BENCHMARKS.items():
        yield Case(part, env_id, 1, partial(_single, env_id))
        for n in (64, 1024):
            yield Case(part, f"{env_id}, vector of {n}", n, partial(_our_vector, benchmark, n))
    yield Case(part, "CartPole-v1, vector of 1024", 1024, _cart_poles)
    if not installed("stable_baselines3"):
        return
    n_cpu = os.cpu_count() or 1
    for n in (64, 1024):
        yield Case(part, f"SB3 adapter of {n}", n, partial(_step_sb3, adapter, n))
    yield Case(part, "SB3 DummyVecEnv of 8", 8, partial(_step_sb3, dummies, 8))
    yield Case(part, f"SB3 SubprocVecEnv of {n_cpu}", n_cpu, partial(_step_sb3, processes, n_cpu), preparation_s=4.0)


def physics_cases() -> Iterator[Case]:
    """Yield our environment, alone and in a batch, on each kind of physics."""
    for physics in PHYSICS:
        yield Case("physics", f"{physics} physics", 1, partial(_on, physics, 1))
        yield Case("physics", f"{physics} physics, vector of 1024", 1024, partial(_on, physics, 1024))


def _on(physics: str, n_envs: int) -> Stepper:
    if n_envs == 1:
        return step_single(gym.make(OURS, physics=physics))
    envs = gym.make_vec(OURS, num_envs=n_envs, physics=physics)
    envs.reset(seed=0)
    return step_batch(envs, envs.single_action_space, envs.num_envs)


def gradient_cases() -> Iterator[Case]:
    """Yield episodes of our environments in a batch, with the gradient of their cost with respect to all actions."""
    for env_id, benchmark in BENCHMARKS.items():
        for n in (1, 64):
            yield Case("gradients", f"{env_id}, gradients of {n}", n, partial(_gradients, benchmark, n), least_s=0.5)


def _gradients(benchmark: Benchmark, n_lanes: int) -> Stepper:
    from wtg_gym.gradients import Tape

    tape = Tape(EnvSettings(version=benchmark.version), n_lanes)
    scenarios = tape.lanes.scenarios(list(tape.lanes.suite.validation)[:n_lanes])
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (600, n_lanes, tape.lanes.n_action))
    return repeat(lambda _: tape.gradient(scenarios, actions), actions[:, :, 0].size)


def rendering_cases() -> Iterator[Case]:
    """Yield environments that draw a frame at every step, for which they need matplotlib and pygame."""
    for name in (OURS, "CartPole-v1", YARDSTICK):
        yield Case("rendering", f"{name}, a frame each step", 1, partial(_filmed, name))


class _Filmed(gym.Wrapper[Any, Any, Any, Any]):
    """Draws a frame at every step and drops it."""

    def step(self, action: Any) -> Any:
        found = self.env.step(action)
        self.env.render()
        return found


def _filmed(name: str) -> Stepper:
    return step_single(_Filmed(gym.make(name, render_mode="rgb_array")))


def adapter(n_envs: int) -> Any:
    """Return our batch as a vector environment of Stable-Baselines3."""
    from wtg_gym.sb3 import SB3VecEnv

    return SB3VecEnv(n_envs, version="v0")


def dummies(n_envs: int) -> Any:
    """Return Stable-Baselines3's vector environment that steps our single environments in turn."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    return DummyVecEnv([_make_ours] * n_envs)


def processes(n_envs: int) -> Any:
    """Return Stable-Baselines3's vector environment with a process for each of our environments."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    return SubprocVecEnv([_make_ours] * n_envs, "forkserver")


def _make_ours() -> Any:
    return gym.make(OURS)


def _single(name: str) -> Stepper:
    return step_single(gym.make(name))


def _our_vector(benchmark: Benchmark, n_envs: int) -> Stepper:
    """Return a batch whose first episodes are of all lengths, so that resets come evenly from then on."""
    envs = gym.make_vec(benchmark.env_id, num_envs=n_envs)
    suite = get_suite(EnvSettings(version=benchmark.version).suite)
    lengths = np.random.default_rng(0).integers(10, round(10.0 * suite.duration_s), n_envs) / 10.0
    scenarios = [suite.scenario(suite.validation[i % 100], duration_s=float(s)) for i, s in enumerate(lengths)]
    envs.reset(seed=0)
    envs.reset(options={"scenarios": scenarios})
    return step_batch(envs, envs.single_action_space, envs.num_envs)


def _cart_poles() -> Stepper:
    envs = gym.make_vec("CartPole-v1", num_envs=1024, vectorization_mode="vector_entry_point")
    envs.reset(seed=0)
    return step_batch(envs, envs.single_action_space, envs.num_envs)


def _step_sb3(make: Any, n_envs: int) -> Stepper:
    envs = make(n_envs)
    envs.reset()
    return step_batch(envs, envs.action_space, envs.num_envs)
