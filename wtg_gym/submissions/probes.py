"""What a submission's policy is asked: how fast it answers, and a few scenarios of the validation split, twice."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.entries import Entry
from wtg_gym.evaluation.evaluator import entry_lanes, play
from wtg_gym.evaluation.onnx_policy import Floats, OnnxPolicy
from wtg_gym.scenarios import get_suite
from wtg_gym.submissions import limits

#: As many scenarios as a process ever plays: what keeps to the limits here does so wherever it is played later.
_TIMED_LANES, _TIMES = 256, 5
_ROLLOUT_SUITE, _ROLLOUT_LANES = "standard", 32


def check_speed(policy: OnnxPolicy) -> str:
    """Return how long a policy takes for a scenario's step; a ValueError says that it is too long."""
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (_TIMED_LANES, policy.widths[0]))
    # Opens the sessions, which is not what is timed.
    _, state = policy.predict(observations)
    times = []
    for _ in range(_TIMES):
        began = time.perf_counter()
        policy.predict(observations, state, np.zeros(_TIMED_LANES, dtype=np.bool_))
        times.append(time.perf_counter() - began)
    # The fastest: a busy machine slows down the others.
    taken_ms, allowed_ms = 1e3 * min(times) / _TIMED_LANES, 1e3 * limits.ANSWER_S
    if taken_ms > allowed_ms:
        raise ValueError(f"more than {allowed_ms:g} ms for an action, in the fastest of {_TIMES} steps")
    return f"{taken_ms:.3f} ms for an action, allowed are {allowed_ms:g}"


def rollout(policy: OnnxPolicy, action_mode: str, observation_mode: str, *, backwards: bool = False) -> Floats:
    """Play scenarios of the validation split in a new process; return the actions, (steps, lanes, n_action), within ±1.

    A lane's actions are zero once its episode is over.

    Args:
        policy: the policy.
        action_mode, observation_mode: what it acts on and sees.
        backwards: play the last scenario first; the actions come in the usual order all the same.

    Raises:
        ValueError: an action is not finite, or the policy cannot answer.
    """
    listener = _Listener(policy)
    entry = Entry(name="the policy", policy=listener, action_mode=action_mode, observation_mode=observation_mode)
    lanes = entry_lanes(entry, EnvSettings(suite=_ROLLOUT_SUITE, split="validation"), _ROLLOUT_LANES)
    order = -1 if backwards else 1
    try:
        seeds = get_suite(_ROLLOUT_SUITE).validation[:_ROLLOUT_LANES][::order]
        lanes.start(range(_ROLLOUT_LANES), lanes.scenarios(seeds))
        with policy:
            for step, running in enumerate(play(entry, lanes)):
                listener.actions[step][~running] = 0.0
    finally:
        lanes.simulator.close()
    return np.clip(np.stack(listener.actions), -1.0, 1.0)[:, ::order]


class _Listener:
    """Passes a policy's answers on and keeps the actions."""

    def __init__(self, policy: OnnxPolicy) -> None:
        self._policy = policy
        self.actions: list[Floats] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats, Any]:
        """Return what the policy returns."""
        action, state = self._policy.predict(observation, state, episode_start, deterministic)
        self.actions.append(action.copy())
        return action, state


__all__ = ["check_speed", "rollout"]
