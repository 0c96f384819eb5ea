"""What an environment can be asked for, checked once for the single and the batched one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any, TypedDict

import numpy as np

from wtg_gym.physics.checked import Checked, design
from wtg_gym.physics.grid import DEFAULT_GRID, Grid, file_of
from wtg_gym.physics.network import NetworkCase
from wtg_gym.physics.parameters import WtgGroup, default_groups
from wtg_gym.physics.plant import PHYSICS, SIMULATION_DT_RANGE, PlantSettings
from wtg_gym.physics.scenario import SERIES_DT, Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, TrackingLaw, group_laws
from wtg_gym.ranges import require_known, require_range, whole_steps
from wtg_gym.scenarios import DEFAULT_SUITE, SPLITS, SUITES, get_suite, suite_of_grid
from wtg_gym.scenarios.benchmark import Benchmark
from wtg_gym.scenarios.sensor_distribution import SensorDistribution

#: Action modes and which of (k, τ) each of them modulates.
ACTION_MODES: dict[str, tuple[bool, bool]] = {"k": (True, False), "tau": (False, True), "k+tau": (True, True)}
OBSERVATION_MODES = ("local", "privileged")
VERSIONS = ("v0", "v1")
#: Settings that are one of some names.
_CHOICES: dict[str, Sequence[str]] = {
    "action_mode": tuple(ACTION_MODES),
    "observation_mode": OBSERVATION_MODES,
    "machine_model": ("genrou", "classical"),
    "on_failure": ("terminate", "trip"),
    "physics": PHYSICS,
    "split": SPLITS,
}


def _weight(default: float, doc: str, low: float = 0.0) -> Any:
    return design(default, "1/s", doc, low, 1e6)


@dataclass(frozen=True, kw_only=True)
class CostWeights(Checked):
    """Weights of the cost's terms. Each is a rate [1/s] at the deviation that `doc` names as one unit.

    The reward is minus the cost. The terms' equations are in :mod:`wtg_gym.envs.cost`.
    """

    frequency: float = _weight(
        1.0,
        "one at ±0.2 Hz, where European primary reserve is fully active; quadratic inside, four times as steep "
        "as at that edge outside",
    )
    rocof: float = _weight(
        4.0, "one unit at 0.2 Hz/s over 500 ms, squared; loss-of-mains relays act from 0.5 … 1 Hz/s on"
    )
    duty: float = _weight(
        2.0,
        "one unit at a captured power 5 % of the available away from what the prescribed characteristic asks: the "
        "reserve that a unit is paid to hold. In v0 its weight is twice that of the frequency: a unit controls its "
        "reserve alone, but the frequency only together with all others",
    )
    rotor: float = _weight(
        5.0,
        "one unit at a tip-speed ratio 10 % of λ_opt beyond 0.9 λ_opt … 1.1 λ_pr, squared: low speed leads to "
        "stall, high speed loads the structure",
    )
    overload: float = _weight(
        10.0,
        "one unit at 0.1 p.u. of power above 1.1 p.u., squared. A converter at its current limit, which v0 does "
        "not model, no longer forms the grid: 1.2 p.u. costs about what 0.4 Hz of deviation do",
    )
    effort: float = _weight(
        0.05,
        "one unit at full action, four at a change by 1 within a step: a tie-breaker that keeps unused actions at "
        "zero and discourages chatter",
    )
    cap: float = _weight(
        50.0,
        "largest cost rate while the episode goes on; a failure costs this for the rest of the episode and one "
        "second more, so that going on is never dearer. In v1 it holds for all terms but frequency and load not served",
        low=1e-3,
    )
    unserved: float = _weight(
        300.0,
        "in v1 alone: one unit where the whole load is not served. The first stage of shedding, 5 %, costs what "
        "0.55 Hz of deviation do: it does not pay to have load shed",
    )
    failure: float = _weight(
        250.0,
        "in v1 alone: largest cost rate while the episode goes on, more than the limits of the frequency, all stages "
        "of shedding and all other terms at their cap cost; a failed episode costs this for its whole length and one "
        "second more",
    )


class EnvArguments(TypedDict, total=False):
    """Types of the environment's keyword arguments, for editors and type checkers; see :class:`EnvSettings`."""

    strategy: str | TrackingLaw | Sequence[str | TrackingLaw]
    action_mode: str
    observation_mode: str
    suite: str
    grid: str | PathLike[str] | Grid | NetworkCase | None
    split: str
    scenario: Scenario | Mapping[str, Any] | None
    groups: int | Sequence[Mapping[str, Any] | WtgGroup] | None
    duration_s: float | None
    control_dt: float
    simulation_dt: float
    weights: Mapping[str, float] | None
    machine_model: str
    on_failure: str
    physics: str | None
    sensors: str | Mapping[str, Any] | None
    version: str | None


@dataclass(frozen=True, kw_only=True)
class EnvSettings:
    """Arguments of the environment; all but objects of this package can be written as JSON.

    Args:
        strategy: control law that the actions adjust: a name, a TOML file, a `TrackingLaw`, or one for each group.
        action_mode: what the actions adjust: `"k"`, `"tau"` or `"k+tau"`.
        observation_mode: `"local"`, what each group measures itself, or `"privileged"`, which adds the grid's state.
        suite: name of the suite of scenarios, in v1 with or without `-v1`; None: the standard suite of the version.
        grid: name of a grid, or path of its file: its suite, instead of one by name. Or a `Grid`, or a `NetworkCase`
            as it is beside its `groups`.
        split: `"train"`, `"validation"` or `"test"`.
        scenario: one scenario for every episode, a `Scenario` or its `to_dict()`.
        groups: number of turbine groups at the bus of the first one, or a list of `{"bus": …, "n_turbines": …}`, with a
            `"turbine"` (TurbineParameters) if it is not the suite's; None: the suite's own groups.
        duration_s: length of an episode [s]; None: the suite's own, 180 s in v1, 120 s in both `paper`, else 60 s.
        control_dt: control interval, one step [s].
        simulation_dt: step of the integration [s]; None: the suite's own, 0.025 s in the IEEE 14-bus system. There
            0.05 s, which some draws of v1 refuse, move the frequency by 1e-4 Hz at most under laws, by 1e-2 Hz under
            random actions.
        weights: replaces single weights of the cost, see :class:`CostWeights`.
        machine_model: synchronous machines: `"genrou"`, with exciters, or `"classical"`.
        on_failure: consequence of a rotor's failure (stall, over-speed, under-speed): `"terminate"` the episode, or
            `"trip"` its group and go on; None: the version's own, in v0 the end.
        physics: `"paper"`: the paper's model, v0's; `"extended"`, v1's, adds rotor energy, limits of current, power,
            torque and reactive power, voltage control, a rotor under-speed trip, a governor dead band and load
            shedding; `"nrel-5mw"` has the NREL 5 MW turbine besides. None: the suite's own.
        sensors: of v1: `"exact"`, or values that replace those of the distribution of their errors
            (:class:`~wtg_gym.scenarios.sensor_distribution.SensorDistribution`), such as
            `{"delay_s": (0.2, 0.4), "wind_bias": 0.1}`. A delay is drawn between the two, in whole steps of 0.1 s up
            to 1 s, and must be a whole number of `control_dt`. None: the suite's own; with a `scenario` its own.
        version: of the benchmark, "v0" or "v1"; None: the suite's, without a suite v1. The environment's id sets it.

    Raises:
        ValueError: a value is unknown or out of range; the message lists what is allowed.
    """

    strategy: str | TrackingLaw | Sequence[str | TrackingLaw] = REFERENCE_STRATEGY
    action_mode: str = "k+tau"
    observation_mode: str = "local"
    suite: str = None  # type: ignore[assignment]  # replaced below
    grid: str | PathLike[str] | Grid | NetworkCase | None = None
    split: str = "train"
    scenario: Scenario | Mapping[str, Any] | None = None
    groups: int | Sequence[Mapping[str, Any] | WtgGroup] | None = None
    duration_s: float | None = None
    control_dt: float = 0.1
    simulation_dt: float = None  # type: ignore[assignment]  # replaced below
    weights: Mapping[str, float] | None = None
    machine_model: str = "genrou"
    on_failure: str = None  # type: ignore[assignment]  # replaced below
    physics: str | None = None
    sensors: str | Mapping[str, Any] | None = None
    version: str | None = None

    def __post_init__(self) -> None:
        self._choose_suite()
        for name, choices in _CHOICES.items():
            _require_choice(name, getattr(self, name), choices)
        self.sensor_distribution()
        if self.duration_s is not None:
            require_range("duration_s", self.duration_s, 1.0, 3600.0, "s")
        require_range("simulation_dt", self.simulation_dt, *SIMULATION_DT_RANGE, "s")
        if self.scenario is None and get_suite(self.suite).distributions:
            # Drawn events lie on this grid.
            whole_steps("the grid of drawn events", SERIES_DT, self.simulation_dt, "simulation_dt step")

    def _choose_suite(self) -> None:
        """Find the suite by version and name: of version v1, "standard" is "standard-v1"."""
        if self.version is not None:
            _require_choice("version", self.version, VERSIONS)
        suite = self.suite
        if self.grid is not None:
            if suite is not None:
                raise ValueError("a suite names its grid; give grid or suite, not both")
            suite = suite_of_grid(self._grid()) if self.grid != DEFAULT_GRID else None
            # The suite stands for it from here on.
            object.__setattr__(self, "grid", None)
        if suite is None:
            suite = DEFAULT_SUITE if self.version is None else "standard"
        if isinstance(suite, str) and self.version not in (None, "v0") and f"{suite}-{self.version}" in SUITES:
            suite = f"{suite}-{self.version}"
        if not str(suite).endswith(".json"):
            known = [name for name, own in SUITES.items() if self.version in (None, own.benchmark.version)]
            _require_choice("suite", suite, known)
        found = get_suite(suite)
        if self.version not in (None, found.benchmark.version):
            raise ValueError(f"suite {suite!r} is of version {found.benchmark.version}, not {self.version}")
        object.__setattr__(self, "suite", suite)
        object.__setattr__(self, "version", found.benchmark.version)
        if self.on_failure is None:
            object.__setattr__(self, "on_failure", found.benchmark.on_failure)
        if self.simulation_dt is None:
            object.__setattr__(self, "simulation_dt", found.plant.simulation_dt)
        if self.physics is None:
            object.__setattr__(self, "physics", found.plant.physics)

    def _grid(self) -> str:
        """Return the name or the path of the grid; one that is given as an object gets a file."""
        grid = self.grid
        if isinstance(grid, NetworkCase):
            if self.groups is None or isinstance(self.groups, (int, np.integer)):
                raise ValueError(f"a NetworkCase has no WTG groups: groups must be a list of them, got {self.groups!r}")
            grid = Grid(case=grid, groups=self.wtg_groups())
        if isinstance(grid, PathLike):
            return str(fspath(grid))
        return file_of(grid) if isinstance(grid, Grid) else grid  # type: ignore[return-value]

    @property
    def env_id(self) -> str:
        """Id of the environment."""
        return get_suite(self.suite).env_id

    def benchmark(self) -> Benchmark:
        """Return the version of the benchmark."""
        return get_suite(self.suite).benchmark

    def sensor_distribution(self) -> SensorDistribution | None:
        """Return what the sensors' errors are drawn from, None where they measure exactly; errors name the value."""
        own = get_suite(self.suite).sensors
        if self.sensors is None:
            return own
        if own is None and not self.benchmark().sensed:
            raise ValueError(f"sensors are part of version v1 and later; version {self.version} measures exactly")
        if self.scenario is not None:
            raise ValueError("sensors are those of the scenario where one is given; leave out one of the two")
        if self.sensors == "exact":
            return None
        if not isinstance(self.sensors, Mapping):
            raise ValueError(f'sensors must be "exact" or a dictionary of names and values, got {self.sensors!r}')
        return (own or SensorDistribution()).replaced(self.sensors)

    def cost_weights(self) -> CostWeights:
        """Return the weights in force; a ValueError names unknown ones."""
        if self.weights is not None and not isinstance(self.weights, Mapping):
            raise ValueError(f"weights must be a dictionary of names and numbers, got {self.weights!r}")
        given = dict(self.weights or {})
        require_known("weights", given, [field.name for field in dataclasses.fields(CostWeights)])
        return CostWeights(**{**dict(self.benchmark().weights), **given})

    def wtg_groups(self) -> tuple[WtgGroup, ...]:
        """Return the WTG groups; a ValueError says what is wrong with a description."""
        if self.groups is None:
            return get_suite(self.suite).plant.groups
        if isinstance(self.groups, (int, np.integer)):
            return default_groups(self.groups, get_suite(self.suite).plant.groups[0].bus)
        if isinstance(self.groups, (str, Mapping)) or not isinstance(self.groups, Sequence) or not self.groups:
            raise ValueError(
                f'groups must be a number of groups or a list of {{"bus": …, "n_turbines": …}}, got {self.groups!r}'
            )
        for entry in self.groups:
            if isinstance(entry, WtgGroup):
                continue
            if not isinstance(entry, Mapping) or not entry or not set(entry) <= {"bus", "n_turbines", "turbine"}:
                raise ValueError(f'a WTG group must be {{"bus": …, "n_turbines": …}}, got {entry!r}')
        return tuple(entry if isinstance(entry, WtgGroup) else WtgGroup(**entry) for entry in self.groups)

    def laws(self) -> tuple[TrackingLaw, ...]:
        """Return one law per WTG group; a ValueError lists the known strategies."""
        plant = self.plant()
        return group_laws(self.strategy, plant.turbines, plant.control)

    def plant(self) -> PlantSettings:
        """Return the plant and its time steps."""
        return get_suite(self.suite).plant.settings(
            groups=self.wtg_groups(),
            physics=self.physics,
            classical=self.machine_model == "classical",
            control_dt=self.control_dt,
            simulation_dt=self.simulation_dt,
            trips_groups=self.on_failure == "trip",
        )

    def fixed_scenario(self) -> Scenario | None:
        """Return the scenario played in every episode, if one was given."""
        return None if self.scenario is None else as_scenario("scenario", self.scenario)

    def episode_duration_s(self) -> float:
        """Return the length of an episode [s]."""
        if self.duration_s is not None:
            return float(self.duration_s)
        fixed = self.fixed_scenario()
        return float(fixed.duration_s if fixed is not None else get_suite(self.suite).duration_s)


@dataclass(frozen=True, kw_only=True)
class PlantEnvSettings(EnvSettings):
    """Settings of an environment on a plant of one's own, for studies; the benchmark has none.

    Args:
        given: the plant. Physics, groups, time steps and machine model are its own.
    """

    given: PlantSettings

    def plant(self) -> PlantSettings:
        """Return the plant and its time steps."""
        return self.given

    @classmethod
    def of(cls, settings: EnvSettings, given: PlantSettings) -> PlantEnvSettings:
        """Return settings with another plant."""
        fields = {field.name: getattr(settings, field.name) for field in dataclasses.fields(EnvSettings)}
        # Its suite is known by now.
        del fields["grid"]
        return cls(**fields | {"control_dt": given.control_dt, "simulation_dt": given.simulation_dt}, given=given)


def as_scenario(name: str, value: Any) -> Scenario:
    """Return a scenario that was given, as such or as a dictionary; anything else raises a ValueError."""
    if isinstance(value, Scenario):
        return value
    if isinstance(value, Mapping):
        return Scenario.from_dict(dict(value))
    raise ValueError(f"{name} must be a Scenario or its to_dict() form, got {value!r:.80}")


def _require_choice(name: str, value: Any, choices: Sequence[str]) -> None:
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"unknown {name} {value!r}; choose one of {', '.join(choices)}")
