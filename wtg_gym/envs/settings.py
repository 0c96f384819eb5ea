"""The arguments of an environment, checked once for the single and the vector environment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike, fspath
from typing import Any

from wtg_gym.physics.grid import DEFAULT_GRID, Grid, file_of
from wtg_gym.physics.parameters import WtgGroup
from wtg_gym.physics.plant import SIMULATION_DT_RANGE, Plant
from wtg_gym.physics.scenario import SERIES_DT, Scenario
from wtg_gym.physics.tracking_law import REFERENCE_LAW, TrackingLaw, group_laws
from wtg_gym.ranges import did_you_mean, require_choice, require_known, require_range, whole_steps
from wtg_gym.scenarios import DEFAULT_SUITE, SPLITS, SUITES, Suite, draws, get_suite, suite_of_grid
from wtg_gym.tasks import TASKS, Task, episode, observation
from wtg_gym.tasks.cost import CostWeights
from wtg_gym.tasks.task import Choices

VERSIONS = tuple(task.version for task in TASKS.values())
#: Settings that are one of some names, or their default.
_CHOICES: dict[str, Sequence[str]] = {
    "action_mode": tuple(episode.ACTION_MODES),
    "observation_mode": observation.OBSERVATION_MODES,
    "split": SPLITS,
    "version": VERSIONS,
    "on_failure": ("terminate", "trip"),
    "reward": ("score", "cost"),
}


@dataclass(frozen=True, kw_only=True)
class EnvSettings:
    """Arguments of the environment. All of them can be written as JSON, except objects of this package.

    A ValueError names a value that is unknown or out of range, and what is allowed.

    Args:
        strategy: control law that the actions adjust: a name, a TOML file, a `TrackingLaw`, or one for each group.
        action_mode: `"k"`, `"tau"` or `"k+tau"`: what the actions adjust.
        observation_mode: `"local"`, measurements of each group, or `"privileged"`, with the grid's state too.
        suite: a `Suite` or its name, in v1 with or without `-v1`. Default: the standard suite of the version.
        grid: a `Grid`, its name or the path of its file. Its suite is played, so give no `suite`.
        groups: a list such as `[{"bus": 2, "n_turbines": 52}]`, optionally with a `"turbine"` (TurbineParameters); in
            v0 also a number of groups, which share 20 turbines at the bus of the first one. Default: the suite's.
        plant: replaces parts of the suite's plant, such as `{"physics": "nrel-5mw"}` (see `Plant.replaced`), or the
            whole by another `Plant`.
        split: `"train"`, `"validation"` or `"test"`.
        scenario: one scenario for every episode, a `Scenario` or its `to_dict()`.
        duration_s: length of an episode [s]. Default: the suite's, 180 s in v1, 120 s in both `paper`, else 60 s.
        control_dt: time for which an action is held, one step [s]. In v1 a multiple of 0.1 s, the interval of sensors
            and costs, or shorter. Default: 0.1 s, in v1 0.5 s.
        reward: `"score"`, default of v1: an episode returns its score minus 100, in v0
            100 · ln((C_100 + J0) / (C + J0)). `"cost"`, default of v0: minus the cost.
        weights: replaces single weights of the cost, see :class:`CostWeights`.
        on_failure: effect of a stall, over- or under-speed of a rotor: `"terminate"` ends the episode, default of v0,
            `"trip"` disconnects its group, default of v1.
        sensors: v1 only. `"exact"`, or values of :class:`~wtg_gym.scenarios.draws.SensorDistribution` to
            replace, such as `{"delay_s": (0.2, 0.4), "wind_bias": 0.1}`; delays are multiples of 0.1 s up to 1 s.
            Default: those of the `scenario`, else of the suite. A scenario with sensors of its own is refused then.
        version: `"v0"` or `"v1"`. Default: that of `suite`, else v1. `gym.make` sets it from the id.
    """

    strategy: str | TrackingLaw | Sequence[str | TrackingLaw] = REFERENCE_LAW
    action_mode: str = "k+tau"
    observation_mode: str = "local"
    suite: str | Suite | None = None
    grid: str | PathLike[str] | Grid | None = None
    groups: int | Sequence[Mapping[str, Any] | WtgGroup] | None = None
    plant: Plant | Mapping[str, Any] | None = None
    split: str = "train"
    scenario: Scenario | Mapping[str, Any] | None = None
    duration_s: float | None = None
    control_dt: float | None = None
    reward: str | None = None
    weights: Mapping[str, float] | None = None
    on_failure: str | None = None
    sensors: str | Mapping[str, Any] | None = None
    version: str | None = None

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) is not getattr(EnvSettings, name):
                require_choice(name, getattr(self, name), choices)
        suite = self.resolved_suite
        # What they cannot be made of raises here.
        _ = self.sensor_distribution, self.n_intervals
        if self.duration_s is not None:
            require_range("duration_s", self.duration_s, 1.0, 3600.0, "s")
        if self.scenario is None and suite.distributions:
            # Drawn events lie on this grid.
            whole_steps("the grid of drawn events", SERIES_DT, self.resolved_plant.simulation_dt, "simulation_dt step")

    @cached_property
    def suite_name(self) -> str:
        """Name of the suite, or path of the file that stands for one; "standard" of version v1 is "standard-v1"."""
        if self.grid is not None:
            if self.suite is not None:
                raise ValueError("a suite has a grid of its own; give grid or suite, not both")
            if not isinstance(self.grid, str | PathLike | Grid):
                raise ValueError(f"grid must be a name, the path of a file or a Grid, got {self.grid!r:.80}")
            grid = file_of(self.grid) if isinstance(self.grid, Grid) else str(fspath(self.grid))
            if grid != DEFAULT_GRID:
                return suite_of_grid(grid)
        if isinstance(self.suite, Suite):
            return self.suite.name
        suite = self.suite
        if suite is None:
            suite = DEFAULT_SUITE if self.version is None else "standard"
        if isinstance(suite, str) and f"{suite}-{self.version}" in SUITES:
            return f"{suite}-{self.version}"
        if not str(suite).endswith(".json") and not (isinstance(suite, str) and suite in SUITES):
            require_choice("suite", suite, self._suites)
        return suite

    @property
    def _suites(self) -> list[str]:
        """Names of the suites of the version."""
        return [name for name, suite in SUITES.items() if self.version in (None, suite.task.version)]

    @cached_property
    def resolved_suite(self) -> Suite:
        """The suite."""
        name = self.suite_name
        suite = self.suite if isinstance(self.suite, Suite) else get_suite(name)
        if self.version not in (None, suite.task.version):
            known = f"choose one of {', '.join(self._suites)}"
            raise ValueError(f"suite {name!r} is of version {suite.task.version}, not {self.version}; {known}")
        return suite

    @cached_property
    def resolved_plant(self) -> Plant:
        """The plant: the suite's with what `plant` replaces, or `plant` itself."""
        failure = self.on_failure or self.task.on_failure
        arguments: dict[str, Any] = {"interval_s": self.interval_s, "trips_groups": failure == "trip"}
        if self.groups is not None:
            arguments["groups"] = self.groups
        if isinstance(self.plant, Plant):
            return self.plant.replaced(**arguments)
        if not isinstance(self.plant, Mapping | None):
            raise ValueError(f"plant must be a Plant or a dictionary of what to replace, got {self.plant!r:.80}")
        changes = {str(name): value for name, value in (self.plant or {}).items()}
        if twice := sorted(set(arguments) & set(changes)):
            raise ValueError(f"{twice[0]} is no part of plant here: give the argument control_dt, on_failure or groups")
        return self.resolved_suite.plant.replaced(**changes, **arguments)

    @cached_property
    def step_s(self) -> float:
        """Time for which an action is held [s]."""
        step_s = self.task.control_dt if self.control_dt is None else self.control_dt
        return require_range("control_dt", step_s, SIMULATION_DT_RANGE[0], 10.0, "s")

    @cached_property
    def interval_s(self) -> float:
        """Length of the intervals in which sensors measure and costs are charged [s]."""
        return min(self.step_s, self.task.interval_s or self.step_s)

    @cached_property
    def n_intervals(self) -> int:
        """Intervals in a control step."""
        return whole_steps("control_dt", self.step_s, self.interval_s, "measuring interval")

    @cached_property
    def draws_again(self) -> bool:
        """Whether its suite comes from a file: scenarios that cannot start are drawn again, and counted."""
        return self.suite_name.endswith(".json")

    @cached_property
    def scores(self) -> bool:
        """Whether rewards are points of the score."""
        return self.reward == "score" if self.reward else self.task.rewards_score

    @property
    def env_id(self) -> str:
        """Id of the environment."""
        return self.resolved_suite.env_id

    @cached_property
    def task(self) -> Task:
        """What is acted, charged and observed."""
        return self.resolved_suite.task

    @cached_property
    def choices(self) -> Choices:
        """What the environment chooses of the task."""
        privileged = self.observation_mode == "privileged"
        return Choices(self.resolved_plant, self.cost_weights(), self.action_mode, privileged)

    @cached_property
    def sensor_distribution(self) -> draws.SensorDistribution | None:
        """Distribution of the sensors' errors; None for exact sensors. Errors name the value."""
        of_suite = self.resolved_suite.sensors
        if self.sensors is None:
            return of_suite
        if of_suite is None and not self.task.has_sensors:
            raise ValueError(f"sensors are part of version v1; version {self.task.version} measures exactly")
        if self.scenario is not None:
            raise ValueError("sensors are those of the scenario where one is given; leave out one of the two")
        if self.sensors == "exact":
            return None
        if not isinstance(self.sensors, Mapping):
            near = did_you_mean(self.sensors, ["exact"])
            raise ValueError(f'sensors must be "exact" or a dictionary of names and values, got {self.sensors!r}{near}')
        require_known("values of the sensors", self.sensors, draws.SensorDistribution.__dataclass_fields__)
        return replace(of_suite or draws.SensorDistribution(), **self.sensors)

    def cost_weights(self) -> CostWeights:
        """Return the weights in force; a ValueError names unknown ones."""
        if self.weights is not None and not isinstance(self.weights, Mapping):
            raise ValueError(f"weights must be a dictionary of names and numbers, got {self.weights!r}")
        changes = dict(self.weights or {})
        require_known("weights", changes, CostWeights._fields)
        return self.task.weights._replace(**changes).checked()

    def laws(self) -> tuple[TrackingLaw, ...]:
        """Return one law per WTG group; a ValueError lists the known laws."""
        plant = self.resolved_plant
        return group_laws(self.strategy, plant.turbines, plant.control)

    def fixed_scenario(self) -> Scenario | None:
        """Return the scenario played in every episode, if one was given."""
        return None if self.scenario is None else as_scenario("scenario", self.scenario)

    def episode_duration_s(self) -> float:
        """Return the length of an episode [s]."""
        if self.duration_s is not None:
            return float(self.duration_s)
        fixed = self.fixed_scenario()
        return float(fixed.duration_s if fixed is not None else self.resolved_suite.duration_s)


def as_scenario(name: str, value: Any) -> Scenario:
    """Return a scenario that was given, as such or as a dictionary; anything else raises a ValueError."""
    if isinstance(value, Scenario):
        return value
    if isinstance(value, Mapping):
        return Scenario.from_dict(dict(value))
    raise ValueError(f"{name} must be a Scenario or its to_dict() form, got {value!r:.80}")
