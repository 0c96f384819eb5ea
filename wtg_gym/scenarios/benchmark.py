"""What a version of the benchmark fixes besides its suites' scenarios: plant, task, anchors of the score."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

from wtg_gym.physics.grid import DEFAULT_GRID, Grid, digest_of_grid, get_grid
from wtg_gym.physics.machine_parameters import GovernorParameters
from wtg_gym.physics.parameters import WtgGroup, default_groups
from wtg_gym.physics.plant import PlantSettings, plant_settings


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A version of the benchmark."""

    version: str  # "v0", "v1"
    k_authority: float  # offset on k at full action, as a share of K_opt - K_pr [-]
    sensed: bool  # whether policies see what sensors measure, not what there is
    duty_time_s: float  # time constant of the filter behind which the duty is charged; 0 for none [s]
    on_failure: str = "terminate"  # what the failure of a rotor does, unless an environment is asked for the other
    #: Whether the frequency charged is that of the worst unit, without a cap, load that is not served is charged, and a
    #: failed episode costs what one costs in which no load is served.
    charges_worst: bool = False
    #: Stratum, "" where there are none, and J0 of the score in it, in units of the cost.
    cost_offsets: tuple[tuple[str, float], ...] = (("", 5.0),)
    #: Name and value of the cost's weights that are not those of :class:`~wtg_gym.envs.settings.CostWeights`.
    weights: tuple[tuple[str, float], ...] = ()
    anchors: tuple[str, str]  # names of the entries that score 0 and 100

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

    def to_dict(self) -> dict[str, Any]:
        """Return the version as JSON-ready data."""
        return {**vars(self), "weights": dict(self.weights), "cost_offsets": dict(self.cost_offsets)}


@dataclass(frozen=True, kw_only=True)
class SuitePlant:
    """The grid of a suite: how much of it is wind, how strong the rest is."""

    grid: str = DEFAULT_GRID  # its name, or the path of its file
    groups: tuple[WtgGroup, ...] = field(default_factory=default_groups)
    physics: str = "paper"  # see plant_settings
    generator_mva: float | None = None  # rating of the generator at bus 1, None for the paper's [MVA]
    governor: GovernorParameters | None = None  # of that generator, None for the paper's
    overload_from_pu: float | None = None  # power above which a converter counts as overloaded [p.u.]
    secondary_time_s: float = 0.0  # of the secondary control, see PlantSettings; 0 for none [s]
    branch_scale: float = 1.0  # factor on the impedance of every line and transformer [-]
    condensers: bool = True  # whether the case's synchronous condensers are there
    simulation_dt: float = 0.025  # longest step that suits it, of those of longest_step [s]

    @cached_property
    def grid_data(self) -> Grid:
        """The grid itself, read once: what is written to its file later does not change what was made of it."""
        return get_grid(self.grid)

    def settings(
        self, *, groups: tuple[WtgGroup, ...] | None = None, physics: str | None = None, classical: bool, **steps: Any
    ) -> PlantSettings:
        """Return the plant, with other groups or physics if given.

        Args:
            groups, physics: replace the suite's own.
            classical: whether machines are a constant voltage behind x'_d.
            steps: control_dt, simulation_dt and trips_groups of :class:`~wtg_gym.physics.plant.PlantSettings`.
        """
        case = self.grid_data.with_groups
        case = case.classical() if classical else case
        generator: dict[str, Any] = {"rating_mva": self.generator_mva, "governor": self.governor}
        changes = {name: value for name, value in generator.items() if value is not None}
        machines = [dataclasses.replace(m, **changes) if m.bus == case.slack_bus else m for m in case.machines]
        branches = [
            dataclasses.replace(
                b, resistance=self.branch_scale * b.resistance, reactance=self.branch_scale * b.reactance
            )
            for b in case.branches
        ]
        case = dataclasses.replace(
            case,
            machines=tuple(m for m in machines if self.condensers or m.governor is not None),
            branches=tuple(branches),
        )
        steps |= {"secondary_time_s": self.secondary_time_s} if self.secondary_time_s else {}
        steps["shares_dispatch"] = sum(machine.governor is not None for machine in case.machines) > 1
        plant = plant_settings(physics or self.physics, case=case, groups=groups or self.groups, **steps)
        if self.overload_from_pu is not None:
            control = dataclasses.replace(plant.control, overload_limit_pu=self.overload_from_pu)
            plant = dataclasses.replace(plant, control=control)
        return plant

    @property
    def governed_mva(self) -> float:
        """Rating of all machines with a governor [MVA]."""
        if self.generator_mva is not None:
            return self.generator_mva
        return sum(m.rating_mva for m in self.grid_data.with_groups.machines if m.governor is not None)

    @property
    def constant_mw(self) -> float:
        """What its machines without a governor give [MW]."""
        machines = self.grid_data.with_groups.machines
        return sum(machine.dispatch_mw for machine in machines if machine.governor is None)

    def to_dict(self) -> dict[str, Any]:
        """Return the plant as JSON-ready data; suites of the IEEE 14-bus system keep the hashes that they had."""
        data = {**dataclasses.asdict(self), "groups": [group.to_dict() for group in self.groups]}
        if self.grid != DEFAULT_GRID:
            data["grid"] = digest_of_grid(self.grid_data)
        later = {"grid": DEFAULT_GRID, "simulation_dt": SuitePlant.simulation_dt}
        return {key: value for key, value in data.items() if key not in later or value != later[key]}


#: The paper's system. 0 is MPPT, 100 the paper's law.
V0 = Benchmark(version="v0", k_authority=0.5, sensed=False, duty_time_s=0.0, anchors=("mppt", "coordinated-piecewise"))
#: The grid that needs the wind. 0 is the paper's law, 100 the same law tuned to this grid.
V1 = Benchmark(
    version="v1",
    k_authority=1.0,
    sensed=True,
    duty_time_s=15.0,
    on_failure="trip",
    charges_worst=True,
    # Of the size of what an episode costs under the hundred: below that a cost counts almost as in a mean.
    cost_offsets=(("ordinary", 40.0), ("large", 300.0), ("extreme", 3000.0), ("", 300.0)),
    # Duty weighs as much as frequency, since the wind is most of the power; RoCoF five times as much as in v0, since
    # the synchronous machines have less than a third of v0's inertia: 0.82 instead of 2.86 GWs on average.
    weights=(("rocof", 20.0), ("duty", 0.3), ("rotor", 20.0), ("cap", 15.0)),
    anchors=("coordinated-piecewise", "coordinated-tuned"),
)

#: Id of version v1 on other grids.
ANY_GRID = "GFMWTG-v1"
#: The versions by the id of their environment.
BENCHMARKS: Mapping[str, Benchmark] = MappingProxyType({benchmark.env_id: benchmark for benchmark in (V0, V1)})
#: Names that an entry fixes the scale with in some version; no other entry can have one.
ANCHOR_NAMES = tuple(dict.fromkeys(name for benchmark in BENCHMARKS.values() for name in benchmark.anchors))
