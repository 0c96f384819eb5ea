"""What an accepted file's policy is asked: made-up observations, and a few scenarios of the validation split."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.entries import Entry
from wtg_gym.evaluation.evaluator import entry_lanes, play
from wtg_gym.evaluation.onnx_policy import Floats, States
from wtg_gym.scenarios import get_suite
from wtg_gym.submissions import limits
from wtg_gym.submissions.isolation import IsolatedPolicy

#: Largest magnitude of an observation.
_BOUND = 5.0
_PROBE_LANES, _PROBE_STEPS, _LONG_STEPS = 64, 3, 600
_ROLLOUT_SUITE, _ROLLOUT_LANES = "standard", 32


def _observations(n_lanes: int, width: int, seed: int) -> Floats:
    """Return made-up observations, (n_lanes, width): zero, the bounds, one entry at a bound, small ones and any."""
    rng = np.random.default_rng(seed)
    scale = rng.choice([0.01, 0.3, 1.0, _BOUND], size=(n_lanes, 1))
    values = np.clip(rng.normal(0.0, 1.0, (n_lanes, width)) * scale, -_BOUND, _BOUND)
    special = [np.zeros(width), np.full(width, _BOUND), np.full(width, -_BOUND)]
    special += [sign * _BOUND * row for row in np.eye(width) for sign in (1.0, -1.0)]
    n = min(len(special), n_lanes // 2)
    values[:n] = special[:n]
    found: Floats = values.astype(np.float32)
    return found


def _course(policy: IsolatedPolicy, steps: Sequence[Floats]) -> list[Floats]:
    """Return the actions and states of consecutive steps."""
    state: States | None = None
    found: list[Floats] = []
    for step in steps:
        action, state = policy.predict(step, state)
        found += [action, *(state or ())]
    return found


def _steps(policy: IsolatedPolicy) -> list[Floats]:
    return [_observations(_PROBE_LANES, policy.n_observation, seed) for seed in range(_PROBE_STEPS)]


def _finite(policy: IsolatedPolicy) -> str:
    many = 2 * (2 * policy.n_observation + 3)
    for lanes, n_steps in ((max(many, _PROBE_LANES), _PROBE_STEPS), (4, _LONG_STEPS)):
        course = _course(policy, [_observations(lanes, policy.n_observation, seed) for seed in range(n_steps)])
        wrong = sum(int((~np.isfinite(values)).sum()) for values in course)
        if wrong:
            raise ValueError(f"{wrong} actions or states are not finite, for observations within ±{_BOUND:g}")
    return f"on {max(many, _PROBE_LANES)} observations, and over {_LONG_STEPS} steps"


def _repeatable(policy: IsolatedPolicy) -> str:
    first, second = _course(policy, _steps(policy)), _course(policy, _steps(policy))
    if not all(np.array_equal(one, two) for one, two in zip(first, second, strict=True)):
        raise ValueError("the same observations give other actions the second time")
    return f"{_PROBE_STEPS} steps twice, the same to the last bit"


def _lanes_apart(policy: IsolatedPolicy) -> str:
    steps = _steps(policy)
    together = _course(policy, steps)
    order = np.random.default_rng(0).permutation(_PROBE_LANES)
    mixed = _course(policy, [step[order] for step in steps])
    alone = _course(policy, [step[-1:] for step in steps])
    # States may be of any magnitude; what they do shows in the actions.
    stride = len(together) // len(steps)
    differences = [
        max(float(np.abs(one[order] - two).max()), float(np.abs(one[-1:] - three).max()))
        for one, two, three in list(zip(together, mixed, alone, strict=True))[::stride]
    ]
    if not max(differences) <= limits.LANE_TOLERANCE:
        raise ValueError(
            f"a lane's action differs by {max(differences):.2g} with other lanes beside it, allowed are "
            f"{limits.LANE_TOLERANCE:g}"
        )
    return f"to {max(differences):.1g}"


def _speed(policy: IsolatedPolicy) -> str:
    step = _observations(limits.TIMED_LANES, policy.n_observation, 0)
    times = []
    for _ in range(5):
        began = time.perf_counter()
        policy.predict(step)
        times.append(time.perf_counter() - began)
    # The fastest: a busy machine slows down the others.
    if min(times) > limits.STEP_S:
        raise ValueError(f"more than {1e3 * limits.STEP_S:g} ms for a step of {limits.TIMED_LANES} lanes")
    return f"{1e3 * min(times):.1f} ms for a step of {limits.TIMED_LANES} lanes, allowed are {1e3 * limits.STEP_S:g}"


def rollout(policy: Any, action_mode: str, observation_mode: str) -> Floats:
    """Play scenarios of the validation split and return the actions, (steps, lanes, n_action), within ±1.

    A lane's actions are zero once its episode is over.

    Raises:
        ValueError: an action is not finite, or the policy cannot answer.
    """
    listener = _Listener(policy)
    entry = Entry(name="the policy", policy=listener, action_mode=action_mode, observation_mode=observation_mode)
    lanes = entry_lanes(entry, EnvSettings(suite=_ROLLOUT_SUITE, split="validation"), _ROLLOUT_LANES)
    try:
        seeds = get_suite(_ROLLOUT_SUITE).validation[:_ROLLOUT_LANES]
        lanes.start(range(_ROLLOUT_LANES), lanes.scenarios(seeds))
        for step, running in enumerate(play(entry, lanes)):
            listener.actions[step][~running] = 0.0
    finally:
        lanes.simulator.close()
    return np.clip(np.stack(listener.actions), -1.0, 1.0)


class _Listener:
    """Passes a policy's answers on and keeps the actions."""

    def __init__(self, policy: Any) -> None:
        self._policy = policy
        self.actions: list[Floats] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats, Any]:
        """Return what the policy returns."""
        action, state = self._policy.predict(observation, state, episode_start, deterministic)
        self.actions.append(action.copy())
        return action, state


#: The checks on made-up observations: name, and what says what was found or raises a ValueError.
PROBES: tuple[tuple[str, Callable[[IsolatedPolicy], str]], ...] = (
    # First, so that a slow policy does not hold up the others.
    ("speed", _speed),
    ("finite", _finite),
    ("repeatable", _repeatable),
    ("lanes apart", _lanes_apart),
)
__all__ = ["PROBES", "rollout"]
