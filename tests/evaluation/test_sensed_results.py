"""Results of version v1 say what the policies saw."""

from __future__ import annotations

import json

from wtg_gym import evaluate
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.evaluator import shared_settings
from wtg_gym.evaluation.recompute import departures, recompute

SHORT = {"seeds": range(10_000, 10_002), "duration_s": 2.0, "n_threads": 1}
SLOW = {"delay_s": [0.5, 0.5]}


def test_results_with_other_sensors_depart_from_the_benchmark_and_are_computed_again_with_them() -> None:
    own, exact, slow = (
        evaluate([], "standard-v1", "validation", **SHORT, sensors=sensors) for sensors in (None, "exact", SLOW)
    )
    assert not any(text.startswith("sensors") for text in departures(own))
    assert any(
        text.startswith("sensors is exact, that of the benchmark {'delay_s': [0.1") for text in departures(exact)
    )
    assert any(text.startswith("sensors is {'delay_s': [0.5") for text in departures(slow))
    for results in (own, exact, slow):
        assert json.loads(json.dumps(results.settings)) == results.settings
        assert recompute(results, [], n_threads=1).differences == []


def test_parts_of_an_evaluation_with_other_sensors_are_not_taken_for_ones_own() -> None:
    settings = [shared_settings(EnvSettings(suite="standard-v1", sensors=own)) for own in (None, "exact", {}, SLOW)]
    assert settings[0] == settings[2] and settings[0] != settings[1] != settings[3] != settings[0]
    # Those of version v0 keep their form.
    assert "sensors" not in shared_settings(EnvSettings(suite="standard"))
