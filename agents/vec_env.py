"""The vector environment that learners of Stable-Baselines3 train in."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from agents.gains import Gains, stagger
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.sb3 import SB3VecEnv

Observations = npt.NDArray[np.float32]

_COSTS = tuple(f"cost_{term}" for term in COST_TERMS)


class GainVecEnv(SB3VecEnv):
    """:class:`SB3VecEnv` with the rewards of :class:`agents.gains.Gains` and lanes that every reset spreads.

    Scenarios are drawn: spreading starts the lanes anew, so that reset options are lost. The first episode that a lane
    reports is what spreading has left of it, and `reset_infos` is empty until its next one. The info of a lane whose
    episode ends also holds `metrics`, see :class:`EpisodeMetrics`.
    """

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **arguments)
        self._gains = Gains(self.vector_env.lanes)
        self._metrics = EpisodeMetrics(num_envs)

    def reset(self) -> Observations:
        """Start and spread the lanes; returns the observations (num_envs, n_observation)."""
        super().reset()
        self._metrics = EpisodeMetrics(self.num_envs)
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        observations = stagger(self.vector_env)
        self._gains.follow(range(self.num_envs))
        return observations

    def step_wait(self) -> tuple[Observations, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Hold the actions for one control interval in every lane; returns observations, gains, dones and infos."""
        before = self._gains.reference_costs()
        observations, rewards, dones, infos = super().step_wait()
        gains = self._gains.of(before, rewards.astype(np.float64))
        self._gains.follow(np.flatnonzero(dones).tolist())
        self._metrics.update(self.vector_env.lanes, dones, infos)
        return observations, gains.astype(np.float32), dones, infos

    def close(self) -> None:
        """Release the worker threads."""
        self._gains.close()
        super().close()


class EpisodeMetrics:
    """Follows the episodes in all lanes, and puts `metrics` in the units of the grid into the info of their ends."""

    def __init__(self, n_lanes: int) -> None:
        self._nadir_hz = np.full(n_lanes, np.inf)
        self._rocof_hz_s = np.zeros(n_lanes)
        self._costs = np.zeros((n_lanes, len(_COSTS)))
        self._duty_error_s = np.zeros(n_lanes)

    def update(self, lanes: TaskLanes, dones: npt.NDArray[np.bool_], infos: list[dict[str, Any]]) -> None:
        """Take in one step of all lanes.

        Args:
            lanes: the episodes after the step; a lane that ended has its next episode already.
            dones: whose episode ended, (n_lanes,).
            infos: of the step, complete for those whose episode ended.
        """
        for lane in np.flatnonzero(dones):
            infos[lane]["metrics"] = self._finish(int(lane), infos[lane])
        now = lanes.info_arrays()
        np.minimum(self._nadir_hz, now["frequency_hz"], out=self._nadir_hz)
        np.maximum(self._rocof_hz_s, np.abs(now["rocof_hz_s"]), out=self._rocof_hz_s)
        self._costs += np.stack([now[key] for key in _COSTS], axis=1)
        self._duty_error_s = lanes.task_values("duty_error")

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
