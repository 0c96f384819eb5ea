"""Faults of sensors: measurements that come late, are wrong, hang or stay away.

A law has no sensors: nothing changes for it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import evaluator, results
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.sensors import Sensors
from wtg_gym.policies import Entry, PolicyError
from wtg_gym.scenarios.suites import DEFAULT_SUITE, get_suite
from wtg_gym.tasks import V1
from wtg_gym.tasks.episode import ACTION_MODES


def _worse(scenario: Scenario, change: Callable[[Sensors], dict[str, Any]]) -> Scenario:
    """Return a scenario whose sensors have other values, which are made of those they have."""
    assert scenario.sensors is not None
    return replace(scenario, sensors=replace(scenario.sensors, **change(scenario.sensors)))


def hanging(seen: Floats, kept: Floats) -> None:
    """Let the frequency stay at its last value: it does not change."""
    seen[:, 0], seen[:, 1] = kept[:, 0], 0.0


def silent(seen: Floats, _kept: Floats) -> None:
    """Let every entry of the observation be 0, as of a turbine at rated speed, 50 Hz and 10 m/s."""
    seen[:, : V1.n_local] = 0.0


#: Changes of a scenario's sensors, by what is said of them.
WORSE_SENSORS: Mapping[str, Callable[[Scenario], Scenario]] = {
    "delay +0.5 s": partial(_worse, change=lambda sensors: {"delay_s": round(sensors.delay_s + 0.5, 9)}),
    "wind bias × 4": partial(_worse, change=lambda sensors: {"wind_bias": tuple(4.0 * x for x in sensors.wind_bias)}),
}
#: Faults of the sensors of the first group, the largest, with the step from which on.
SENSOR_FAULTS: Mapping[str, tuple[Callable[[Floats, Floats], None], int]] = {
    "a frequency sensor hangs": (hanging, 100),  # from 50 s on
    "a group's observation is 0": (silent, 0),
}


@dataclass
class FaultyPolicy:
    """A policy that sees what failing sensors say; its state is the step, what they said last, and its own state."""

    policy: Any
    width: int  # numbers of the first group in an observation
    fault: Callable[[Floats, Floats], None]
    since: int  # step
    n_parts: int = 1  # parts that each environment's observation is given in: its groups, of a policy for one group

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (num_envs, n_action), next state)."""
        seen = np.array(observation)
        first = seen[:: self.n_parts, : self.width]
        step, kept, memory = (0, first, None) if state is None else state
        if step <= self.since:
            kept = first.copy()
        if step >= self.since:
            self.fault(first, kept)
        actions, memory = self.policy.predict(seen, memory, episode_start, deterministic)
        return actions, (step + 1, kept, memory)


def with_faults(
    before: results.Results, entry: Entry, settings: EnvSettings, n_threads: int | None
) -> Iterator[tuple[str, results.Results]]:
    """Yield results with the episodes of an entry under each fault in the place of its own; none for a law.

    A PolicyError says that its policy fails.
    """
    scenarios = get_suite(before.suite).scenarios(before.seeds)
    others = [episode for episode in before.episodes if episode.entry != entry.name]
    worse = {name: (entry, [*map(change, scenarios)]) for name, change in WORSE_SENSORS.items()}
    failing = {name: (with_fault(entry, *fault), scenarios) for name, fault in SENSOR_FAULTS.items()}
    for name, (player, drawn) in (worse | failing).items() if entry.policy is not None else ():
        episodes = evaluator.play_batch(player, settings, drawn, n_threads)
        if isinstance(episodes, PolicyError):
            raise episodes
        yield name, replace(before, episodes=(*others, *episodes))


def with_fault(entry: Entry, fault: Callable[[Floats, Floats], None], since: int) -> Entry:
    """Return an entry of v1's own grid with failing sensors in the first group; a law has none."""
    if entry.policy is None:
        return entry
    width = V1.n_local + sum(ACTION_MODES[entry.action_mode])
    n_parts = len(get_suite(DEFAULT_SUITE).plant.groups) if entry.per_group else 1
    return replace(entry, policy=FaultyPolicy(entry.policy, width, fault, since, n_parts))
