"""For docs/performance.md: environment steps per second, of ours and of others, with gradients, and while training.

Ten minutes on a machine that does nothing else. Every case runs several times, in turns, so that a busy spell slows all
of them alike; the median counts, and its ratio to Pendulum-v1 can be compared with other machines'. Other projects'
environments are measured where they are installed, in the same virtual environment:

    pip install gym-electric-motor gym-anm grid2op lightsim2grid envpool andes
"""

import functools
import importlib.util
import logging
import os
import platform
import re
import statistics
import time
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from output import folder
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.gradients import Tape
from wtg_gym.sb3 import SB3VecEnv
from wtg_gym.scenarios import get_suite

SECONDS, REPEATS = 1.0, 5
YARDSTICK = "Pendulum-v1"  # physics of a few lines, in pure Python
OURS = {"v0": "wtg_gym:GFMWTG-14bus-v0", "v1": "wtg_gym:GFMWTG-14bus-v1"}
#: Version v1 on other grids.
GRIDS = {"IEEE 39": "ieee39", "Nordic 45": "nordic45"}
N_PROCESSORS = os.cpu_count() or 1


# --- what is stepped: each function prepares a case and returns what makes some steps, and how many -------------------


def single(env):
    """Step a single environment with random actions drawn beforehand, resets included."""
    actions = [env.action_space.sample() for _ in range(256)]
    env.reset(seed=0)
    count = iter(range(10**12))

    def step():
        _, _, terminated, truncated, _ = env.step(actions[next(count) % len(actions)])
        if terminated or truncated:
            env.reset()

    return step, 1


def batch(envs, action_space, n_envs):
    """Step a started batch that resets its environments itself."""
    actions = [np.stack([action_space.sample() for _ in range(n_envs)]) for _ in range(8)]
    count = iter(range(10**12))
    return lambda: envs.step(actions[next(count) % 8]), n_envs


def vector(name, n_envs):
    """Step a batch of ours whose first episodes are of all lengths, so that resets come evenly from then on."""
    envs, suite = GFMWTGVectorEnv(n_envs, suite=name), get_suite(name)
    lengths = np.random.default_rng(0).integers(10, round(10.0 * suite.duration_s), n_envs) / 10.0
    scenarios = [suite.scenario(suite.validation[i % 100], duration_s=float(s)) for i, s in enumerate(lengths)]
    envs.reset(seed=0)
    envs.reset(options={"scenarios": scenarios})
    return batch(envs, envs.single_action_space, n_envs)


def gradients(version, n_lanes):
    """Play whole episodes and go back to the gradient of their cost with respect to every action."""
    tape = Tape(EnvSettings(version=version), n_lanes)
    scenarios = tape.lanes.scenarios(list(tape.lanes.suite.validation)[:n_lanes])
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (600, n_lanes, tape.lanes.n_action))
    return lambda: tape.gradient(scenarios, actions), 600 * n_lanes


def training(envs, n_envs):
    """Learn with Stable-Baselines3's PPO: rollouts of 8192 steps over all environments, batches of 1024, 4 epochs."""
    n_steps = 8192 // n_envs
    model = PPO("MlpPolicy", envs, n_steps=n_steps, batch_size=1024, n_epochs=4, seed=0, device="cpu")
    return lambda: model.learn(n_steps * n_envs, reset_num_timesteps=False), n_steps * n_envs


def dummies(n_envs):
    """Return Stable-Baselines3's vector environment that steps our single environments in turn."""
    return DummyVecEnv([functools.partial(gym.make, OURS["v0"])] * n_envs)


def electric_motor():
    import gym_electric_motor

    # It reports observations out of its own space.
    warnings.simplefilter("ignore")
    return single(gym_electric_motor.make("Cont-CC-PMSM-v0"))


def grid2op(backend=None):
    """Step Grid2Op's power flow without actions: random topologies would end episodes at once."""
    import grid2op

    settings = {}
    if backend is not None:
        from lightsim2grid import LightSimBackend

        settings["backend"] = LightSimBackend()
    warnings.simplefilter("ignore")
    env = grid2op.make("l2rpn_case14_sandbox", test=True, **settings)
    nothing = env.action_space({})
    env.reset()

    def step():
        if env.step(nothing)[2]:
            env.reset()

    return step, 1


def envpool(name):
    import envpool

    envs = envpool.make(name, env_type="gymnasium", num_envs=1024)
    envs.reset()
    return batch(envs, envs.action_space, 1024)


def andes():
    """Step ANDES' own environment on its 14-bus case: five GENROU machines with governors and exciters, 0.1 s."""
    import andes
    from andes.rl import AndesEnv

    logging.getLogger("andes").setLevel(logging.ERROR)
    env = AndesEnv(
        case=andes.get_case("ieee14/ieee14_full.xlsx"),
        obs=[("GENROU", "omega")],
        acts=[("SynGen", "paux")],
        reward_fn=lambda observation, action, env: -float(sum((observation - 1.0) ** 2)),
        dt=0.1,
        tf=20.0,
        action_low=-0.01,
        action_high=0.01,
    )
    return single(env)


def cases():
    """Return what prepares each case, by its name; the yardstick first."""
    found = {YARDSTICK: functools.partial(single, gym.make(YARDSTICK))}
    for version in OURS:
        found[version] = functools.partial(single, gym.make(OURS[version]))
    for version in OURS:
        for n in (64, 1024):
            found[f"{version}, vector of {n}"] = functools.partial(vector, EnvSettings(version=version).suite, n)
    for name, grid in GRIDS.items():
        found[f"{name}, vector of 1024"] = functools.partial(vector, EnvSettings(grid=grid).suite, 1024)
    for version in OURS:
        found[f"{version}, gradients of 64"] = functools.partial(gradients, version, 64)
    found["v0, PPO on the SB3 adapter of 1024"] = lambda: training(SB3VecEnv(1024), 1024)
    found["v0, PPO on DummyVecEnv of 8"] = lambda: training(dummies(8), 8)
    peers = {
        "gym_electric_motor": {"Gym Electric Motor, Cont-CC-PMSM-v0": electric_motor},
        "gym_anm": {"Gym-ANM, ANM6Easy-v0": lambda: single(gym.make("gym_anm:ANM6Easy-v0"))},
        "grid2op": {"Grid2Op, l2rpn_case14_sandbox": grid2op},
        "lightsim2grid": {"Grid2Op with lightsim2grid": lambda: grid2op("lightsim2grid")},
        "envpool": {"EnvPool, Pendulum-v1, batch of 1024": functools.partial(envpool, YARDSTICK)},
        "andes": {"ANDES, andes.rl, ieee14_full": andes},
    }
    for package, own in peers.items():
        if importlib.util.find_spec(package) is not None:
            found |= own
        else:
            print(f"left out, not installed: {package}")
    return found


# --- measuring --------------------------------------------------------------------------------------------------------


def rate(step, n_per_step):
    """Return steps per second, over `SECONDS` or one call."""
    n, begin = 0, time.perf_counter()
    while (passed := time.perf_counter() - begin) < SECONDS or n == 0:
        step()
        n += 1
    return n * n_per_step / passed


def machine():
    """Return the processor, their number and the version of Python."""
    model, file = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if file.exists():
        found = re.search(r"^model name\s*: (.*)$", file.read_text(), re.MULTILINE)
        model = found[1] if found else model
    return f"{model}, {N_PROCESSORS} processors, Python {platform.python_version()}"


def main(docs):
    """Renew the page."""
    # With layers this small a second thread waits more than it computes.
    torch.set_num_threads(1)
    steppers = {}
    for name, make in cases().items():
        print(f"preparing {name}", flush=True)
        steppers[name] = make()
        steppers[name][0]()
    rates = {name: [] for name in steppers}
    for _ in range(REPEATS):
        for name, stepper in steppers.items():
            rates[name].append(rate(*stepper))
    medians = {name: statistics.median(own) for name, own in rates.items()}
    rows = [(name, f"{median:,.0f}", f"{median / medians[YARDSTICK]:.2g}") for name, median in medians.items()]
    table = markdown_table(("case", "steps per s", f"× {YARDSTICK}"), rows, right=(1, 2))
    text = f"{machine()}; median of {REPEATS} runs of {SECONDS:g} s.\n\n{table}"
    update_between_markers(docs / "performance.md", text, "speed")


if __name__ == "__main__":
    main(folder(__doc__))
