"""Entries in scenarios, plants and costs that no suite has: what `evaluate` does, for changed ones."""

from __future__ import annotations

import copy
import dataclasses
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.envs.cost import frequency_cost
from wtg_gym.envs.settings import EnvSettings, PlantEnvSettings
from wtg_gym.evaluation import Entry, Results
from wtg_gym.evaluation.circumstances import environment_fingerprint, versions
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.evaluator import shared_settings
from wtg_gym.evaluation.metrics import Recorder, measure
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.files import sha256
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import GovernorLoss, Scenario
from wtg_gym.policies.play import play, started_lanes
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite
from wtg_gym.systems.compiled import source_hash

#: Scenarios that are played side by side, as many as `evaluate` gives to a policy in a file.
BATCH = 64


def played(
    entries: Sequence[Entry],
    suite: str,
    split: str,
    seeds: Sequence[int],
    *,
    change: Callable[[Scenario], Scenario] = lambda scenario: scenario,
    plant: Callable[[PlantSettings], PlantSettings] | None = None,
    by_centre: bool = False,
    partial: Path | None = None,
    **settings: Any,
) -> Results:
    """Play entries, both anchors among them, through the changed scenarios of seeds.

    Args:
        change: makes of a scenario the one that is played; of the same length in all of them.
        plant: makes of the suite's plant the one that is played in.
        by_centre: charge the frequency of the centre of inertia in place of the worst unit's.
        partial: as for `evaluate`.
        settings: further ones of the environment.
    """
    scenarios = [change(scenario) for scenario in get_suite(suite).scenarios(seeds)]
    own = EnvSettings(suite=suite, split=split, **{"duration_s": scenarios[0].duration_s} | settings)
    if plant is not None:
        own = PlantEnvSettings.of(own, plant(own.plant()))
    shared = shared_settings(own)
    scene = sha256(pickle.dumps([scenarios, by_centre]) + repr(own.plant()).encode())
    store = PartialStore(partial, [scene, shared, sha256(Path(__file__).read_bytes())])

    def of_part(part: tuple[Entry, int]) -> list[Episode]:
        entry, first = part
        places = list(seeds[first : first + BATCH])
        rows = store.load(entry, places)
        if rows is None:
            # A policy in a file has a process of its own in every part.
            alone = dataclasses.replace(entry, policy=copy.deepcopy(entry.policy))
            rows = list(_episodes(alone, own, scenarios[first : first + BATCH], by_centre))
            store.save(entry, places, rows)
        return rows

    parts = [(entry, first) for entry in entries for first in range(0, len(seeds), BATCH)]
    episodes: list[Episode] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool, Progress("parts") as progress:
        for done, ((entry, _), rows) in enumerate(zip(parts, pool.map(of_part, parts), strict=True), start=1):
            episodes += rows
            progress.update(entry.name, done, len(parts))
    return Results(
        suite=suite,
        split=split,
        suite_hash=get_suite(suite).hash,
        source_hash=source_hash(),
        seeds=tuple(seeds),
        environment={"id": own.benchmark().env_id, "fingerprint": environment_fingerprint(own)},
        settings=shared,
        versions=dict(versions()),
        entries=tuple(entry.to_dict() for entry in entries),
        episodes=tuple(episodes),
    )


def _episodes(entry: Entry, settings: EnvSettings, given: Sequence[Scenario], by_centre: bool) -> Iterator[Episode]:
    try:
        with started_lanes(entry, settings, given, 1) as (lanes, _):
            recorder = Recorder(lanes)
            for stepped in play(entry, lanes):
                recorder.record(stepped)
            for lane, scenario in enumerate(given):
                found = measure(lanes, recorder, lane)
                if by_centre and not found["failure"]:
                    away = np.abs(recorder.frequency_hz[lane, 1:] - lanes.nominal_hz)
                    rates = [frequency_cost(value) for value in away.tolist()]
                    charged = settings.cost_weights().frequency * settings.control_dt * sum(rates)
                    values = found["metrics"]
                    found["metrics"] = values | {
                        "cost": values["cost"] + charged - values["cost_frequency"],
                        "cost_frequency": charged,
                    }
                seed, duration_s = int(lanes.scenario_seeds[lane]), lanes.duration_s
                identity = {"entry": entry.name, "training_seed": entry.training_seed, "seed": seed}
                yield Episode(**identity, scenario=scenario.name, duration_s=duration_s, **found)
    finally:
        # Those in a wrapper are not ended with the episodes.
        getattr(entry.policy, "close", lambda: None)()


def without_governor(scenario: Scenario) -> Scenario:
    """Return a scenario in which the governor does not act."""
    kept = tuple(event for event in scenario.events if not isinstance(event, GovernorLoss))
    return dataclasses.replace(scenario, events=(GovernorLoss(time_s=0.0, bus=1), *kept))


def longer(scenario: Scenario, more_s: float = 60.0, last_s: float = 50.0) -> Scenario:
    """Return a scenario that goes on without events: wind and load noise go back and forth through its last seconds."""

    def gone_on(series: np.ndarray) -> np.ndarray:
        kept, more = (round(seconds / scenario.wind_dt_s) for seconds in (last_s, more_s))
        last = np.pad(series[..., -kept - 1 :], [(0, 0)] * (series.ndim - 1) + [(0, more)], mode="reflect")
        return np.concatenate([series, last[..., kept + 1 :]], axis=-1)

    series = {"wind_speed": gone_on(scenario.wind_speed), "load_noise_mw": gone_on(scenario.load_noise_mw)}
    return dataclasses.replace(scenario, duration_s=scenario.duration_s + more_s, **series)
