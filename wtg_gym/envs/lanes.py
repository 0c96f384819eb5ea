"""Episodes in lanes: what the single and the batched environment, and the evaluator, share."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.bound import BoundStep, can_bind
from wtg_gym.envs.settings import ACTION_MODES, EnvSettings
from wtg_gym.envs.task import (
    COST_TERMS,
    N_INFO,
    Outputs,
    Task,
    build_task,
    first_invalid_action,
    n_extra_rows,
    observation_names,
    start_task,
    step_blocks,
)
from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.layout import LaneData, LaneRow, Lanes, Plant, Status
from wtg_gym.physics.plant import whole_steps
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import PreparedLanes, Simulator
from wtg_gym.scenarios import get_suite

Floats = npt.NDArray[np.float64]

#: Text of `info["termination_reason"]`: empty while an episode runs or when its time is over.
TERMINATION_REASONS = {
    Status.RUNNING: "",
    Status.STALL: "stall",
    Status.OVER_SPEED: "over-speed",
    Status.FREQUENCY_LIMIT: "frequency limit",
    Status.NUMERICAL_FAILURE: "numerical failure",
}
#: Keys of `info`, with their units, besides `termination_reason`.
INFO_UNITS = {
    "time_s": "s",
    "frequency_hz": "Hz",
    "rocof_hz_s": "Hz/s",
    "cost": "-",
    **{f"cost_{name}": "-" for name in COST_TERMS},
    "scenario_seed": "-",
}


#: Those of them that the kernels write, in the order of their columns.
_INFO_KEYS = tuple(key for key in INFO_UNITS if key != "scenario_seed")
#: Lanes whose episodes are drawn and prepared together: their series fit a processor's cache.
_LANES_AT_ONCE = 8
#: Time to prepare n > 0 episodes, in steps of a block (16 µs): these, and these n times.
_START_BLOCKS = 10, 8


def _copied(outputs: Outputs) -> Outputs:
    return Outputs._make(array.copy() for array in outputs)


def as_actions(given: Any, shape: tuple[int, ...]) -> Floats:
    """Return actions as floats of a shape; whatever is not that many real numbers is a ValueError."""
    if type(given) is np.ndarray and given.dtype == np.float32 and given.shape == shape:
        return given.astype(np.float64, order="C")
    allowed = f"the action must be real numbers in -1 … 1 of shape {shape}"
    try:
        array = np.asarray(given)
        if array.dtype.kind == "O" and all(isinstance(value, numbers.Real) for value in array.flat):
            array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{allowed}: {error}") from error
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{allowed}, got {array.dtype} values: {given!r:.60}")
    if array.shape != shape:
        raise ValueError(f"{allowed}, got shape {array.shape}")
    return np.ascontiguousarray(array, dtype=np.float64)


@compiled
def _start_tasks(
    blocks: Floats,
    starting: npt.NDArray[np.int64],
    plant: Plant,
    task: Task,
    end_steps: Floats,
    outputs: Outputs,
    lanes: Lanes,
) -> None:
    """Call :func:`start_task` for every lane of starting (n,), with the last step of each in end_steps (n,)."""
    for i in range(starting.shape[0]):
        start_task(blocks, starting[i], plant, task, end_steps[i], outputs, lanes)


class PreparedEpisodes(NamedTuple):
    """Episodes that are ready to start; length and seed of each, (n,)."""

    lanes: PreparedLanes
    n_intervals: npt.NDArray[np.int64]
    scenario_seeds: npt.NDArray[np.int64]


class TaskLanes:
    """Episodes side by side: scenarios, simulator, observations and costs.

    Args:
        settings: what the environment was asked for.
        n_lanes: number of episodes side by side.
        n_threads: threads to step with; None for one per processor.

    Raises:
        ValueError: a setting is unknown or out of range.
    """

    def __init__(self, settings: EnvSettings, n_lanes: int = 1, n_threads: int | None = None) -> None:
        self.settings = settings
        self.suite = get_suite(settings.suite)
        self.laws = settings.laws()
        plant = settings.plant()
        self.n_wtg = len(plant.groups)
        self.n_turbines = [group.n_turbines for group in plant.groups]
        self.duration_s = settings.episode_duration_s()
        self.simulator = Simulator(
            plant,
            n_lanes=n_lanes,
            duration_s=self.duration_s,
            n_extra=n_extra_rows(self.n_wtg, settings.control_dt),
            n_threads=n_threads,
        )
        self.task = build_task(settings, plant.case.frequency_hz, self.simulator.layout.extra)
        self.observation_names = observation_names(
            self.n_wtg, self.simulator.layout.n_sync, settings.action_mode, privileged=self.task.privileged
        )
        self.n_observation = len(self.observation_names)
        self.n_action = self.n_wtg * sum(ACTION_MODES[settings.action_mode])
        self.outputs = Outputs(
            observations=np.zeros((n_lanes, self.n_observation), dtype=np.float32),
            rewards=np.zeros(n_lanes),
            infos=np.zeros((n_lanes, N_INFO)),
            terminated=np.zeros(n_lanes, dtype=np.bool_),
            truncated=np.zeros(n_lanes, dtype=np.bool_),
        )
        self.scenario_seeds = np.full(n_lanes, -1, dtype=np.int64)
        self._bound: BoundStep | None = None
        self._no_reasons = np.full(n_lanes, "", dtype=object)
        self._no_reasons.setflags(write=False)
        self._seeds = self.suite.seeds(settings.split)
        self._fixed = settings.fixed_scenario()
        if self._fixed is not None:
            # What cannot be played is refused here rather than at the first reset.
            self.prepare([self._fixed])

    @property
    def observations(self) -> npt.NDArray[np.float32]:
        """Observation of every lane, (n_lanes, n_observation): the array that the next step writes into."""
        return self.outputs.observations

    @property
    def rewards(self) -> Floats:
        """Reward of every lane's last step, (n_lanes,): the array that the next step writes into."""
        return self.outputs.rewards

    @property
    def n_lanes(self) -> int:
        """Number of episodes side by side."""
        return self.simulator.n_lanes

    def draw(self, rngs: Sequence[np.random.Generator]) -> list[Scenario]:
        """Return the next episode's scenario of every generator."""
        if self._fixed is not None:
            return [self._fixed] * len(rngs)
        return self.scenarios([int(rng.integers(self._seeds.start, self._seeds.stop)) for rng in rngs])

    def scenarios(self, seeds: Sequence[int]) -> list[Scenario]:
        """Return the suite's scenarios of seeds, for this plant and episode length."""
        return self.suite.scenarios(seeds, n_wtg=self.n_wtg, n_turbines=self.n_turbines, duration_s=self.duration_s)

    def prepare(self, scenarios: Sequence[Scenario]) -> PreparedEpisodes:
        """Find the equilibria that episodes start from; no running lane is touched.

        Raises:
            ValueError: a scenario does not fit the plant or the episode length, or has no equilibrium.
        """
        lanes = self.simulator.prepare(scenarios, self.laws)
        intervals = [
            whole_steps(
                "scenario duration_s", min(s.duration_s, self.duration_s), self.settings.control_dt, "control step"
            )
            for s in scenarios
        ]
        seeds = [-1 if scenario.seed is None else scenario.seed for scenario in scenarios]
        return PreparedEpisodes(lanes, np.array(intervals, dtype=np.int64), np.array(seeds, dtype=np.int64))

    def commit(self, lanes: Sequence[int], prepared: Sequence[PreparedEpisodes]) -> None:
        """Start prepared episodes in lanes, one each."""
        simulator = self.simulator
        # More events than ever before, or a snapshot, bring new arrays.
        self._bound = None
        first = 0
        for episodes in prepared:
            index = np.array(lanes[first : first + episodes.n_intervals.size], dtype=np.int64)
            first += index.size
            simulator.commit(index, episodes.lanes)
            end_steps = (episodes.n_intervals * simulator.plant.n_substeps).astype(np.float64)
            _start_tasks(simulator.blocks, index, simulator.plant, self.task, end_steps, self.outputs, simulator.lanes)
            self.scenario_seeds[index] = episodes.scenario_seeds

    def start(self, lanes: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """Start an episode in each of the lanes: :meth:`prepare`, then :meth:`commit`."""
        self.commit(lanes, [self.prepare(scenarios)])

    def prepare_next(self, rngs: Sequence[np.random.Generator]) -> list[PreparedEpisodes]:
        """Draw and prepare the next episode of every generator, a few at a time."""
        return [
            self.prepare(self.draw(rngs[first : first + _LANES_AT_ONCE]))
            for first in range(0, len(rngs), _LANES_AT_ONCE)
        ]

    def stop(self, lanes: npt.NDArray[np.bool_]) -> None:
        """End the episodes of a mask's lanes, as if their time were over; shape (n_lanes,)."""
        for lane in np.flatnonzero(lanes):
            self.simulator.stop(int(lane))
            self.outputs.truncated[lane] = not self.outputs.terminated[lane]

    def step(self, actions: Floats, rngs: Sequence[np.random.Generator] = ()) -> list[PreparedEpisodes]:
        """Step every running lane; results are in `observations`, `rewards` and :meth:`ended`.

        Args:
            actions: (n_lanes, n_action), as :func:`as_actions` gives them; clipped to [-1, 1].
            rngs: generators whose next episodes are prepared meanwhile (:meth:`prepare_next`), and returned.

        Raises:
            ValueError: an action is not finite; nothing has been stepped then.
        """
        simulator = self.simulator
        if self._bound is None and self.n_lanes == 1 and can_bind():
            self._bound = BoundStep(
                simulator.blocks, simulator.plant, simulator.data, self.task, self.outputs, simulator.lanes
            )
        invalid = first_invalid_action(actions) if self._bound is None else self._bound(actions)
        if invalid >= 0:
            raise ValueError(f"action {actions[invalid].tolist()} of lane {invalid} is not finite; allowed: -1 … 1")
        if self._bound is not None:
            return self.prepare_next(rngs)
        episodes: list[PreparedEpisodes] = []
        simulator.for_blocks(
            lambda first, last: step_blocks(
                simulator.blocks,
                first,
                last,
                simulator.plant,
                simulator.data,
                self.task,
                actions,
                self.outputs,
                simulator.lanes,
            ),
            lambda: episodes.extend(self.prepare_next(rngs)),
            _START_BLOCKS[0] + _START_BLOCKS[1] * len(rngs) if rngs else 0,
        )
        return episodes

    def statuses(self) -> npt.NDArray[np.int64]:
        """Return why each lane ended (:class:`Status`), RUNNING (0) where it did not or its time was over."""
        return self.simulator.lane_values(LaneRow.STATUS).astype(np.int64)

    def ended(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Return (terminated, truncated) per lane: copies."""
        return self.outputs.terminated.copy(), self.outputs.truncated.copy()

    def task_values(self, row: int) -> Floats:
        """Return a :class:`TaskRow` of every lane (n_lanes,)."""
        return self.simulator.values(self.simulator.layout.extra + row)

    def info_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return every key of `info` as an array over lanes: copies, but for the reasons while no lane has failed."""
        arrays: dict[str, npt.NDArray[Any]] = dict(zip(_INFO_KEYS, self.outputs.infos.T.copy(), strict=True))
        arrays["scenario_seed"] = self.scenario_seeds.copy()
        arrays["termination_reason"] = self._no_reasons
        if self.outputs.terminated.any():
            reasons = [TERMINATION_REASONS[Status(status)] for status in self.statuses()]
            arrays["termination_reason"] = np.array(reasons, dtype=object)
        return arrays

    def info(self) -> dict[str, Any]:
        """Return `info` of the first lane as plain numbers and text."""
        info: dict[str, Any] = dict(zip(_INFO_KEYS, self.outputs.infos[0].tolist(), strict=True))
        info["scenario_seed"] = int(self.scenario_seeds[0])
        failed = self.outputs.terminated[0]
        info["termination_reason"] = TERMINATION_REASONS[Status(int(self.statuses()[0]))] if failed else ""
        return info

    def __getstate__(self) -> dict[str, Any]:
        # Addresses are those of this object's arrays.
        return {**self.__dict__, "_bound": None}

    def snapshot(self) -> tuple[tuple[Floats, LaneData], Outputs, npt.NDArray[np.int64]]:
        """Return a copy of everything that changes."""
        return self.simulator.snapshot(), _copied(self.outputs), self.scenario_seeds.copy()

    def restore(self, snapshot: tuple[tuple[Floats, LaneData], Outputs, npt.NDArray[np.int64]]) -> None:
        """Go back to a :meth:`snapshot`; a ValueError refuses that of another environment."""
        physics, outputs, seeds = snapshot
        if outputs.observations.shape != self.observations.shape:
            raise ValueError(
                f"the snapshot is of another environment: its observations have shape {outputs.observations.shape}, "
                f"here it is {self.observations.shape}"
            )
        self._bound = None
        self.simulator.restore(physics)
        self.outputs.observations[:], self.outputs.rewards[:] = outputs.observations, outputs.rewards
        self.outputs.infos[:] = outputs.infos
        self.outputs.terminated[:], self.outputs.truncated[:] = outputs.terminated, outputs.truncated
        self.scenario_seeds[:] = seeds
