"""A batch of environments: what the single and the vector environment, and the evaluator, share."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import compress
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import EnvSettings, as_scenario
from wtg_gym.envs.stepping import N_INFO, Outputs, bind, log_score, play_costs, step_blocks, task_data
from wtg_gym.physics.equilibrium import StartError
from wtg_gym.physics.layout import BatchData, Floats
from wtg_gym.physics.linearisation import STEP_MARGIN, StepError, largest_stable_steps
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import GroupTrip, Scenario
from wtg_gym.physics.sensors import SensorInput, delay_intervals, sensor_input
from wtg_gym.physics.simulator import PreparedBatch, Simulator
from wtg_gym.ranges import is_whole, whole_steps
from wtg_gym.signals import HeldSignals, undivided
from wtg_gym.systems.routines import WIDE
from wtg_gym.tasks import cost, episode, measured_observation, observation

#: Text of `info["termination_reason"]`: empty while an episode runs or when its time is over.
TERMINATION_REASONS = {
    Status.RUNNING: "",
    Status.STALL: "stall",
    Status.OVER_SPEED: "over-speed",
    Status.UNDER_SPEED: "under-speed",
    Status.FREQUENCY_LIMIT: "frequency limit",
    Status.NUMERICAL_FAILURE: "numerical failure",
    Status.LOSS_OF_SYNCHRONISM: "loss of synchronism",
    Status.VOLTAGE_COLLAPSE: "voltage collapse",
}
#: Episodes that are drawn and prepared together: their series fit a processor's cache.
EPISODES_AT_ONCE = 32
#: Scenarios drawn for an episode before a reset gives up.
_MOST_DRAWS = 200
#: An episode of v0 takes as long to prepare (100 µs) as this many blocks to step (10 µs each).
_BLOCKS_PER_EPISODE = 10


Started = TypeVar("Started")
#: Arrays with one row per environment: the outputs, then seeds, reserve margins and events, see :class:`EnvBatch`.
Rows = tuple[npt.NDArray[Any], ...]


class BatchSnapshot(NamedTuple):
    """All state of a batch, and the settings that it belongs to."""

    settings: dict[str, Any]
    physics: tuple[Floats, BatchData]
    rows: Rows


class PreparedEpisodes(NamedTuple):
    """Episodes that are ready to start."""

    runs: PreparedBatch
    rows: Rows  # what they begin with


class EnvBatch:
    """Episodes of an environment side by side: scenarios, simulator, observations and costs.

    `n_threads` step them, None for one per processor. A ValueError says that a setting is unknown or out of range.
    """

    def __init__(self, settings: EnvSettings, num_envs: int = 1, n_threads: int | None = None) -> None:
        self.settings = settings
        self.suite = settings.resolved_suite
        self.laws = settings.laws()
        plant = settings.resolved_plant
        self.n_wtg = len(plant.groups)
        self.duration_s = settings.episode_duration_s()
        self.observation_names = [number.name for number in settings.task.observed_numbers(settings.choices)]
        self.info_names = (*observation.INFO_KEYS, *(observation.LocalInfo._fields if plant.extended else ()))
        self.n_observation = len(self.observation_names)
        self.simulator = Simulator(
            plant,
            num_envs=num_envs,
            duration_s=self.duration_s,
            task=settings.task.units(settings.choices),
            n_threads=n_threads,
            intervals_at_once=settings.n_intervals,
        )
        self.num_envs = num_envs = self.simulator.num_envs
        self.nominal_hz = plant.case.frequency_hz
        points = 100.0 / (settings.task.scale or 1.0) if settings.scores else 0.0
        self.task_data = task_data(settings.task, settings.choices, self.simulator.layout, settings.n_intervals, points)
        #: Control steps of an episode.
        self.n_steps_of_episode = whole_steps("duration_s", self.duration_s, settings.step_s, "control step")
        #: Episodes under the law that scores 100, whose costs rewards are compared with, by how many play at once.
        self._references: dict[int, EnvBatch] = {}
        self._check_time_constants()
        self._check_draws()
        modes = list(compress(("k", "tau"), episode.ACTION_MODES[settings.action_mode]))
        self.action_names = [f"wtg{group}.{name}" for group in range(self.n_wtg) for name in modes]
        self.n_action = len(self.action_names)
        self.outputs = self._new_outputs(num_envs)
        # An environment without an episode waits for a reset, as one whose episode is over.
        self.outputs.truncated[:] = True
        #: Observations (num_envs, n_observation) and rewards (num_envs,): arrays that the next step writes into.
        self.observations, self.rewards = self.outputs.observations, self.outputs.rewards
        self.scenario_seeds = np.full(num_envs, -1, dtype=np.int64)
        #: Scenarios that were drawn for each environment and could not start.
        self.redrawn = np.zeros(num_envs, dtype=np.int64)
        #: Of each environment's episode, see :mod:`wtg_gym.scenarios.margin`; NaN where the suite has no margins.
        self.reserve_margins = np.full(num_envs, np.nan)
        #: Events of each environment's episode, in their order: tuples of them.
        self.events = _objects([()] * num_envs)
        #: Arguments of compiled steps that last, and the simulator's data among them: other data need others.
        self._bound: Any = None
        self._bound_data: BatchData | None = None
        self._no_reasons = np.full(num_envs, "", dtype=object)
        self._no_reasons.setflags(write=False)
        self._seeds = self.suite.seeds(settings.split)
        self._fixed = settings.fixed_scenario()
        if self._fixed is not None:
            # A scenario that cannot start is refused here rather than at the first reset.
            self.prepare([self._fixed], turning=True)

    @property
    def _rows(self) -> Rows:
        return (*self.outputs, self.scenario_seeds, self.reserve_margins, self.events)

    @property
    def n_substeps(self) -> int:
        """Simulation steps of a control step."""
        return self.settings.n_intervals * self.simulator.plant.network.facts.n_substeps

    @property
    def started(self) -> bool:
        """Whether every environment has been started."""
        return bool((self.task_values("end_step") > 0.0).all())

    @cached_property
    def _of_episodes(self) -> dict[str, Any]:
        """Settings that a running episode depends on; where its scenario was drawn from is none of them."""
        return {
            "num_envs": self.num_envs,
            "strategy": self.laws,
            "duration_s": self.duration_s,
            "weights": self.settings.cost_weights(),
            "plant": self.simulator.settings,
            "version": self.suite.task.version,
            "action_mode": self.settings.action_mode,
            "observation_mode": self.settings.observation_mode,
            "control_dt": self.settings.step_s,
            "reward": self.settings.scores,
        }

    def _check_time_constants(self) -> None:
        """Refuse a law whose damping the actions can make faster than the integration step follows."""
        ratio = episode.TIME_CONSTANT_RATIO**self.settings.task.tau_authority
        fastest = ratio * max((law.inverse_time_constant for law in self.laws), default=0.0)
        allowed = float(largest_stable_steps(-fastest)) / STEP_MARGIN
        step_s = self.simulator.settings.simulation_dt
        if episode.ACTION_MODES[self.settings.action_mode][1] and step_s > allowed:
            what = f"the damping time constant of {ratio / fastest:g} s, which actions make {1.0 / fastest:g} s"
            raise ValueError(f"simulation_dt = {step_s:g} s is too long for {what}; allowed: at most {allowed:.3g} s")

    def _check_draws(self) -> None:
        """Refuse settings under which drawn scenarios do not fit, here rather than at some reset."""
        if self.settings.scenario is not None:
            return
        sensors = self.settings.sensor_distribution
        for delay_s in [] if sensors is None else sensors.delays_s():
            delay_intervals(delay_s, self.settings.interval_s)
        for distribution in self.suite.distributions:
            distribution.check_turbines(self.suite.default_turbines(self.settings.resolved_plant))

    def draw_seed(self, rng: np.random.Generator) -> int:
        """Return the seed of the next episode's scenario; -1 where all episodes have the same."""
        return -1 if self._fixed is not None else int(rng.integers(self._seeds.start, self._seeds.stop))

    def draw(self, rngs: Sequence[np.random.Generator]) -> list[Scenario]:
        """Return the next episode's scenario of every generator."""
        return self.drawn_scenarios([self.draw_seed(rng) for rng in rngs])

    def drawn_scenarios(self, seeds: Sequence[int]) -> list[Scenario]:
        """Return the scenarios of seeds from :meth:`draw_seed`."""
        return self.scenarios(seeds) if self._fixed is None else [self._fixed] * len(seeds)

    def scenarios(self, seeds: Sequence[int]) -> list[Scenario]:
        """Return the suite's scenarios of seeds, for this plant and episode length."""
        return self.suite.scenarios(
            seeds,
            duration_s=self.duration_s,
            sensors=self.settings.sensor_distribution,
            plant=self.settings.resolved_plant,
        )

    def scenario_of(self, name: str, value: Any) -> Scenario:
        """Return what `name` of a reset names: a scenario, its `to_dict()`, or that of a seed of the suite."""
        if is_whole(value):
            return self.scenarios([value])[0]
        scenario = as_scenario(name, value)
        if scenario.sensors is not None and self.settings.sensors is not None:
            raise ValueError(f"{name} has sensors, and so has the environment: leave out its argument sensors")
        return scenario

    def prepare(self, scenarios: Sequence[Scenario], *, turning: bool = False) -> PreparedEpisodes:
        """Find the equilibria that episodes of scenarios start from; no running environment is touched.

        `turning`, for scenarios given by the user, refuses a rotor that would start below the under-speed trip. A
        ValueError says that a scenario does not fit the plant or the episode length, or has no such equilibrium.
        """
        try:
            prepared = self.simulator.prepare(scenarios, self.laws, turning=turning)
        except StartError as error:
            if not self.settings.draws_again:
                raise
            raise StartError(f"{error}; `wtg-gym grid check` says how many of its scenarios start") from error
        step_s, plant = self.settings.step_s, self.settings.resolved_plant
        ends_s = [min(scenario.duration_s, self.duration_s) for scenario in scenarios]
        n_steps = np.array([whole_steps("scenario duration_s", end_s, step_s, "control step") for end_s in ends_s])
        outputs = self._start_tasks(prepared, scenarios, n_steps)
        if self.settings.scores:
            self._play_reference(scenarios, outputs.reference)
            outputs.offsets[:] = [self.suite.cost_offset(scenario, plant) for scenario in scenarios]
        seeds = np.array([-1 if scenario.seed is None else scenario.seed for scenario in scenarios], dtype=np.int64)
        margins = np.array([self.suite.margin(scenario, plant) for scenario in scenarios])
        events = _objects([tuple(sorted(each.events, key=lambda event: event.time_s)) for each in scenarios])
        return PreparedEpisodes(prepared, (*outputs, seeds, margins, events))

    def _play_reference(self, scenarios: Sequence[Scenario], costs: Floats) -> None:
        """Write what the law that scores 100 has cost up to each control step, (n, n_steps + 1)."""
        # A block of several takes little longer than one episode alone.
        at_once = 1 if self.num_envs == len(scenarios) == 1 else min(max(self.num_envs, WIDE), EPISODES_AT_ONCE)
        if at_once not in self._references:
            changes: dict[str, Any] = {"observation_mode": "local", "reward": "cost", "duration_s": self.duration_s}
            settings = replace(self.settings, strategy=self.settings.task.hundred, **changes)
            self._references[at_once] = EnvBatch(settings, at_once, self.simulator.threads.n_threads)
        for first in range(0, len(scenarios), at_once):
            part = scenarios[first : first + at_once]
            self._references[at_once].start(range(len(part)), part)
            self._references[at_once].play_costs(costs[first : first + len(part)])

    def first_to_start(self, env: int, prepare_next: Callable[[], Started]) -> Started:
        """Return what the first of an environment's next episodes that can start gives; those before it are counted.

        A ValueError says that the environment's one scenario does not start, or none of many drawn ones.
        """
        refusal: Exception | None = None
        for _ in range(_MOST_DRAWS):
            try:
                return prepare_next()
            except (StartError, StepError) as error:
                if self._fixed is not None:
                    raise
                refusal = error
                self.redrawn[env] += 1
        raise StartError(f"none of {_MOST_DRAWS} drawn scenarios starts; of the last one: {refusal}") from refusal

    def _new_outputs(self, num_envs: int) -> Outputs:
        """Return outputs of zeros."""
        return Outputs(
            observations=np.zeros((num_envs, self.n_observation), dtype=np.float32),
            rewards=np.zeros(num_envs),
            infos=np.zeros((num_envs, N_INFO)),
            terminated=np.zeros(num_envs, dtype=np.bool_),
            truncated=np.zeros(num_envs, dtype=np.bool_),
            reference=np.zeros((num_envs, self.n_steps_of_episode + 1 if self.settings.scores else 0)),
            offsets=np.ones(num_envs),
            gained=np.zeros(num_envs),
        )

    def _start_tasks(
        self, prepared: PreparedBatch, scenarios: Sequence[Scenario], n_steps: npt.NDArray[np.int64]
    ) -> Outputs:
        """Write the task's rows of prepared runs; return what their episodes begin with."""
        simulator, layout, rows = self.simulator, self.simulator.layout, prepared.rows
        rows[:, layout.first_rows(episode.TASK, "end_step")[0]] = n_steps * self.n_substeps
        rows[:, layout.first_rows(episode.HISTORY, "frequency")] = 1.0
        group = layout.first_rows(episode.ACTING, "group")
        rows[:, group], rows[:, group + 1] = rows[:, layout.wtg("inv_tau")], rows[:, layout.wtg("speed")]
        numbers = [self._sensor_numbers(scenario) for scenario in scenarios]
        if self.suite.task.has_sensors:
            first = layout.first_rows(measured_observation.SENSORS, "sensor_input")[0]
            places = [
                *range(first, first + len(SensorInput._fields)),
                *layout.first_rows(measured_observation.SENSED, "wind_bias"),
                *layout.first_rows(cost.FILTERED_DUTY, "leaves_at"),
            ]
            rows[:, places] = numbers
        outputs = self._new_outputs(len(rows))
        blocks, scratches = rows[:, :, np.newaxis], simulator.new_scratches(1, 1)
        bound = bind(blocks, scratches, simulator.plant.network, prepared.data, self.task_data, outputs)
        step_blocks(bound, np.zeros((0, self.n_action)), 0, len(rows), 0, True)
        return outputs

    def _sensor_numbers(self, scenario: Scenario) -> list[float]:
        """Return the constants of a scenario's sensors, and of each group the bias of its wind and when it leaves."""
        sensors = scenario.sensors
        if not self.suite.task.has_sensors:
            if sensors is not None:
                version = self.suite.task.version
                raise ValueError(f"scenario {scenario.name!r} has sensors; version {version} measures exactly")
            return []
        sensor_constants = sensor_input(sensors, self.settings.interval_s, self.nominal_hz)
        biases = (0.0,) * self.n_wtg if sensors is None else sensors.wind_bias
        leaves_at = [math.inf] * self.n_wtg
        for event in scenario.events:
            if isinstance(event, GroupTrip):
                leaves_at[event.group] = float(round(event.time_s / self.simulator.settings.simulation_dt))
        return [*sensor_constants, *biases, *leaves_at]

    @undivided
    def start(
        self,
        indices: Sequence[int],
        episodes: Sequence[Scenario] | PreparedEpisodes,
        places: Sequence[int] | None = None,
    ) -> None:
        """Start one episode in each: some `places` of those that :meth:`prepare` returned, or scenarios."""
        if not isinstance(episodes, PreparedEpisodes):
            episodes = self.prepare(episodes)
        index = np.array(indices, dtype=np.int64)
        taken = np.arange(index.size) if places is None else np.array(places, dtype=np.int64)
        self.simulator.start(index, episodes.runs, places=taken)
        for array, first in zip(self._rows, episodes.rows, strict=True):
            array[index] = first[taken]
        outputs = self.outputs
        outputs.rewards[index], outputs.terminated[index], outputs.truncated[index] = 0.0, False, False

    def stop(self, chosen: npt.NDArray[np.bool_]) -> None:
        """End the episodes of a mask's environments, as if their time were over; shape (num_envs,)."""
        steps = self.n_steps()
        for env in np.flatnonzero(chosen):
            if self.settings.scores and not (self.outputs.terminated[env] or self.outputs.truncated[env]):
                # Later costs of the reference do not count; what counts makes up for the logarithm now.
                out = self.outputs
                out.reference[env, -1] = out.reference[env, steps[env]]
                gained = log_score(out.reference[env, -1], float(self.cost_sums()[env].sum()), out.offsets[env])
                out.rewards[env] += self.task_data.points * (gained - out.gained[env])
                out.gained[env] = gained
            self.simulator.stop(int(env))
            self.outputs.truncated[env] = not self.outputs.terminated[env]

    def step(self, actions: Floats, meanwhile: Callable[[], Any] | None = None, n_prepared: int = 0) -> None:
        """Step every running environment by actions (num_envs, n_action).

        Results are in `observations`, `rewards` and :meth:`ended`. `meanwhile` is called once, while other threads step
        where there are several, and prepares `n_prepared` episodes. A ValueError says that an action is not finite;
        nothing has been stepped then.
        """
        simulator, bound = self.simulator, self._bind()
        alone = simulator.threads.n_blocks == 1
        if alone:
            invalid = step_blocks(bound, actions, 0, 1, 0, False)
        else:
            # Before any environment has been stepped.
            invalid = -1 if np.isfinite(actions).all() else int(np.argwhere(~np.isfinite(actions))[0, 0])
        if invalid >= 0:
            where = f" of environment {invalid}" if self.num_envs > 1 else ""
            raise ValueError(f"action {actions[invalid].tolist()}{where} is not finite; allowed: -1 … 1")
        if not alone:
            simulator.threads.run(
                lambda first, last, worker: step_blocks(bound, actions, first, last, worker, False),
                meanwhile,
                _BLOCKS_PER_EPISODE * n_prepared,
            )
        elif meanwhile is not None:
            meanwhile()

    @undivided
    def play_costs(self, costs: Floats) -> None:
        """Play episodes that have just been started without actions; write their costs up to each control step.

        `costs` are (n, n_steps + 1), of the first n environments.
        """
        bound, actions = self._bind(), np.zeros((self.num_envs, self.n_action))
        self.simulator.threads.run(lambda first, last, worker: play_costs(bound, actions, costs, first, last, worker))

    def _bind(self) -> Any:
        """Return the arguments of compiled steps that last."""
        # Data are new after a snapshot, and with more events than before.
        if self._bound is None or self._bound_data is not self.simulator.data:
            simulator, of_task = self.simulator, (self.task_data, self.outputs)
            network = simulator.plant.network
            # numba would turn the exception of a signal handler into a SystemError.
            with HeldSignals():
                self._bound = bind(simulator.blocks, simulator.scratches, network, simulator.data, *of_task)
                self._bound_data = simulator.data
        return self._bound

    def statuses(self) -> npt.NDArray[np.int64]:
        """Return why each environment ended (:class:`Status`), RUNNING (0) where it did not or its time was over."""
        return self.simulator.env_values("status").astype(np.int64)

    def ended(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Return (terminated, truncated) per environment: copies. One that was never started is truncated."""
        return self.outputs.terminated.copy(), self.outputs.truncated.copy()

    def n_steps(self) -> npt.NDArray[np.int64]:
        """Return the control steps of each episode so far, (num_envs,); one that it ended within counts whole."""
        steps = self.simulator.env_values("step") / self.n_substeps
        return np.ceil(steps).astype(np.int64)

    def task_values(self, name: str) -> Floats:
        """Return a number of the task or the cost of every environment by its name, (num_envs,)."""
        kind = episode.TASK if name in episode.TASK.rows else cost.COST
        return self.simulator.values(self.simulator.layout.first_rows(kind, name)[0])

    def cost_sums(self) -> Floats:
        """Return each environment's costs of the episode so far, (num_envs, n_terms), in the order of `COST_TERMS`."""
        first = self.simulator.layout.first_rows(cost.COST, "sums")[0]
        return np.stack([self.simulator.values(first + i) for i in range(len(cost.CostTerms._fields))], axis=1)

    def info_arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return the keys of `info` as arrays over environments: copies, except the reasons while none has failed."""
        arrays: dict[str, npt.NDArray[Any]] = dict(zip(self.info_names, self.outputs.infos.T.copy(), strict=False))
        arrays["scenario_seed"] = self.scenario_seeds.copy()
        if self.suite.margins:
            arrays["reserve_margin"] = self.reserve_margins.copy()
        if self.settings.draws_again:
            arrays["redrawn"] = self.redrawn.copy()
        arrays["termination_reason"] = self._no_reasons
        if self.outputs.terminated.any():
            reasons = [TERMINATION_REASONS[Status(status)] for status in self.statuses()]
            arrays["termination_reason"] = np.array(reasons, dtype=object)
        return arrays

    def info(self) -> dict[str, Any]:
        """Return `info` of the first environment as numpy's floats, a whole number and text."""
        # numpy.float64 is a subclass of float, and has the dtype that TorchRL asks for.
        # strict=True would take a tenth of the shortest step.
        info: dict[str, Any] = dict(zip(self.info_names, self.outputs.infos[0], strict=False))
        info["scenario_seed"] = int(self.scenario_seeds[0])
        if self.suite.margins:
            info["reserve_margin"] = self.reserve_margins[0]
        if self.settings.draws_again:
            info["redrawn"] = int(self.redrawn[0])
        failed = self.outputs.terminated[0]
        info["termination_reason"] = TERMINATION_REASONS[Status(int(self.statuses()[0]))] if failed else ""
        return info

    def close(self) -> None:
        """Stop the threads."""
        for batch in (self, *self._references.values()):
            batch.simulator.close()

    def __getstate__(self) -> dict[str, Any]:
        # Addresses are those of this object's arrays.
        return {**self.__dict__, "_bound": None, "_bound_data": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.simulator.link(self.settings.task.units(self.settings.choices))

    def snapshot(self) -> BatchSnapshot:
        """Return a copy of everything that changes."""
        return BatchSnapshot(self._of_episodes, self.simulator.snapshot(), tuple(array.copy() for array in self._rows))

    def restore(self, snapshot: BatchSnapshot) -> None:
        """Go back to a :meth:`snapshot`; a ValueError refuses that of an environment with other settings."""
        settings, physics, rows = snapshot
        if different := [name for name, value in self._of_episodes.items() if settings[name] != value]:
            raise ValueError(f"the snapshot is of an environment with other settings: {', '.join(different)}")
        self.simulator.restore(physics)
        for array, stored in zip(self._rows, rows, strict=True):
            array[:] = stored


def _objects(values: Sequence[Any]) -> npt.NDArray[np.object_]:
    return np.fromiter(values, dtype=object, count=len(values))
