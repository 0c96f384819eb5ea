"""Policies that do one thing alone: the cost has a term against it, or its worth is of interest.

wtg-gym results sensitivity --entries baselines agents.research.probes:CHATTER agents.research.probes:PUSH
wtg-gym evaluate --entries agents.research.probes:STATIC baselines.tip_speed_feedback
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from wtg_gym.envs.observation import FREQUENCY_UNIT_HZ, N_LOCAL, N_MEASURED, WtgObservation
from wtg_gym.evaluation import Entry, Policy
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.scenarios.benchmark import V0, V1

#: Observations (n_lanes, n_wtg, n) and number of steps so far to actions on k (n_lanes, n_wtg), or to those of every
#: group one after the other (n_lanes, n_action).
Rule = Callable[[Floats, int], Floats]

#: Columns of a group's observation.
_FREQUENCY, _ROCOF = (WtgObservation._fields.index(name) for name in ("frequency_deviation", "rocof"))


class Probe:
    """A rule as a policy, the same in every group.

    Args:
        rule: the rule.
        n_action: actions of a group.
        n_own: how many numbers a group sees besides its last actions, :data:`N_MEASURED` in version v1.
    """

    def __init__(self, rule: Rule, n_action: int = 1, n_own: int = N_LOCAL) -> None:
        self._rule = rule
        self._n_action = n_action
        self._n_own = n_own

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_action), number of steps so far)."""
        step = 0 if state is None else state
        own = np.asarray(observation, dtype=np.float64).reshape(len(observation), -1, self._n_own + self._n_action)
        return np.clip(self._rule(own, step), -1.0, 1.0), step + 1


class Delayed:
    """A policy that sees every observation one control step late, and the first one twice."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (the policy's actions (n_lanes, n_action), last observation and the policy's own state)."""
        last, own = (observation, None) if state is None else state
        action, own = self._policy.predict(last, state=own, episode_start=episode_start, deterministic=deterministic)
        return action, (observation, own)


def late_name(name: str) -> str:
    """Return the name of an entry's delayed twin."""
    return f"{name}, one step late"


def delayed(entry: Entry) -> Entry:
    """Return an entry with a policy, which sees every observation one control step late."""
    assert entry.policy is not None
    return dataclasses.replace(entry, name=late_name(entry.name), policy=Delayed(entry.policy), fingerprint=None)


def _chatter(own: Floats, step: int) -> Floats:
    return np.full(own.shape[:2], 0.3 * (-1.0) ** step)


def _push(own: Floats, step: int) -> Floats:
    action: Floats = -8.0 * own[..., _FREQUENCY] - 4.0 * own[..., _ROCOF]
    return action


def _static() -> Rule:
    """Return the rule that makes the captured power linear in frequency at rest, where g(ω) makes k linear."""
    law, control = STRATEGIES[REFERENCE_STRATEGY], GridFormingParameters()
    corners = np.array([control.frequency_min_pu, control.frequency_setpoint_pu, control.frequency_max_pu])
    deloading = np.linspace(0.0, control.deloading_limit, 101)
    needed = np.array([tracking_point(share).coefficient for share in deloading.tolist()])
    speeds = np.interp(deloading, (0.0, control.deloading_nominal, control.deloading_limit), corners)
    offset = needed - np.interp(speeds, corners, (law.k_min, law.k_nominal, law.k_max))
    actions = offset / (V0.k_authority * (law.k_min - law.k_max))
    deviations_hz = 50.0 * (speeds - 1.0)
    return lambda own, _step: np.interp(FREQUENCY_UNIT_HZ * own[..., _FREQUENCY], deviations_hz, actions)


def _entry(name: str, rule: Rule, description: str) -> Entry:
    return Entry(name=name, policy=Probe(rule), action_mode="k", learned=False, description=description)


#: Actions on k and τ that never change.
_CONSTANT = (0.1, 0.3)


def _constant(own: Floats, _step: int) -> Floats:
    return np.tile(_CONSTANT, (own.shape[0], own.shape[1]))


CONSTANT = Entry(
    name="constant",
    policy=Probe(_constant, n_action=2),
    learned=False,
    description=f"Keeps the actions at k {_CONSTANT[0]:+g} and τ {_CONSTANT[1]:+g}.",
)
CHATTER = _entry("chatter", _chatter, "Alternates k by ± 0.3 of its authority at every step.")
PUSH = _entry("push", _push, "Spends k on frequency and RoCoF alone, whatever the rotor does.")
CHATTER_V1, PUSH_V1 = (
    dataclasses.replace(entry, policy=Probe(rule, n_own=N_MEASURED), environment=V1.env_id)
    for entry, rule in ((CHATTER, _chatter), (PUSH, _push))
)
#: Steps of an episode of v1, and those at its end in which the stopwatch acts.
_N_STEPS, _LAST = 600, 100


def _stopwatch(own: Floats, step: int) -> Floats:
    return np.where(step >= _N_STEPS - _LAST, -own[..., _FREQUENCY], 0.0)


STOPWATCH_V1 = Entry(
    name="stopwatch",
    strategy="coordinated-tuned",
    policy=Probe(_stopwatch, n_own=N_MEASURED),
    action_mode="k",
    environment=V1.env_id,
    learned=False,
    description="Adds the droop of fast-droop in the last 10 s, after which nobody has to give back what was lent.",
)
STATIC = _entry("static", _static(), "Adds to g(ω) what makes the captured power linear in frequency, at rest.")
