"""Facts about the probes: each overdoes what it is there for."""

from __future__ import annotations

import numpy as np
import pytest

from agents.probes import CHATTER, PUSH, STATIC
from wtg_gym.envs.task import COEFFICIENT_AUTHORITY
from wtg_gym.evaluation import evaluate
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.tracking_law import STRATEGIES


def test_each_pays_for_what_it_overdoes() -> None:
    results = evaluate([CHATTER, PUSH, STATIC], "standard", "validation", seeds=range(10_000, 10_010))

    def mean(name: str, term: str) -> float:
        return float(np.mean([episode.metrics[f"cost_{term}"] for episode in results.episodes_of(name)]))

    assert mean("chatter", "effort") > 1.0
    assert mean("push", "duty") > 2.0 * mean("coordinated-piecewise", "duty")
    assert mean("push", "frequency") < mean("coordinated-piecewise", "frequency")
    assert mean("static", "effort") < 0.1


def test_static_correction_gives_the_k_that_captures_what_is_asked_at_rest() -> None:
    law = STRATEGIES["coordinated-piecewise"]
    observation = np.zeros((1, 18))
    observation[0, [0, 9]] = -0.2 / 0.5
    action, _ = STATIC.policy.predict(observation)
    # Half-way between the set-point, 95 %, and ω_min, 100 %.
    needed = tracking_point(0.025).coefficient - 0.5 * (law.k_min + law.k_nominal)
    assert action == pytest.approx(
        np.full((1, 2), needed / (COEFFICIENT_AUTHORITY * (law.k_min - law.k_max))), abs=1e-4
    )
