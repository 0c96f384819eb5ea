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
#: Steps of the loops that JAX compiles, and episodes side by side whose gradient it finds.
JAX_STEPS, JAX_BATCH = 100, 64


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
    """Yield episodes of our environments in a batch, with the gradient of their cost with respect to all actions.

    Where JAX is installed, its twin of v0 follows: steps alone, and with the gradient too.
    """
    for env_id, benchmark in BENCHMARKS.items():
        for n in (1, 64):
            yield Case("gradients", f"{env_id}, gradients of {n}", n, partial(_gradients, benchmark, n), least_s=0.5)
    if not installed("jax"):
        return
    for n in (1, 64, 1024):
        yield Case("gradients", f"{OURS} by JAX, batch of {n}", n, partial(_by_jax, n), preparation_s=20.0)
    # The compiler works numbers out again for each that is made of them.
    name = f"{OURS} by JAX, batch of 1024, without XLA's fusion"
    yield Case("gradients", name, 1024, partial(_by_jax, 1024, xla_disable_hlo_passes="fusion"), preparation_s=10.0)
    name = f"{OURS} by JAX, gradients of {JAX_BATCH}"
    yield Case("gradients", name, JAX_BATCH, _jax_gradients, preparation_s=60.0, least_s=2.0)


def _gradients(benchmark: Benchmark, n_lanes: int) -> Stepper:
    from wtg_gym.gradients import Tape

    tape = Tape(EnvSettings(version=benchmark.version), n_lanes)
    scenarios = tape.lanes.scenarios(list(tape.lanes.suite.validation)[:n_lanes])
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (600, n_lanes, tape.lanes.n_action))
    return repeat(lambda _: tape.gradient(scenarios, actions), actions[:, :, 0].size)


def _twin() -> Any:
    import jax

    jax.config.update("jax_enable_x64", True)
    from wtg_gym.functional import FunctionalEnv

    return FunctionalEnv(EnvSettings(version="v0", split="validation"))


def _by_jax(n_envs: int, **compiler_options: str) -> Stepper:
    """Return a batch of the twin that steps, with resets, under one compiled loop."""
    env = _twin()
    import jax
    import jax.numpy as jnp

    keys = jax.random.split(jax.random.key(0), n_envs)
    params = jax.device_put(env.default_params)
    actions = jnp.asarray(np.random.default_rng(0).uniform(-1.0, 1.0, (JAX_STEPS, n_envs, env.num_actions)))

    def run(states: Any) -> Any:
        def step(states: Any, own: Any) -> Any:
            _, states, rewards, *_ = jax.vmap(env.step, (0, 0, 0, None))(keys, states, own, params)
            return states, rewards

        return jax.lax.scan(step, states, actions)

    compiled = jax.jit(run, compiler_options=compiler_options or None)
    held = [jax.vmap(env.reset, (0, None))(keys, params)[1]]

    def steps(_: int) -> None:
        states, rewards = compiled(held[0])
        jax.block_until_ready(rewards)
        held[0] = states

    return repeat(steps, JAX_STEPS * n_envs)


def _jax_gradients() -> Stepper:
    env = _twin()
    import jax
    import jax.numpy as jnp

    params, key = jax.device_put(env.default_params), jax.random.key(0)
    states = jax.vmap(lambda place: env.start(place, params)[1])(jnp.arange(JAX_BATCH) % params.start.shape[0])
    actions = jnp.asarray(np.random.default_rng(0).uniform(-0.3, 0.3, (JAX_STEPS, JAX_BATCH, env.num_actions)))

    def cost(actions: Any) -> Any:
        def step(states: Any, own: Any) -> Any:
            _, states, rewards, *_ = jax.vmap(env.step_env, (None, 0, 0, None))(key, states, own, params)
            return states, rewards

        return -jax.lax.scan(step, states, actions)[1].sum()

    gradient = jax.jit(jax.grad(cost))
    return repeat(lambda _: jax.block_until_ready(gradient(actions)), actions[:, :, 0].size)


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
