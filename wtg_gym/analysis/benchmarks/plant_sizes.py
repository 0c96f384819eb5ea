"""Cases that step our environment's lanes directly, for plants of any size on any number of threads."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.core import event

from wtg_gym.analysis.benchmarks.timing import Case, Stepper
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.network import NetworkCase
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import LoadStep, Scenario

#: Long enough for restarts to be rare, short enough for thousands of lanes to fit into memory [s].
_DURATION_S = 20.0
#: Synchronous machines of the modified 14-bus network.
N_MACHINES = 4


def network_with_machines(n_machines: int) -> NetworkCase:
    """Return the 14-bus network with each of its four machines split into equal ones at the same bus.

    Raises:
        ValueError: the number is not a multiple of four.
    """
    if n_machines < N_MACHINES or n_machines % N_MACHINES:
        raise ValueError(f"the number of machines must be a multiple of {N_MACHINES}, got {n_machines}")
    case, split = modified_ieee14(), n_machines // N_MACHINES
    machines = tuple(
        dataclasses.replace(machine, rating_mva=machine.rating_mva / split, dispatch_mw=machine.dispatch_mw / split)
        for machine in case.machines
        for _ in range(split)
    )
    return dataclasses.replace(case, machines=machines)


@dataclass(frozen=True, kw_only=True)
class _Settings(EnvSettings):
    """Settings of an environment with another number of machines."""

    machines: int = N_MACHINES

    def plant(self) -> PlantSettings:
        """Return the plant and its time steps."""
        return dataclasses.replace(super().plant(), case=network_with_machines(self.machines))


@dataclass
class LanesCase:
    """Episodes side by side, stepped without action by compiled code alone."""

    #: part, name: as for :class:`Case`.
    part: str
    name: str
    #: n_lanes, n_threads: as for :class:`TaskLanes`.
    n_lanes: int
    n_threads: int | None = 1
    #: groups, machines: size of the plant.
    groups: int = 2
    machines: int = N_MACHINES
    #: How long numba compiled for it, 0 where everything was cached on disk [s]; once it is made.
    compile_s: float = field(default=0.0, init=False)
    #: Memory of one lane [B]; once it is made.
    bytes_per_lane: float = field(default=0.0, init=False)

    def case(self) -> Case:
        """Return the case for :func:`~wtg_gym.analysis.benchmarks.timing.prepare`."""
        usual = self.groups == 2 and self.machines == N_MACHINES
        return Case(self.part, self.name, self.n_lanes, self._make, preparation_s=1.0 if usual else 25.0)

    def _make(self) -> Stepper:
        settings = _Settings(version="v0", groups=self.groups, machines=self.machines, duration_s=_DURATION_S)
        with event.install_recorder("numba:compile") as recorder:
            lanes = TaskLanes(settings, self.n_lanes, self.n_threads)
            scenario = Scenario(
                name="load step",
                wind_speed=np.full((self.groups, 1), 10.0),
                duration_s=_DURATION_S,
                events=(LoadStep(time_s=1.0, bus=2, power_mw=30.0),),
            )
            episode = lanes.prepare([scenario])
            lanes.commit([0], [episode])
            actions = np.zeros((self.n_lanes, lanes.n_action))
            lanes.step(actions)
        self.compile_s = _outermost_s(recorder.buffer)
        arrays: list[npt.NDArray[Any]] = [lanes.simulator.blocks, *lanes.simulator.data, *lanes.outputs]
        self.bytes_per_lane = sum(array.nbytes for array in arrays) / self.n_lanes
        step = n_steps = int(episode.n_intervals[0])

        def stepper(seconds: float) -> float:
            # An episode's restart is left out: what it costs depends on the length of the episode.
            nonlocal step
            n, passed = 0, 0.0
            while passed < seconds:
                if step >= n_steps:
                    lanes.commit(range(self.n_lanes), [episode] * self.n_lanes)
                    step = 0
                count = min(n_steps - step, max(1, 256 // self.n_lanes))
                begin = time.perf_counter()
                for _ in range(count):
                    lanes.step(actions)
                passed += time.perf_counter() - begin
                step += count
                n += count
            return n * self.n_lanes / passed

        return stepper


def _outermost_s(buffer: list[tuple[float, event.Event]]) -> float:
    """Return the time covered by recorded events, of which one may lie in another [s]."""
    total, depth, begin = 0.0, 0, 0.0
    for at, recorded in buffer:
        if recorded.is_start:
            begin = at if depth == 0 else begin
            depth += 1
        else:
            depth -= 1
            total += at - begin if depth == 0 else 0.0
    return total
