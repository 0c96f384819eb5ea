"""What an environment answers, as one hash: two machines with the same one play the same benchmark, bit for bit."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.scenarios import get_suite

_N_SCENARIOS, _N_STEPS = 4, 150


def environment_fingerprint(settings: EnvSettings) -> str:
    """Return a sha256 over everything that the environment answers to a fixed course of actions.

    The first validation scenarios are played for 15 s at control steps of 0.1 s, under the reference strategy with all
    actions and observations. The hash covers the names of the observations and, bit for bit, every observation,
    reward, term of the cost and end. Another source code that computes the same has the same fingerprint, the same
    source code on a processor that rounds otherwise has another.

    Args:
        settings: of the environment; strategy and modes are replaced.
    """
    probed = dataclasses.replace(
        settings, strategy=REFERENCE_STRATEGY, action_mode="k+tau", observation_mode="privileged"
    )
    seeds = get_suite(settings.suite).seeds("validation")[:_N_SCENARIOS]
    lanes = TaskLanes(probed, len(seeds), 1)
    try:
        lanes.start(range(len(seeds)), lanes.scenarios(seeds))
        found = hashlib.sha256("\n".join(lanes.observation_names).encode())
        found.update(lanes.observations.tobytes())
        for step in range(_N_STEPS):
            if np.logical_or(*lanes.ended()).all():
                break
            lanes.step(_actions(step, len(seeds), lanes.n_action))
            for values in lanes.outputs:
                found.update(values.tobytes())
        return found.hexdigest()
    finally:
        lanes.simulator.close()


def _actions(step: int, n_lanes: int, n_action: int) -> npt.NDArray[np.float64]:
    """Return actions in [-1, 1], (n_lanes, n_action), of whole numbers alone: no generator and no rounding."""
    count = (step * n_lanes + np.arange(n_lanes)[:, np.newaxis]) * n_action + np.arange(n_action)
    actions: npt.NDArray[np.float64] = (count * 7919 % 2049 - 1024) / 1024.0
    return actions


__all__ = ["environment_fingerprint"]
