"""Scenarios as arrays: starts, series and events of episodes, prepared before any is played."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.functional.programs import Programs
from wtg_gym.physics.lane_data import LaneData
from wtg_gym.physics.layout import Floats, Layout
from wtg_gym.physics.reduction import refresh_network
from wtg_gym.physics.scenario import Scenario

Integers = npt.NDArray[np.int32]


class EnvParams(NamedTuple):
    """A bank of scenarios, out of which an episode takes one; arrays of numpy, or of JAX.

    The networks of all scenarios stand one behind the other: of each, one per time at which its network changes.
    """

    start: Floats  # rows that an episode keeps, as it starts (n_scenarios, n_kept)
    observation: Floats  # the first one (n_scenarios, n_observation)
    wind: Floats  # at the ends of control intervals (n_scenarios, n_intervals + 1, n_wtg) [m/s]
    noise: Floats  # load noise per control interval (n_scenarios, n_intervals) [MW]
    first_network: Integers  # (n_scenarios,)
    network: Floats  # rows that follow from it, and which governors are lost (n_networks, n_network_rows + n_sync)
    until: Floats  # simulation step of the next change (n_networks,)
    scenario_seed: Integers  # -1 for scenarios without (n_scenarios,)
    max_steps_in_episode: int

    @property
    def n_scenarios(self) -> int:
        """Number of scenarios."""
        return int(self.start.shape[0])


def prepare(lanes: TaskLanes, programs: Programs, scenarios: Sequence[Scenario]) -> EnvParams:
    """Return the bank of some scenarios.

    Args:
        lanes: of one lane; an episode of each scenario is started in it.
        programs: of its plant and task.
        scenarios: at least one.

    Raises:
        ValueError: there are none, or one does not fit the plant or the episode length, or has no equilibrium.
    """
    if not scenarios:
        raise ValueError("a bank needs at least one scenario")
    simulator = lanes.simulator
    episodes = lanes.prepare_given(scenarios)
    data, n_steps = episodes.lanes.data, (episodes.n_intervals * simulator.plant.n_substeps).tolist()
    start, observations, networks = list[Floats](), list[Floats](), list[Floats]()
    until, first = list[float](), list[int]()
    for place in range(len(scenarios)):
        lanes.commit_some([0], episodes, [place])
        block = simulator.blocks[0].copy()
        start.append(block[list(programs.kept)])
        observations.append(block[-lanes.n_observation :])
        first.append(len(until))
        for rows, end in _networks(block, place, n_steps[place], simulator.plant, data, simulator.layout, programs):
            networks.append(rows)
            until.append(end)
    return EnvParams(
        start=np.array(start),
        observation=np.array(observations),
        wind=data.wind.transpose(0, 2, 1).copy(),
        noise=data.noise.copy(),
        first_network=np.array(first, dtype=np.int32),
        network=np.array(networks),
        until=np.array(until),
        scenario_seed=episodes.scenario_seeds.astype(np.int32),
        max_steps_in_episode=int(episodes.n_intervals.max()),
    )


def _networks(
    block: Floats, lane: int, n_steps: int, plant: Any, data: LaneData, layout: Layout, programs: Programs
) -> list[tuple[Floats, float]]:
    """Return the networks of an episode in turn, and until when each lasts [simulation steps].

    Events come at given times and nothing else changes the network, so that it can be known beforehand.
    """
    found = []
    step, following, droop = layout.lane("step"), layout.lane("next_change"), layout.machine("inv_droop")
    governed = block[droop] > 0.0
    # As an episode starts: an event at t = 0 strikes in the first step.
    at = -1.0
    while at < n_steps:
        block[step] = at
        refresh_network(block, 0, lane, plant, data, 1)
        lost = governed & (block[droop] == 0.0)
        at = float(block[following])
        found.append((np.r_[block[list(programs.network)], lost], at))
    return found
