"""What it costs to take ten turbines for one: groups against their single turbines, in the same wind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wtg_gym.envs.lanes import TERMINATION_REASONS
from wtg_gym.files import markdown_table
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import WtgGroup, default_groups
from wtg_gym.physics.plant import plant_settings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, group_laws
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.single_turbines import single_and_aggregate, turbine_winds
from wtg_gym.scenarios.wind import TURBULENCE_CLASSES, ntm_sigma

STRATEGIES = (REFERENCE_STRATEGY, "mppt", "deloaded-5")
#: Offset of the seeds of the single winds from those of the scenarios.
_WIND_SEED = 7_000_000


@dataclass(frozen=True, kw_only=True)
class Totals:
    """Runs of one strategy over scenarios, (n,) each."""

    energy_pu_s: Floats  # captured energy, mean over turbines [p.u. s]
    least_ratio: Floats  # smallest tip-speed ratio of any turbine [-]
    nadir_hz: Floats  # lowest frequency [Hz]
    tripped: Floats  # how many turbines were disconnected


@dataclass(frozen=True, kw_only=True)
class AggregationStudy:
    """The same wind and events on groups of ten and on their single turbines."""

    #: suite, seeds, physics: of the scenarios and the plant.
    suite: str
    seeds: tuple[int, ...]
    physics: str
    #: sigma_single, sigma_group: mean standard deviation of a turbine's wind and of a group's [m/s].
    sigma_single: float
    sigma_group: float
    #: groups, single: by strategy.
    groups: dict[str, Totals]
    single: dict[str, Totals]


def study_aggregation(
    n_scenarios: int = 60,
    *,
    suite: str = "low-wind",
    physics: str = "paper",
    on_progress: Callable[[str, float, int], None] | None = None,
) -> AggregationStudy:
    """Run validation scenarios on the default groups and on their twenty single turbines.

    Mean wind and events are the suite's; turbulence is drawn for every turbine, and a group's wind is the mean of its
    turbines'. Turbines and groups whose rotor fails are disconnected, and the run goes on.

    Args:
        n_scenarios: how many, from the first validation seed on.
        suite: of random scenarios.
        physics: of the plant.
        on_progress: called with (strategy, strategies done, strategies in all).

    Raises:
        ValueError: the suite has no random scenarios, or not so many; or a run ends early.
    """
    chosen = get_suite(suite)
    allowed = chosen.seeds("validation")
    if chosen.distribution is None:
        raise ValueError(f"the suite {suite!r} has no random scenarios")
    if not 1 <= n_scenarios <= len(allowed):
        raise ValueError(f"the number of scenarios must be 1 … {len(allowed)}, got {n_scenarios}")
    seeds = tuple(allowed[:n_scenarios])
    groups = default_groups()
    pairs, sigmas = [], []
    for seed in seeds:
        scenario = chosen.scenario(seed)
        rng = np.random.default_rng(_WIND_SEED + seed)
        winds = [
            turbine_winds(
                float(mean), ntm_sigma(float(mean), TURBULENCE_CLASSES["B"]), int(group.n_turbines), samples, rng
            )
            for mean, samples, group in zip(
                scenario.wind_speed.mean(axis=1), [scenario.wind_speed.shape[1]] * len(groups), groups, strict=True
            )
        ]
        pair = single_and_aggregate(scenario, winds)
        pairs.append(pair)
        sigmas.append([wind.wind_speed.std(axis=1).mean() for wind in pair])
    alone = tuple(WtgGroup(bus=g.bus, n_turbines=1.0) for g in groups for _ in range(int(g.n_turbines)))
    found: list[dict[str, Totals]] = [{}, {}]
    for done, strategy in enumerate(STRATEGIES):
        for place, plant_groups in ((0, alone), (1, groups)):
            found[place][strategy] = totals_of([pair[place] for pair in pairs], strategy, plant_groups, physics)
        if on_progress is not None:
            on_progress(strategy, done + 1, len(STRATEGIES))
    single, group = np.mean(sigmas, axis=0)
    return AggregationStudy(
        suite=suite,
        seeds=seeds,
        physics=physics,
        sigma_single=float(single),
        sigma_group=float(group),
        groups=found[1],
        single=found[0],
    )


def totals_of(scenarios: list[Scenario], strategy: str, groups: tuple[WtgGroup, ...], physics: str) -> Totals:
    """Run scenarios side by side and add up; a ValueError if a run ends early."""
    settings = plant_settings(physics, groups=groups, trips_groups=True)
    simulator = Simulator(settings, n_lanes=len(scenarios), duration_s=max(s.duration_s for s in scenarios))
    laws = group_laws(strategy, len(groups), settings.turbine, settings.control)
    simulator.commit(range(len(scenarios)), simulator.prepare(scenarios, laws))
    for _ in range(simulator.n_intervals):
        simulator.advance()
    simulator.close()
    # The energy of a run that ends early would be short.
    ends = Counter(Status(int(status)) for status in simulator.lane_values("status") if status != Status.RUNNING)
    if ends:
        reasons = ", ".join(f"{TERMINATION_REASONS[status]} ({n})" for status, n in ends.items())
        raise ValueError(f"of {len(scenarios)} runs under {strategy} {ends.total()} end early: {reasons}")
    return Totals(
        energy_pu_s=simulator.wtg_values("energy_captured").mean(axis=1),
        least_ratio=simulator.wtg_values("least_tsr").min(axis=1),
        nadir_hz=settings.case.frequency_hz * simulator.lane_values("coi_min"),
        tripped=(simulator.wtg_values("connected") < 0.5).sum(axis=1) * 20.0 / len(groups),
    )


def aggregation_table(study: AggregationStudy) -> str:
    """Return the study as Markdown."""
    header = (
        "strategy",
        "energy captured, singles against groups",
        "smallest λ: groups",
        "singles",
        "runs with a trip: groups",
        "singles",
        "turbines tripped: groups",
        "singles",
        "nadir, singles minus groups [mHz]",
    )
    rows = []
    for strategy, group in study.groups.items():
        single = study.single[strategy]
        rows.append(
            (
                strategy,
                f"{100.0 * (single.energy_pu_s.sum() / group.energy_pu_s.sum() - 1.0):+.1f} %",
                f"{group.least_ratio.min():.2f}",
                f"{single.least_ratio.min():.2f}",
                f"{int((group.tripped > 0).sum())}",
                f"{int((single.tripped > 0).sum())}",
                f"{group.tripped.sum():.0f}",
                f"{single.tripped.sum():.0f}",
                f"{1e3 * (single.nadir_hz - group.nadir_hz).mean():+.1f}",
            )
        )
    return markdown_table(header, rows, right=tuple(range(1, len(header))))
