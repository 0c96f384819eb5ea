"""What docs/studies tunes and plans with: candidates play as entries do."""

from __future__ import annotations

import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cma")

from commissioning import aftermath, statics, worst_events
from gradient_law import LawLoss
from policies import FEEDBACKS, law_of, tune_feedback, tune_law, tune_mean_droop, tuning_of, write_feedback
from rollouts import Rollouts, history_feedback, linear_feedback

from agents.gains import stratum_scales
from wtg_gym.evaluation import evaluate, load_entries
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.tracking_law import TUNED, get_law, tuned
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import V1

#: But for the one that needs ANDES, which has an environment of its own.
STUDIES = {path.stem for path in (Path(__file__).parent.parent / "docs/studies").glob("*.py")} - {"make_andes_cases"}
SUITE, SEEDS = "standard-v1", [10_000, 10_001, 10_002]
LINEAR, LINEAR_V1, HISTORY_V1 = FEEDBACKS


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_every_study_finds_what_it_imports(name: str) -> None:
    importlib.import_module(name)


@pytest.mark.parametrize("how", [LINEAR, HISTORY_V1], ids=lambda how: how.folder)
def test_a_feedback_costs_the_same_in_the_search_and_as_a_file(how: object, tmp_path: Path) -> None:
    quick = dataclasses.replace(how, n_scenarios=2, generations=1, population=4)  # type: ignore[type-var]
    gains, n_wtg = tune_feedback(quick)
    gains = np.random.default_rng(0).normal(0.0, 0.2, gains.shape)
    write_feedback(quick, gains, n_wtg, tmp_path / "entry")
    (entry,) = load_entries(tmp_path / "entry")
    own = Rollouts(quick.suite, "validation", SEEDS, 1, strategy=quick.strategy, duration_s=12.0)
    act = history_feedback(gains, own.lanes.settings.control_dt) if quick.history else linear_feedback(gains)
    played = evaluate([entry], quick.suite, "validation", seeds=SEEDS, duration_s=12.0).pinned_costs[entry.name][0]
    # The file counts in single precision.
    assert own.pinned(own.play(act))[:, 0] == pytest.approx(played, rel=1e-3)
    assert played != pytest.approx(own.pinned(own.reference()), rel=1e-2)


def test_the_gradient_of_laws_is_that_of_other_laws_with_their_own_starts() -> None:
    loss = LawLoss("standard", 2)
    points = np.array([[1.0, 0.68, 0.55, -0.3], [1.05, 0.66, 0.5, 0.1]])
    seeds = [1_000_000, 1_000_001]
    _, gradient = loss(points, seeds)
    scenarios = loss.tape.lanes.scenarios(seeds)
    for place in np.ndindex(points.shape):
        step = np.zeros_like(points)
        step[place] = 1e-5
        ends = [loss._loss(loss.laws(points + sign * step), scenarios) for sign in (1.0, -1.0)]
        assert gradient[place] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3, abs=1e-5), place


@pytest.fixture
def v1_by_means(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(vars(V1), "scores_mean", True)


def test_points_of_a_search_are_laws_and_laws_are_tunings() -> None:
    for name, tuning in TUNED.items():
        law = tuned(name)
        point = np.array([*tuning[:3], np.log(tuning.time_constant_s / 0.8)])
        assert tuning_of(law) == pytest.approx(tuning, abs=1e-12)
        assert tuning_of(law_of(point)) == pytest.approx(tuning, abs=1e-3)
    # Three numbers: nothing is beyond K_opt, however far above K_n the point lies.
    capped = law_of(np.array([5.0, 0.0, 0.0]))
    assert capped.k_min == capped.k_nominal == tracking_point(0.0).coefficient >= capped.k_max


def test_the_objective_of_v1_is_the_cost_in_scales_of_the_stratum(v1_by_means: None) -> None:
    seeds = list(get_suite(SUITE).train[:6])
    own = Rollouts(SUITE, "train", seeds, 1, duration_s=12.0)
    terms = own.play()
    scales = stratum_scales(own.lanes.settings)
    wanted = [cost / scales[own.lanes.suite.stratum(seed)] for cost, seed in zip(own.pinned(terms), seeds, strict=True)]
    assert own.objective(terms) == pytest.approx(np.array(wanted), rel=1e-12)
    own.scales = dict.fromkeys(scales, 2.0)
    assert own.objective(terms) == pytest.approx(own.pinned(terms) / 2.0, rel=1e-12)


def test_searches_for_laws_and_numbers_run(v1_by_means: None) -> None:
    quick = {"n_scenarios": 3, "generations": 1, "population": 4}
    best = tracking_point(0.0).coefficient
    assert tune_law(SUITE, True, **quick).k_min == best < tune_law(SUITE, False, **quick).k_min
    policy, cost = tune_mean_droop(SUITE, **quick)
    assert policy.full_action_hz > 0.0 and np.isfinite(cost)


def test_commissioning_finds_a_power_that_falls_with_the_frequency() -> None:
    plant = get_suite(SUITE).plant.settings(classical=False, trips_groups=True)
    capped, free = (statics(get_law(name), plant, (10.0,)) for name in ("coordinated-tuned", "coordinated-free"))
    assert capped.steepest <= 1e-6 and capped.capped and capped.within
    assert free.steepest > 0.01 and not free.capped
    # Plain droop: the rotor slows down without an end.
    assert np.isinf(statics(get_law("deloaded-10"), plant, (13.0,)).steepest)


def test_aftermath_of_an_event() -> None:
    events = next(iter(worst_events().values()))
    found = aftermath(get_law("coordinated-tuned"), events, duration_s=20.0)
    assert found.lowest_hz < 49.8 and found.lowest_hz <= found.final_hz[0] <= found.final_hz[1] < 50.5
    calm = aftermath(get_law("coordinated-tuned"), (), duration_s=20.0)
    assert calm.final_hz == pytest.approx((50.0, 50.0), abs=1e-6)
