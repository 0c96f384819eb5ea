"""A task: actions, costs and observations of an environment, and the scale of its score."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from wtg_gym.physics import grid, integration, tracking_law
from wtg_gym.physics.layout import Layout
from wtg_gym.physics.plant import Plant, TaskUnits
from wtg_gym.physics.sensors import DELAY_MAX_S
from wtg_gym.systems import routines, systems
from wtg_gym.systems.programs import Program, numbered
from wtg_gym.tasks import cost, episode
from wtg_gym.tasks.measured_observation import KEPT, KEPT_SHIFTS, NEWEST, SENSED, SENSORS
from wtg_gym.tasks.observation import INFO, OBSERVED, OBSERVED_DUTY, OBSERVED_GRID, OBSERVED_MACHINES

#: Share of the load that the torque of the machines is counted in on other grids than the IEEE 14-bus system, where it
#: is 100 MVA.
_TORQUE_SHARE = 0.39
#: A part of an observation: its kind of unit, its name there, and the letters before the number of its unit.
Shown = tuple[systems.Kind, str, str]


class Choices(NamedTuple):
    """Settings of an environment that change its task."""

    plant: Plant
    weights: cost.CostWeights
    action_mode: str
    privileged: bool


class ObservedNumber(NamedTuple):
    """A number of an observation, of a record of one unit."""

    name: str  # with the unit of measurement that it is counted in
    kind: systems.Kind
    part: str  # the record
    unit: int
    place: int  # in the record

    def row(self, layout: Layout) -> int:
        """Return its row in scratch."""
        return int(layout.first_rows(self.kind, self.part)[self.unit]) + self.place


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Task:
    """A version of the benchmark: its equations as lists, its weights, and what scores 0 and 100."""

    version: str  # "v0", "v1"
    k_authority: float  # offset on k at full action, as a share of K_opt - K_pr [-]
    tau_authority: float = 1.0  # full action multiplies or divides τ by `TIME_CONSTANT_RATIO` to this power [-]
    control_dt: float = 0.1  # default time for which an action is held [s]
    interval_s: float | None = None  # in which sensors measure and costs are charged; None: the control step [s]
    #: The lists of a step, in their order around the physics.
    act: tuple[Any, ...]
    charge: tuple[Any, ...]
    start_sensors: tuple[Any, ...] = ()
    measure: tuple[Any, ...] = ()
    observe: tuple[Any, ...]
    of_groups: Shown  # what every WTG group shows, before its last actions
    privileged: tuple[Shown, ...] = ()  # what it shows besides in the privileged observation
    rewards_score: bool = False  # whether rewards are points of the score by default, else minus the cost
    weights: cost.CostWeights = cost.CostWeights()
    duty_time_s: float = 0.0  # time constant of the filter behind which the duty is charged; 0 for none [s]
    on_failure: str = "terminate"  # default consequence of a rotor's failure, or "trip"
    #: Whether a failed episode costs the largest rate for its whole length, and entries get the mark of reliability;
    #: else it costs the cap for the time that was left.
    failure_costs_whole_episode: bool = False
    #: J0 of the score in each stratum ("" without strata), in units of the cost.
    cost_offsets: Mapping[str, float] = field(default_factory=lambda: {"": 5.0})
    anchors: tuple[str, str]  # names of the entries that score 0 and 100
    scale: float | None = None  # Λ, mean improvement of the entry at 100 on that at 0; None: of the scenarios played
    variates: tuple[str, ...] = ()  # laws that scores are adjusted by, see :mod:`wtg_gym.evaluation.adjusted`

    def __post_init__(self) -> None:
        _FIRST.setdefault(self.version, self)

    def __repr__(self) -> str:
        return f"<task {self.version}>"

    def __reduce__(self) -> Any:
        # A copy of a version is that version, in another process too.
        return (_of_version, (self.version,)) if _FIRST[self.version] is self else object.__reduce_ex__(self, 2)

    @property
    def env_id(self) -> str:
        """Id of the environment."""
        return f"GFMWTG-14bus-{self.version}"

    @property
    def zero(self) -> str:
        """Name of the entry that scores 0."""
        return self.anchors[0]

    @property
    def hundred(self) -> str:
        """Name of the entry that scores 100, with which all others are compared."""
        return self.anchors[1]

    @property
    def references(self) -> tuple[str, ...]:
        """Names of the entries that every evaluation plays: the anchors and the control variates."""
        return tuple(dict.fromkeys((*self.anchors, *self.variates)))

    @cached_property
    def has_sensors(self) -> bool:
        """Whether policies see what sensors measure, not what there is."""
        return bool(self.measure)

    @property
    def n_local(self) -> int:
        """Numbers that each group has of its own in an observation, before its last actions; groups come first."""
        kind, part, _ = self.of_groups
        return systems.count(kind.scratch[part])

    def to_dict(self) -> dict[str, Any]:
        """Return what hashes of suites hold of the task, as JSON-ready data."""
        defaults = cost.CostWeights()._asdict()
        return {
            "version": self.version,
            "k_authority": self.k_authority,
            "tau_authority": self.tau_authority,
            "control_dt": self.control_dt,
            "interval_s": self.interval_s,
            "duty_time_s": self.duty_time_s,
            "on_failure": self.on_failure,
            "anchors": self.anchors,
            "sensed": self.has_sensors,
            "charges_worst": self.failure_costs_whole_episode,
            "cost_offsets": dict(self.cost_offsets),
            "weights": {name: value for name, value in self.weights._asdict().items() if value != defaults[name]},
        }

    @cached_property
    def programs(self) -> tuple[Program, ...]:
        """The lists as programs, behind those of the physics."""
        return numbered(
            *integration.PROGRAMS,
            ACT=self.act,
            CHARGE=self.charge,
            START_SENSORS=self.start_sensors,
            MEASURE=self.measure,
            OBSERVE=self.observe,
            END=(episode.end_episode,),
        )

    @lru_cache(maxsize=64)  # noqa: B019 (a task lasts)
    def units(self, choices: Choices) -> TaskUnits:
        """Return the task's kinds of unit and programs, as a simulator takes them."""
        plant, sensors = choices.plant, int(self.has_sensors)
        n_wtg, n_sync, n_window = len(plant.groups), len(plant.case.machines), episode.rocof_window(plant.interval_s)
        # As many as the longest delay needs.
        n_kept = math.ceil(DELAY_MAX_S / plant.interval_s - 1e-9) + 1
        kept = np.arange(n_wtg * sensors * n_kept)
        older, newer = (kept.reshape(-1, n_kept)[:, columns].ravel() for columns in (slice(-1), slice(1, None)))
        modulated = dict(zip(("modulates k", "modulates tau"), episode.ACTION_MODES[choices.action_mode], strict=True))
        exactly = {"privileged": choices.privileged, "observes exactly": choices.privileged or not self.has_sensors}
        act, charge, start_sensors, measure, observe, end = _routines_of(self.programs)
        return TaskUnits(
            n_units={
                episode.TASK: 1,
                episode.HISTORY: n_window + 1,
                episode.SHIFTS: n_window,
                episode.WINDOW: 1,
                episode.ACTING: n_wtg,
                cost.COST: 1,
                cost.GROUP_COST: n_wtg,
                cost.MACHINE_COST: n_sync,
                cost.FILTERED_DUTY: n_wtg * sensors,
                OBSERVED: n_wtg,
                OBSERVED_DUTY: n_wtg * sensors,
                OBSERVED_GRID: 1,
                OBSERVED_MACHINES: n_sync,
                INFO: 1,
                SENSORS: sensors,
                SENSED: n_wtg * sensors,
                KEPT: kept.size,
                KEPT_SHIFTS: newer.size,
                NEWEST: n_wtg * sensors,
            },
            links={
                (episode.SHIFTS, "this_"): np.arange(n_window),
                (episode.SHIFTS, "next_"): 1 + np.arange(n_window),
                (episode.WINDOW, "oldest_"): np.array([0]),
                (episode.WINDOW, "newest_"): np.array([n_window]),
                (KEPT, "sensed"): kept // n_kept,
                (KEPT_SHIFTS, "sensed"): newer // n_kept,
                (KEPT_SHIFTS, "this_"): older,
                (KEPT_SHIFTS, "next_"): newer,
                (NEWEST, "kept"): kept[n_kept - 1 :: n_kept],
            },
            programs=self.programs,
            stepping=(act, charge, measure, observe, end),
            starting=(start_sensors, observe),
            constants={
                (episode.TASK, "task"): [self._constants(choices)],
                (cost.COST, "weights"): [choices.weights],
                (episode.ACTING, "reach"): [
                    episode.Reach(self.k_authority * (law.k_min - law.k_max), law.k_max, law.k_min - law.k_max)
                    for law in tracking_law.group_laws(tracking_law.REFERENCE_LAW, plant.turbines, plant.control)
                ],
                (OBSERVED_GRID, "inv_torque"): [_inv_torque(plant)],
                (SENSED, "group_number"): range(n_wtg),
                (KEPT_SHIFTS, "age"): n_kept - 1 - (older % n_kept),
            },
            has=[name for name, holds in {**modulated, **exactly}.items() if holds],
        )

    def _constants(self, choices: Choices) -> episode.TaskConstants:
        plant = choices.plant
        modulates_k, modulates_tau = episode.ACTION_MODES[choices.action_mode]
        n_wtg, interval_s = len(plant.groups), plant.interval_s
        return episode.TaskConstants(
            modulates_k=modulates_k,
            modulates_tau=modulates_tau,
            share_min=1.0,
            share_nominal=1.0 - plant.control.deloading_nominal,
            share_max=1.0 - plant.control.deloading_limit,
            interval_s=interval_s,
            nominal_hz=plant.case.frequency_hz,
            inv_load=plant.case.base_mva / max(plant.case.load_mw, 1e-6),
            n_window=episode.rocof_window(interval_s),
            n_groups=n_wtg,
            n_actions=n_wtg * (modulates_k + modulates_tau),
            n_substeps=round(interval_s / plant.simulation_dt),
            duty_gain=-math.expm1(-interval_s / self.duty_time_s) if self.duty_time_s > 0.0 else 1.0,
            tau_authority=self.tau_authority,
        )

    def observed_numbers(self, choices: Choices) -> list[ObservedNumber]:
        """Return the numbers of an observation: groups, then what is privileged, then devices.

        Groups count from 0 here, from 1 on the command line and in pictures. With sensors they show measurements; the
        privileged part then begins with the exact values, "exact0" and so on, and the duty error that is charged.
        """
        numbers: list[ObservedNumber] = []
        for j in range(len(choices.plant.groups)):
            numbers += _numbers_of(self.of_groups, j)
            actions = _numbers_of((OBSERVED, "shown_actions", self.of_groups[2]), j)
            numbers += itertools.compress(actions, episode.ACTION_MODES[choices.action_mode])
        if choices.privileged:
            for j in range(len(choices.plant.groups)):
                numbers += (number for shown in self.privileged for number in _numbers_of(shown, j))
            for i in range(len(choices.plant.case.machines)):
                numbers += _numbers_of((OBSERVED_MACHINES, "machine_observed", "sync"), i)
            numbers += _numbers_of((OBSERVED_GRID, "grid_observed", "grid"), None)
        for device in choices.plant.devices:
            if device.shown is not None:
                shown = device.kind, device.shown, device.kind.name
                numbers += (number for j in range(len(device.buses)) for number in _numbers_of(shown, j))
        return numbers


#: The first task of each version: the one of the benchmark.
_FIRST: dict[str, Task] = {}


@lru_cache(maxsize=64)
def _routines_of(programs: tuple[Program, ...]) -> tuple[routines.Routine, ...]:
    return tuple(map(routines.Routine, programs))


def _of_version(version: str) -> Task:
    return _FIRST[version]


def _numbers_of(shown: Shown, unit: int | None) -> Iterator[ObservedNumber]:
    """Yield the numbers that a unit shows; of a kind with one unit, which has no index, with None."""
    kind, part, letters = shown
    prefix = letters if unit is None else f"{letters}{unit}"
    for place, (name, hint) in enumerate(get_type_hints(kind.scratch[part], include_extras=True).items()):
        counted_in = "".join(f" [{text}]" for text in getattr(hint, "__metadata__", ())[:1])
        yield ObservedNumber(f"{prefix}.{name}{counted_in}", kind, part, unit or 0, place)


def _inv_torque(plant: Plant) -> float:
    if plant.case.load_mw == grid.get_grid(grid.DEFAULT_GRID).case.load_mw:
        return 1.0
    return plant.case.base_mva / max(_TORQUE_SHARE * plant.case.load_mw, 1e-6)
