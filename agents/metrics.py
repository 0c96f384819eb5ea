"""What finished training episodes were like, in the units of the grid."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.task import COST_TERMS

_COSTS = tuple(f"cost_{term}" for term in COST_TERMS)


class EpisodeMetrics:
    """Follows the episodes in all lanes, step by step.

    Args:
        n_lanes: number of lanes.
    """

    def __init__(self, n_lanes: int) -> None:
        self._nadir_hz = np.full(n_lanes, np.inf)
        self._rocof_hz_s = np.zeros(n_lanes)
        self._costs = np.zeros((n_lanes, len(_COSTS)))
        self._duty_error_s = np.zeros(n_lanes)

    def update(
        self, lanes: TaskLanes, dones: npt.NDArray[np.bool_], infos: list[dict[str, Any]]
    ) -> list[dict[str, float]]:
        """Take in one step of all lanes, and return the metrics of the episodes that it ended.

        Args:
            lanes: the episodes after the step; a lane that ended has its next episode already.
            dones: whose episode ended, (n_lanes,).
            infos: of the step, complete for those whose episode ended.
        """
        ended = [self._finish(int(lane), infos[int(lane)]) for lane in np.flatnonzero(dones)]
        now = lanes.info_arrays()
        np.minimum(self._nadir_hz, now["frequency_hz"], out=self._nadir_hz)
        np.maximum(self._rocof_hz_s, np.abs(now["rocof_hz_s"]), out=self._rocof_hz_s)
        self._costs += np.stack([now[key] for key in _COSTS], axis=1)
        self._duty_error_s = lanes.task_values("duty_error")
        return ended

    def _finish(self, lane: int, info: dict[str, Any]) -> dict[str, float]:
        """Return a lane's metrics, its last step included, and start it anew."""
        costs = self._costs[lane] + [info[key] for key in _COSTS]
        metrics = {
            "nadir_hz": min(self._nadir_hz[lane], info["frequency_hz"]),
            "largest_rocof_hz_s": max(self._rocof_hz_s[lane], abs(info["rocof_hz_s"])),
            # Up to the last step but one: the lane's own sum starts anew within the last one.
            "duty_error_percent": 100.0 * self._duty_error_s[lane] / info["time_s"],
            "failure": float(info["termination_reason"] != ""),
            "length_s": info["time_s"],
            **dict(zip(_COSTS, costs.tolist(), strict=True)),
        }
        self._nadir_hz[lane], self._rocof_hz_s[lane], self._costs[lane] = np.inf, 0.0, 0.0
        return {key: float(value) for key, value in metrics.items()}


__all__ = ["EpisodeMetrics"]
