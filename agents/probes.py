"""Policies that do one thing alone: to see that the cost has a term against it, or what that thing is worth.

wtg-gym sensitivity --entries baselines agents.probes:CHATTER agents.probes:PUSH
wtg-gym evaluate --split validation --entries agents.probes:STATIC baselines.tip_speed_feedback
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.task import COEFFICIENT_AUTHORITY, N_LOCAL
from wtg_gym.evaluation import Entry
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES

Floats = npt.NDArray[np.float64]
#: Observations (n_lanes, n_wtg, n) and number of steps so far to actions on k (n_lanes, n_wtg).
Rule = Callable[[Floats, int], Floats]

#: Columns of a group's observation (wtg_gym.envs.task).
_FREQUENCY, _ROCOF = 0, 1


class Probe:
    """A rule for k as a policy, the same in every group."""

    def __init__(self, rule: Rule) -> None:
        self._rule = rule

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_wtg), number of steps so far)."""
        step = 0 if state is None else state
        own = np.asarray(observation, dtype=np.float64).reshape(len(observation), -1, N_LOCAL + 1)
        return np.clip(self._rule(own, step), -1.0, 1.0), step + 1


def _chatter(own: Floats, step: int) -> Floats:
    return np.full(own.shape[:2], 0.3 * (-1.0) ** step)


def _push(own: Floats, step: int) -> Floats:
    action: Floats = -8.0 * own[..., _FREQUENCY] - 4.0 * own[..., _ROCOF]
    return action


def _static() -> Rule:
    """Return the rule that makes up for g(ω) being linear in k, while what is asked for is linear in power."""
    law, control = STRATEGIES[REFERENCE_STRATEGY], GridFormingParameters()
    corners = np.array([control.frequency_min_pu, control.frequency_setpoint_pu, control.frequency_max_pu])
    deloading = np.linspace(0.0, control.deloading_limit, 101)
    needed = np.array([tracking_point(share).coefficient for share in deloading.tolist()])
    speeds = np.interp(deloading, (0.0, control.deloading_nominal, control.deloading_limit), corners)
    offset = needed - np.interp(speeds, corners, (law.k_min, law.k_nominal, law.k_max))
    actions = offset / (COEFFICIENT_AUTHORITY * (law.k_min - law.k_max))
    deviations_hz = 50.0 * (speeds - 1.0)
    return lambda own, _step: np.interp(0.5 * own[..., _FREQUENCY], deviations_hz, actions)


def _entry(name: str, rule: Rule, description: str) -> Entry:
    return Entry(name=name, policy=Probe(rule), action_mode="k", learned=False, description=description)


CHATTER = _entry("chatter", _chatter, "Alternates k by ± 0.3 of its authority at every step.")
PUSH = _entry("push", _push, "Spends k on frequency and RoCoF alone, whatever the rotor does.")
STATIC = _entry("static", _static(), "Adds to g(ω) what makes the captured power linear in frequency, at rest.")

__all__ = ["CHATTER", "PUSH", "STATIC", "Probe"]
