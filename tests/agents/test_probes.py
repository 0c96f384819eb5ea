"""Facts about the probes: each overdoes what it is there for."""

from __future__ import annotations

import numpy as np
import pytest

from agents.research.incentives import incentives, mean_response
from agents.research.probes import CHATTER, CHATTER_V1, CONSTANT, PUSH, PUSH_V1, STATIC, delayed
from wtg_gym.evaluation import evaluate, load_entries
from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import V0


def test_each_pays_for_what_it_overdoes() -> None:
    results = evaluate([CHATTER, PUSH, STATIC], "standard", "validation", seeds=range(10_000, 10_010))

    def mean(name: str, term: str) -> float:
        return float(np.mean([episode.metrics[f"cost_{term}"] for episode in results.episodes_of(name)]))

    assert mean("chatter", "effort") > 1.0
    assert mean("push", "duty") > 2.0 * mean("coordinated-piecewise", "duty")
    assert mean("push", "frequency") < mean("coordinated-piecewise", "frequency")
    assert mean("static", "effort") < 0.1


def test_each_pays_for_what_it_overdoes_in_v1() -> None:
    results = evaluate([CHATTER_V1, PUSH_V1], "standard-v1", seeds=range(10_000, 10_012))
    terms = {row.name: row.mean_cost_terms for row in results.summaries}
    tuned = terms["coordinated-tuned"]
    assert terms["chatter"]["effort"] > 1.0 > tuned["effort"] == 0.0
    assert terms["push"]["overload"] > 0.1 > tuned["overload"]


def test_static_correction_gives_the_k_that_captures_what_is_asked_at_rest() -> None:
    law = STRATEGIES["coordinated-piecewise"]
    observation = np.zeros((1, 18))
    observation[0, [0, 9]] = -0.2 / 0.5
    action, _ = STATIC.policy.predict(observation)
    # Half-way between the set-point, 95 %, and ω_min, 100 %.
    needed = tracking_point(0.025).coefficient - 0.5 * (law.k_min + law.k_nominal)
    assert action == pytest.approx(np.full((1, 2), needed / (V0.k_authority * (law.k_min - law.k_max))), abs=1e-4)


def test_delayed_policy_answers_the_observation_of_one_step_before() -> None:
    late, rng = delayed(STATIC), np.random.default_rng(0)
    state, seen = None, [rng.uniform(-0.5, 0.5, (3, 18)) for _ in range(4)]
    answers = []
    for observation in seen:
        action, state = late.policy.predict(observation, state=state)
        answers.append(action)
    expected = [STATIC.policy.predict(observation)[0] for observation in (seen[0], *seen[:-1])]
    assert np.array_equal(answers, expected)
    assert not np.array_equal(answers[1], answers[2])


def test_one_step_of_delay_costs_the_tuned_feedback_more_than_five_points() -> None:
    entry = load_entries("agents/policies/linear-feedback")[0]
    late = delayed(entry)
    results = evaluate([entry, late], "standard", "validation", seeds=range(10_000, 10_020))
    scores = {row.name: row.score.value for row in results.summaries}
    assert scores[late.name] < scores[entry.name] - 5.0


def test_wind_holds_a_small_part_of_the_regulating_power() -> None:
    scenario = get_suite("weak-grid").scenario(10_000)
    assert scenario.governor_droop is not None
    found = mean_response([scenario])
    assert found.governor_mw_hz == pytest.approx(615.0 / (50.0 * scenario.governor_droop))
    # 5 % of the available power over 0.4 Hz, below the wind where the pitch protection sets in.
    available = sum(float(available_power_pu(wind)) for wind in scenario.wind_speed.mean(axis=1))
    assert found.wind_mw_hz == pytest.approx(50.0 * 0.05 * available / 0.4, rel=1e-6)


def test_incentives_have_a_row_per_entry_and_suite() -> None:
    text = incentives([CONSTANT, PUSH], "validation", 2)
    for suite in ("standard", "weak-grid", "low-wind", "gust"):
        for name in ("constant", "push", "coordinated-piecewise"):
            assert f"| {suite} | {name} |" in text
    assert "2 validation scenarios" in text
    with pytest.raises(ValueError, match="outside the allowed range 1 … 100"):
        incentives([CONSTANT], "validation", 101)
