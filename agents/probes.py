"""Policies that each overdo one thing, to see that the cost has a term against it: for `wtg-gym sensitivity`."""

from __future__ import annotations

from typing import Any

import numpy as np

from wtg_gym.envs.task import N_LOCAL
from wtg_gym.evaluation import Entry

#: Columns of a group's observation (wtg_gym.envs.task).
_FREQUENCY, _ROCOF = 0, 1


class _Probe:
    """What the probes share: an action on k for every group, none on τ.

    Args:
        name: of the probe's rule.
    """

    def __init__(self, name: str) -> None:
        self._rule = getattr(self, f"_{name}")

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_action), number of steps so far)."""
        step = 0 if state is None else state
        own = np.asarray(observation, dtype=np.float64).reshape(len(observation), -1, N_LOCAL + 2)
        actions = np.zeros((*own.shape[:2], 2))
        actions[..., 0] = np.clip(self._rule(own, step), -1.0, 1.0)
        return actions.reshape(len(own), -1), step + 1

    @staticmethod
    def _chatter(own: Any, step: int) -> Any:
        return 0.3 * (-1.0) ** step

    @staticmethod
    def _push(own: Any, step: int) -> Any:
        return -8.0 * own[..., _FREQUENCY] - 4.0 * own[..., _ROCOF]


CHATTER = Entry(
    name="chatter", policy=_Probe("chatter"), description="Alternates k by ± 0.3 of its authority at every step."
)
PUSH = Entry(
    name="push", policy=_Probe("push"), description="Spends k on frequency and RoCoF alone, whatever the rotor does."
)

__all__ = ["CHATTER", "PUSH"]
