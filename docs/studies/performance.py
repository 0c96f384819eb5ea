"""For docs/performance.md: environment steps per second, with gradients, and while training.

Ten minutes on a machine that does nothing else. Every case runs several times, in turns, so that a busy spell slows all
of them alike; the median counts, and its ratio to Pendulum-v1 can be compared with other machines'.
"""

import itertools
import os
import statistics
import time
from functools import partial

import gymnasium as gym
import numpy as np
import torch
from output import DOCS
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.circumstances import versions
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.gradients import Tape
from wtg_gym.sb3 import SB3VecEnv
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks import V0

SECONDS, REPEATS = 1.0, 5
YARDSTICK = "Pendulum-v1"  # physics of a few lines, in pure Python
OURS = {"v0": "wtg_gym:GFMWTG-14bus-v0", "v1": "wtg_gym:GFMWTG-14bus-v1"}


# Each of the next functions prepares a case and returns what makes steps, how many, and their length [s].


def single(env):
    """Step a single environment with random actions drawn beforehand, resets included."""
    actions = itertools.cycle([env.action_space.sample() for _ in range(256)])
    env.reset(seed=0)

    def step():
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    # Pendulum-v1 calls it dt.
    return step, 1, getattr(env.unwrapped, "dt", None) or env.unwrapped.settings.step_s


def vector(name, n_envs):
    """Step a batch of ours whose first episodes are of all lengths, so that resets come evenly once they are over."""
    envs, suite = GFMWTGVectorEnv(n_envs, suite=name), get_suite(name)
    step_s = envs.settings.step_s
    lengths = step_s * np.random.default_rng(0).integers(10, round(suite.duration_s / step_s), n_envs)
    scenarios = [suite.scenario(suite.validation[i % 100], duration_s=float(s)) for i, s in enumerate(lengths)]
    envs.reset(seed=0)
    envs.reset(options={"scenarios": scenarios})
    actions = itertools.cycle([envs.action_space.sample() for _ in range(8)])
    # Next episodes are prepared in advance, more of them in the beginning.
    for _ in range(round(suite.duration_s / step_s)):
        envs.step(next(actions))
    return lambda: envs.step(next(actions)), n_envs, step_s


def between_resets(grid, n_envs):
    """Step a batch of v1 on another grid by 0.1 s, with events; nothing is drawn, prepared or compared meanwhile."""
    batch = EnvBatch(EnvSettings(grid=grid, control_dt=0.1, reward="cost", duration_s=300.0), n_envs)
    batch.start(range(n_envs), batch.scenarios([batch.suite.validation[i % 300] for i in range(n_envs)]))
    actions = np.zeros((n_envs, batch.n_action))
    return lambda: batch.step(actions), n_envs, 0.1


def gradients(version, num_envs):
    """Play a minute and go back to the gradient of their cost with respect to every action."""
    tape = Tape(EnvSettings(version=version), num_envs)
    scenarios = tape.batch.scenarios(list(tape.batch.suite.validation)[:num_envs])
    n_steps = round(60.0 / tape.batch.settings.step_s)
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (n_steps, num_envs, tape.batch.n_action))
    return lambda: tape.gradient(scenarios, actions), len(actions) * num_envs, tape.batch.settings.step_s


def training(envs, n_envs):
    """Learn with Stable-Baselines3's PPO: rollouts of 8192 steps over all environments, batches of 1024, 4 epochs."""
    n_steps = 8192 // n_envs
    model = PPO("MlpPolicy", envs, n_steps=n_steps, batch_size=1024, n_epochs=4, seed=0, device="cpu")
    return lambda: model.learn(n_steps * n_envs, reset_num_timesteps=False), n_steps * n_envs, V0.control_dt


def cases():
    """Return what prepares each case, by its name; the yardstick first."""
    suites = {version: EnvSettings(version=version).suite_name for version in OURS}
    grids = {"IEEE 39": EnvSettings(grid="ieee39").suite_name, "Nordic 45": EnvSettings(grid="nordic45").suite_name}
    dummies = [partial(gym.make, OURS["v0"])] * 8
    return {
        **{name: partial(single, gym.make(env_id)) for name, env_id in ((YARDSTICK, YARDSTICK), *OURS.items())},
        **{f"{v}, vector of {n}": partial(vector, suite, n) for v, suite in suites.items() for n in (64, 1024)},
        **{f"{name}, vector of 1024": partial(vector, suite, 1024) for name, suite in grids.items()},
        "IEEE 39 between resets, steps of 0.1 s": partial(between_resets, "ieee39", 1024),
        **{f"{version}, gradients of 64": partial(gradients, version, 64) for version in OURS},
        "v0, PPO on the SB3 adapter of 1024": lambda: training(SB3VecEnv(1024, version="v0"), 1024),
        "v0, PPO on DummyVecEnv of 8": lambda: training(DummyVecEnv(dummies), 8),
    }


def rate(step, n_per_step):
    """Return steps per second, over `SECONDS` or one call."""
    n, begin = 0, time.perf_counter()
    while (passed := time.perf_counter() - begin) < SECONDS or n == 0:
        step()
        n += 1
    return n * n_per_step / passed


if __name__ == "__main__":
    # With layers this small a second thread waits more than it computes.
    torch.set_num_threads(1)
    steppers = {}
    for name, make in cases().items():
        print(f"preparing {name}", flush=True)
        steppers[name] = make()
        steppers[name][0]()
    turns = [{name: rate(*stepper[:2]) for name, stepper in steppers.items()} for _ in range(REPEATS)]
    medians = {name: statistics.median(turn[name] for turn in turns) for name in steppers}
    rows = [
        (name, f"{median:,.0f}", f"{median / medians[YARDSTICK]:.2g}", f"{median * steppers[name][2]:,.0f}")
        for name, median in medians.items()
    ]
    table = markdown_table(("case", "steps per s", f"× {YARDSTICK}", "simulated s per s"), rows, right=(1, 2, 3))
    machine = f"{versions()['processor']}, {os.cpu_count()} processors, Python {versions()['python']}"
    text = f"{machine}; median of {REPEATS} runs of {SECONDS:g} s.\n\n{table}"
    update_between_markers(DOCS / "performance.md", text, "speed")
