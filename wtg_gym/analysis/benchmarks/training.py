"""How fast Stable-Baselines3's PPO learns here: steps per second of rollout and update together."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Iterator
from typing import Any

from wtg_gym.analysis.benchmarks.environments import adapter, dummies, processes
from wtg_gym.analysis.benchmarks.timing import Case, Stepper

#: Transitions of a rollout, shared by however many environments there are.
ROLLOUT = 8192
BATCH_SIZE = 1024
N_EPOCHS = 4


def training_cases() -> Iterator[Case]:
    """Yield PPO on our adapter and on Stable-Baselines3's own vector environments; all else is the same."""
    n_cpu = os.cpu_count() or 1
    for name, n, make in (
        ("SB3 adapter of 64", 64, adapter),
        ("SB3 adapter of 1024", 1024, adapter),
        ("SB3 DummyVecEnv of 8", 8, dummies),
        (f"SB3 DummyVecEnv of {n_cpu}", n_cpu, dummies),
        (f"SB3 SubprocVecEnv of {n_cpu}", n_cpu, processes),
    ):
        if (make, n) != (dummies, 8) or n_cpu != 8:
            yield Case(
                "training",
                f"PPO on {name}",
                n,
                lambda make=make, n=n: _train(make(n)),  # type: ignore[misc]
                preparation_s=4.0,
                least_s=3.0,
            )


def describe_training() -> str:
    """Return the set-up in words."""
    return (
        f"PPO, MlpPolicy (two layers of 64), rollouts of {ROLLOUT} steps over all environments, batches of "
        f"{BATCH_SIZE}, {N_EPOCHS} epochs, torch on one thread of the CPU"
    )


def _train(envs: Any) -> Stepper:
    import torch
    from stable_baselines3 import PPO

    # With layers this small a second thread waits more than it computes, the more so where our own threads step.
    torch.set_num_threads(1)

    n_steps = max(2, ROLLOUT // envs.num_envs)
    with warnings.catch_warnings():
        # The rollout of an odd number of processes is no whole number of batches; the last batch is smaller then.
        warnings.filterwarnings("ignore", "You have specified a mini-batch size", UserWarning)
        model = PPO("MlpPolicy", envs, n_steps=n_steps, batch_size=BATCH_SIZE, n_epochs=N_EPOCHS, seed=0, device="cpu")

    def stepper(seconds: float) -> float:
        n, begin = 0, time.perf_counter()
        while (passed := time.perf_counter() - begin) < seconds or n == 0:
            model.learn(n_steps * envs.num_envs, reset_num_timesteps=False)
            n += n_steps * envs.num_envs
        return n / passed

    return stepper
