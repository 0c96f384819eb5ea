"""How the tuned laws and the numbers of distilled-law were found: by CMA-ES on training scenarios of v1.

    python docs/studies/policies.py

prints them. To tune one of your own, call `tune_law` or `tune_gains`; each takes ten minutes at most on two
processors.
"""

import contextlib
import math
from collections.abc import Callable, Sequence

import numpy as np

from agents.evolution import Search
from baselines.distilled_law import DistilledLaw, Gains, terms
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import (
    LARGEST_COEFFICIENT,
    REFERENCE_LAW,
    TIME_CONSTANT_RANGE,
    TrackingLaw,
    Tuning,
    get_law,
)
from wtg_gym.policies.play import answer, started_batch
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks.measured_observation import MeasuredObservation
from wtg_gym.tasks.observation import of_groups

#: Least coefficient that is tried [p.u.]: at 0 a group would give nothing.
_LEAST_TRIED = 0.05
#: Points of :func:`law_of`: where searches begin, and their bounds; without the first number k ends at K_opt. K_n may
#: change by 0.08 only: with less power at nominal frequency runs could not start.
_START, _BOUNDS = (0.5, 0.0, 0.8, -0.6), ((0.0, -0.8, -0.2, -2.7), (3.0, 0.8, 1.05, 2.0))
#: Changes of the numbers of distilled-law that matter alike.
_GAIN_STEPS = np.array([0.5, 1.0, 1.0, 2.0, 0.1])
#: A multiple of 15 consecutive seeds holds as many of each stratum, and of each kind of extreme event.
N_SCENARIOS = 120


def playing(suite: str, n_scenarios: int, n_candidates: int, **settings) -> EnvBatch:
    """Return a batch in which candidates play the same training scenarios of a suite of v1 side by side."""
    of_env = EnvSettings(suite=suite, split="train", reward="cost", **settings)
    return EnvBatch(of_env, n_scenarios * n_candidates)


def objectives(batch: EnvBatch, scenarios: Sequence[Scenario], laws=None, act=None) -> Floats:
    """Return ln(J + J0) / Λ of each candidate, mean over the scenarios, (n_candidates,): it decides the score.

    Args:
        laws: the law of each candidate; None: that of the settings.
        act: actions (n_candidates, n_scenarios, n_wtg, n_action) by what the groups observe, each number an array
            (n_candidates, n_scenarios, n_wtg); None: zeros.
    """
    n_scenarios = len(scenarios)
    shape = batch.num_envs // n_scenarios, n_scenarios
    for candidate in range(shape[0]):
        if laws is not None:
            batch.laws = (laws[candidate],) * batch.n_wtg
        batch.start(range(candidate * n_scenarios, (candidate + 1) * n_scenarios), scenarios)
    actions = np.zeros((batch.num_envs, batch.n_action))
    for _ in range(batch.n_steps_of_episode):
        if act is not None:
            seen = batch.observations.reshape(*shape, -1).astype(np.float64)
            groups = of_groups(seen, MeasuredObservation, batch.settings.action_mode)
            actions = np.clip(act(groups), -1.0, 1.0).reshape(batch.num_envs, -1)
        batch.step(np.ascontiguousarray(actions))
    offsets = np.array([batch.suite.cost_offset(scenario) for scenario in scenarios])
    return np.log(batch.cost_sums().sum(axis=1).reshape(shape) + offsets).mean(axis=1)


def law_of(x: Floats) -> TrackingLaw:
    """Return the law of a point, made monotone, and held in range.

    A point is how far k lies above K_opt, above K_n and below K_pr, as shares, tenths and shares of K_opt - K_pr, and
    ln(τ / 0.8 s); without the first number k_min is K_opt, and nothing is beyond it.
    """
    paper = get_law(REFERENCE_LAW)
    span, capped = paper.k_min - paper.k_max, len(x) == 3
    above_opt, above_nominal, below_limit, log_tau = (0.0, *x) if capped else x
    nominal = paper.k_nominal + 0.1 * above_nominal * span
    corners = max(paper.k_min + above_opt * span, nominal), nominal, min(paper.k_max - below_limit * span, nominal)
    k_min, k_nominal, k_max = (min(max(float(k), _LEAST_TRIED), LARGEST_COEFFICIENT) for k in corners)
    low, high = TIME_CONSTANT_RANGE
    tau = min(max(paper.damping_time_constant_s * math.exp(log_tau), low), high)
    return TrackingLaw(name="tuned", k_min=k_min, k_nominal=k_nominal, k_max=k_max, damping_time_constant_s=tau)


def tuning_of(law: TrackingLaw) -> Tuning:
    """Return the numbers that make a law of the piecewise one."""
    paper = get_law(REFERENCE_LAW)
    away = law.k_min - paper.k_min, law.k_nominal - paper.k_nominal, paper.k_max - law.k_max
    return Tuning(*(offset / (paper.k_min - paper.k_max) for offset in away), law.damping_time_constant_s)


def tune_law(
    suite: str, capped: bool, n_scenarios: int = N_SCENARIOS, generations: int = 18, population: int = 12
) -> TrackingLaw:
    """Return the law that scores most."""
    first = int(capped)
    search = Search(np.array(_START[first:]), 0.3, population, 1, bounds=[side[first:] for side in _BOUNDS])
    with contextlib.closing(playing(suite, n_scenarios, population)) as batch:
        scenarios = batch.scenarios(batch.suite.train[:n_scenarios])

        def costs_of(points: Floats) -> Floats:
            return objectives(batch, scenarios, laws=[law_of(point) for point in points])

        return law_of(run_search(search, generations, costs_of))


def run_search(search: Search, generations: int, costs_of: Callable[[Floats], Floats]) -> Floats:
    """Return where a search ends after some generations."""
    with Progress("generations") as progress:
        for generation in range(generations):
            evaluated = search.ask()
            costs = costs_of(evaluated)
            search.tell(evaluated, costs)
            progress.update(f"objective {costs.min():.4f}", generation + 1, generations)
    return search.mean


def distilled(suite: str, teacher: str = "dagger-v1-2", n_scenarios: int = N_SCENARIOS, rounds: int = 4) -> Gains:
    """Return the numbers of distilled-law that come nearest to a policy's actions, where the law itself leads."""
    (entry,) = load_entries(teacher)
    settings, seeds = EnvSettings(suite=suite, split="train"), get_suite(suite).train[:n_scenarios]
    gains, columns, actions = None, [], []
    for _ in range(rounds):
        with started_batch(entry, settings, seeds) as (batch, _drawn), entry.policy:
            filtered, state = None, None
            for step in range(batch.n_steps_of_episode):
                running = ~np.logical_or(*batch.ended())
                answers, state = answer(entry, batch, state, step, running)
                values, filtered = terms(of_groups(batch.observations, MeasuredObservation, "k"), filtered)
                connected = running[:, np.newaxis] & (batch.simulator.wtg_values("connected") > 0.5)
                columns.append(values[connected])
                actions.append(answers[connected])
                batch.step(answers if gains is None else np.clip(values @ gains, -1.0, 1.0))
        gains = np.linalg.lstsq(np.concatenate(columns), np.concatenate(actions))[0]
    return Gains(*gains)


def tune_gains(
    suite: str, start: Gains, n_scenarios: int = 600, generations: int = 24, population: int = 8
) -> tuple[Gains, float]:
    """Return the numbers of distilled-law that score most, and what they cost in the logarithm of the score.

    The law beneath was tuned on other scenarios.
    """
    search = Search(np.array(start) / _GAIN_STEPS, 0.1, population, 1)
    played = playing(suite, n_scenarios, population, strategy="coordinated-free", action_mode="k")
    with contextlib.closing(played) as batch:
        scenarios = batch.scenarios(batch.suite.train[N_SCENARIOS : N_SCENARIOS + n_scenarios])

        def costs_of(points: Floats) -> Floats:
            policy, filtered = DistilledLaw((points * _GAIN_STEPS)[:, np.newaxis, np.newaxis]), None

            def act(seen: MeasuredObservation) -> Floats:
                nonlocal filtered
                actions, filtered = policy.act(seen, filtered)
                return actions[..., np.newaxis]

            return objectives(batch, scenarios, act=act)

        mean = run_search(search, generations, costs_of)
        return Gains(*(mean * _GAIN_STEPS)), float(costs_of(np.tile(mean, (population, 1)))[0])


if __name__ == "__main__":
    for name, capped in (("coordinated-tuned", True), ("coordinated-free", False)):
        law = tune_law("standard-v1", capped)
        print(f"{name}: " + ", ".join(f"{key} {value:.3f}" for key, value in tuning_of(law)._asdict().items()))
        print(f"k {law.k_min:.3f}, {law.k_nominal:.3f}, {law.k_max:.3f} p.u.")
    gains, cost = tune_gains("standard-v1", distilled("standard-v1"))
    print(", ".join(f"{name} {value:.3f}" for name, value in gains._asdict().items()), f"objective {cost:.4f}")
