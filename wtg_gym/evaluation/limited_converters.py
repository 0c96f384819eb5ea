"""Policies that were trained in a plant without limits, played in one whose converters have them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wtg_gym.analysis.plant_forms import UNLIMITED
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import markdown_table
from wtg_gym.physics.parameters import ConverterLimitParameters, GridFormingParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.policies.entry import Entry
from wtg_gym.policies.play import play, started_lanes
from wtg_gym.scenarios import get_suite


@dataclass(frozen=True, kw_only=True)
class LimitedSettings(EnvSettings):
    """The environment with given limits on its converters, which `physics` sets only together with everything else."""

    limits: ConverterLimitParameters | None = None

    def plant(self) -> PlantSettings:
        """Return the plant and its time steps."""
        return dataclasses.replace(super().plant(), limits=self.limits)


@dataclass(frozen=True, kw_only=True)
class LimitedPlay:
    """Behaviour of an entry in validation scenarios of a suite."""

    entry: str  # its label
    limited: bool  # whether the converters have REGFM_A1's limits
    n_scenarios: int
    failures: int  # how many of them end in a failure
    overloaded: int  # runs in which a group gives more than the overload limit of the cost
    overload_time_s: float  # for which it does, the mean over all runs of their worst group [s]
    peak_power_pu: float  # largest p [p.u.]
    nadir_hz: float  # median of the runs that last [Hz]
    cost: float  # mean of an episode


def play_limited(entry: Entry, suite: str, n_scenarios: int, *, limited: bool) -> LimitedPlay:
    """Play the first validation scenarios of a suite, with or without the converters' limits."""
    limits = ConverterLimitParameters() if limited else UNLIMITED
    seeds = list(get_suite(suite).validation[:n_scenarios])
    settings = LimitedSettings(suite=suite, split="validation", limits=limits)
    with started_lanes(entry, settings, seeds) as (lanes, _):
        costs = np.zeros(len(seeds))
        for running in play(entry, lanes):
            costs -= np.where(running, lanes.rewards, 0.0)
        simulator = lanes.simulator
        peak, time = simulator.wtg_values("peak_power"), simulator.wtg_values("overload_time")
        failed = simulator.lane_values("status") != Status.RUNNING
        nadirs = lanes.nominal_hz * simulator.lane_values("coi_min")
    return LimitedPlay(
        entry=entry.label,
        limited=limited,
        n_scenarios=len(seeds),
        failures=int(failed.sum()),
        overloaded=int((peak > GridFormingParameters().overload_limit_pu).any(axis=1).sum()),
        overload_time_s=float(time.max(axis=1).mean()),
        peak_power_pu=float(peak.max()),
        nadir_hz=float(np.median(nadirs[~failed])),
        cost=float(costs.mean()),
    )


def limited_table(plays: Sequence[LimitedPlay], suite: str) -> str:
    """Return plays with and without limits as a Markdown table, an entry a row."""
    rows = []
    for entry in dict.fromkeys(each.entry for each in plays):
        pair = sorted((each for each in plays if each.entry == entry), key=lambda each: each.limited)
        texts = (
            [f"{each.overloaded}" for each in pair],
            [f"{each.overload_time_s:.2f}" for each in pair],
            [f"{each.peak_power_pu:.2f}" for each in pair],
            [f"{each.failures}" for each in pair],
            [f"{each.nadir_hz:.3f}" for each in pair],
            [f"{each.cost:.1f}" for each in pair],
        )
        rows.append((entry, *("/".join(cells) for cells in texts)))
    header = (
        f"{suite}, {plays[0].n_scenarios} runs",
        "overloaded",
        "for [s]",
        "largest p",
        "failures",
        "median nadir [Hz]",
        "cost",
    )
    return markdown_table(header, rows, right=range(1, len(header)))
