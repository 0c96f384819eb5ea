"""What a version of the benchmark fixes besides its suites: task, anchors of the score."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any


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
