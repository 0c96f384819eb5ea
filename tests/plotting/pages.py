"""A small leaderboard for the tests of its page, one of its entries with hostile texts."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from baselines import tip_speed_feedback
from wtg_gym.evaluation import Entry, Results, evaluate, load_entries
from wtg_gym.evaluation.matrix import PERTURBATIONS
from wtg_gym.plotting.page import leaderboard_page
from wtg_gym.scenarios import draw_seeds
from wtg_gym.scenarios.benchmark import V0, V1
from wtg_gym.scenarios.sensor_distribution import SensorDistribution

#: Texts that would run or load something if taken for HTML, or that a chart would take for mathematics.
HOSTILE = '</script><script>window.hacked=1</script><img src="https://example.org/x" onerror="window.hacked=1">$$x$$'
DURATION_S = 12.0
#: Names of the changes of the sensors in `both_results`.
OTHER_SENSORS = ("delay +0.1 s", "delay +0.2 s", "wind bias × 2")
SEEDS = (20_000, 20_001, 20_002)
#: The scenarios of v1.
OWN: dict[str, Any] = {"split": "validation", "seeds": range(10_000, 10_012), "duration_s": 30.0}
TRACED = ("deloaded-10", "mppt", "coordinated-piecewise")


class _Full:
    """Turns every action up."""

    def predict(
        self, observation: object, state: object = None, episode_start: object = None, deterministic: bool = False
    ) -> tuple[object, object]:
        return np.ones((len(np.asarray(observation)), 4)), state


@functools.cache
def small_results() -> tuple[list[Entry], list[Results]]:
    """Return three laws and a policy, and their results on two suites."""
    laws = [Entry(name=name, strategy=name) for name in TRACED]
    policy = Entry(name="full", policy=_Full(), description=HOSTILE, source=HOSTILE, fingerprint="full")
    entries = [*laws, policy]
    standard = evaluate(entries, "standard", "test", seeds=SEEDS, duration_s=DURATION_S)
    return entries, [standard, evaluate(laws, "paper", "test")]


def renamed(results: Results, old: str, new: str) -> Results:
    """Return results with another name for an entry, which no `Entry` needs to allow."""
    return dataclasses.replace(
        results,
        entries=tuple({**data, "name": new} if data["name"] == old else data for data in results.entries),
        episodes=tuple(
            dataclasses.replace(episode, entry=new) if episode.entry == old else episode for episode in results.episodes
        ),
    )


@functools.cache
def small_page() -> str:
    """Return their page, the policy under a hostile name."""
    entries, (standard, paper) = small_results()
    return leaderboard_page([renamed(standard, "full", HOSTILE), paper], entries, n_scenarios=3).text


@functools.cache
def wide_page() -> str:
    """Return a page whose ranking has every column, without traces: fresh scenarios, an oracle, and a learned entry."""
    feedback = tip_speed_feedback.ENTRY
    learned = [
        dataclasses.replace(feedback, name="PPO (k, τ)", learned=True, training_seed=seed, fingerprint=f"own {seed}")
        for seed in range(2)
    ]
    entries = [*load_entries("baselines"), *learned]
    public = evaluate(entries, "standard", "test", seeds=range(20_000, 20_030))
    draw = draw_seeds("standard", "a" * 40, b"a secret for these tests", 30)
    fresh = evaluate(entries, "standard", "fresh", draw=draw)
    return leaderboard_page([public, fresh], [], n_scenarios=0).text


@functools.cache
def results_of_v1() -> Results:
    """Return results of the baselines of v1."""
    return evaluate("baselines", "standard-v1", **OWN)


@functools.cache
def both_results() -> list[Results]:
    """Return results of both versions, the earlier one first: with other sensors, without a scale, and usual ones."""
    droop = load_entries("fast-droop")
    return [
        *reversed(small_results()[1]),
        evaluate(droop, "paper-v1", "validation"),
        results_of_v1(),
        *(evaluate(droop, "standard-v1", **OWN, sensors=each(SensorDistribution())) for each in PERTURBATIONS.values()),
    ]


@functools.cache
def both_page() -> str:
    """Return their page."""
    baselines = [load_entries("baselines", benchmark=benchmark) for benchmark in (V0, V1)]
    return leaderboard_page(both_results(), [entry for own in baselines for entry in own], n_scenarios=1).text
