"""The speed of learning with Stable-Baselines3's PPO: steps per second of rollout and update together."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Iterator
from typing import Any

from wtg_gym.analysis.benchmarks.environments import adapter, dummies, processes
from wtg_gym.analysis.benchmarks.timing import Case, Stepper, repeat

#: Transitions of a rollout, shared by all environments.
ROLLOUT = 8192
BATCH_SIZE = 1024
N_EPOCHS = 4


def training_cases() -> Iterator[Case]:
    """Yield PPO on our adapter and on Stable-Baselines3's own vector environments; all else is the same."""
    n_cpu = os.cpu_count() or 1
    cases = {
        "SB3 adapter of 64": (64, adapter),
        "SB3 adapter of 1024": (1024, adapter),
        "SB3 DummyVecEnv of 8": (8, dummies),
        f"SB3 DummyVecEnv of {n_cpu}": (n_cpu, dummies),
        f"SB3 SubprocVecEnv of {n_cpu}": (n_cpu, processes),
    }
    for name, (n, make) in cases.items():
        train = functools.partial(_train, make, n)
        yield Case("training", f"PPO on {name}", n, train, preparation_s=4.0, least_s=3.0)


def describe_training() -> str:
    """Return the set-up in words."""
    return (
        f"PPO, MlpPolicy (two layers of 64), rollouts of {ROLLOUT} steps over all environments, batches of "
        f"{BATCH_SIZE}, {N_EPOCHS} epochs, torch on one thread of the CPU"
    )


def _train(make: Any, n_envs: int) -> Stepper:
    import torch
    from stable_baselines3 import PPO

    # With layers this small a second thread waits more than it computes, the more so where our own threads step.
    torch.set_num_threads(1)
    envs, n_steps = make(n_envs), max(2, ROLLOUT // n_envs)
    with warnings.catch_warnings():
        # With an odd number of processes the last batch is smaller.
        warnings.filterwarnings("ignore", "You have specified a mini-batch size", UserWarning)
        model = PPO("MlpPolicy", envs, n_steps=n_steps, batch_size=BATCH_SIZE, n_epochs=N_EPOCHS, seed=0, device="cpu")
    return repeat(lambda _: model.learn(n_steps * n_envs, reset_num_timesteps=False), n_steps * n_envs)
