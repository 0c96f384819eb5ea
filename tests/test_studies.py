"""What docs/studies tunes and plans with: candidates play as entries do."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cma")

from changed import longer, played, without_governor
from commissioning import aftermath, statics, worst_events
from conditions import (
    Size,
    all_entries,
    by_name,
    changed_pairs,
    conditions,
    first,
    mean_and_error,
    operator,
    points,
    slope,
    strata,
)
from matrix import CHANGES, FAULTS, section, with_fault, with_faults
from planner import Planning
from policies import law_of, tune_law, tune_mean_droop, tuning_of
from reference import environment_page, parameters_page
from rollouts import Rollouts

from wtg_gym.evaluation import Results, evaluate, load_entries
from wtg_gym.gains import stratum_scales
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.tracking_law import TUNED, get_law, tuned
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import V1

DOCS = Path(__file__).parent.parent / "docs"
STUDIES = {path.stem for path in (DOCS / "studies").glob("*.py")}
SUITE, SEEDS = "standard-v1", [10_000, 10_001, 10_002]


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_every_study_finds_what_it_imports(name: str) -> None:
    importlib.import_module(name)


@pytest.mark.parametrize(("page", "made"), [("environment", environment_page), ("parameters", parameters_page)])
def test_the_reference_is_that_of_the_code(page: str, made: Callable[[], str]) -> None:
    assert made().strip() in (DOCS / f"{page}.md").read_text(encoding="utf-8")


def test_points_of_a_search_are_laws_and_laws_are_tunings() -> None:
    for name, tuning in TUNED.items():
        law = tuned(name)
        point = np.array([tuning[0], 10.0 * tuning[1], tuning[2], np.log(tuning.time_constant_s / 0.8)])
        assert tuning_of(law) == pytest.approx(tuning, abs=1e-12)
        assert tuning_of(law_of(point)) == pytest.approx(tuning, abs=1e-3)
    # Three numbers: k ends at K_opt.
    capped = law_of(np.array([0.8, 0.0, 0.0]))
    assert capped.k_min == tracking_point(0.0).coefficient > capped.k_nominal > capped.k_max


def test_the_objective_of_v1_is_the_logarithm_in_scales_of_the_stratum() -> None:
    seeds = list(get_suite(SUITE).train[:6])
    own = Rollouts(SUITE, "train", seeds, 1, duration_s=12.0)
    terms, scales = own.play(), stratum_scales(own.lanes.settings)
    wanted = []
    for cost, seed in zip(own.pinned(terms)[:, 0], seeds, strict=True):
        stratum = own.lanes.suite.stratum(seed)
        wanted.append(np.log(cost + dict(V1.cost_offsets)[stratum]) / scales[stratum])
    assert own.objective(terms)[:, 0] == pytest.approx(wanted, rel=1e-12)


def test_searches_for_laws_and_numbers_run() -> None:
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


#: Five of each stratum.
VALIDATION = list(range(10_000, 10_015))


@pytest.fixture(scope="module")
def known() -> Results:
    return evaluate(["coordinated-tuned", "fast-droop"], SUITE, "validation", seeds=VALIDATION)


@pytest.fixture(scope="module")
def players() -> list[Any]:
    return [each for name in (*V1.anchors, "fast-droop") for each in load_entries(name)]


def test_unchanged_scenarios_cost_what_they_cost_in_an_evaluation(known: Results, players: list[Any]) -> None:
    found = played(players, SUITE, "validation", VALIDATION)
    for name, costs in found.pinned_costs.items():
        assert (costs == known.pinned_costs[name]).all()


def test_conditions_see_an_entry_that_pays_less_for_larger_deviations(known: Results) -> None:
    assert operator(known).met and slope(by_name(known)).met

    def spoilt(episode: Any) -> Any:
        worse = {"cost": 0.5 * episode.metrics["cost"], "nadir_hz": 49.1}
        return dataclasses.replace(episode, metrics={**episode.metrics, **worse})

    own = tuple(spoilt(each) if each.entry == "fast-droop" else each for each in known.episodes)
    wrong = dataclasses.replace(known, episodes=own)
    assert not operator(wrong).met and "fast-droop (100.0 %) above" in operator(wrong).measured
    assert not slope(by_name(wrong)).met


def test_pairs_that_change_places_are_found(known: Results) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.1, (4, len(known.seeds)))
    before, after = {"a": noise[0] + 1.0, "b": noise[1]}, {"a": noise[2] - 1.0, "b": noise[3]}
    assert len(changed_pairs(before, after, known)) == 1
    assert not changed_pairs(before, before, known) and not changed_pairs(
        before, {**before, "a": noise[2] + 0.5}, known
    )


def test_longer_scenarios_begin_as_they_were_and_cost_more(known: Results, players: list[Any]) -> None:
    scenario = get_suite(SUITE).scenario(VALIDATION[0])
    more = longer(scenario)
    n = scenario.wind_speed.shape[1]
    assert more.wind_speed.shape[1] == n + 600 and (more.wind_speed[:, :n] == scenario.wind_speed).all()
    # Back and forth, without a jump.
    assert (more.wind_speed[:, n : n + 500] == scenario.wind_speed[:, -2:-502:-1]).all()
    found = played(players, SUITE, "validation", VALIDATION, change=longer)
    for name, costs in found.pinned_costs.items():
        lost = np.array([episode.failed for episode in known.episodes_of(name)])
        assert (costs[0] > known.pinned_costs[name][0]).all()
        assert costs[0, lost] == pytest.approx(250.0 * 241.0)


def test_the_centre_of_inertia_costs_less_than_the_worst_unit(known: Results, players: list[Any]) -> None:
    found = played(players, SUITE, "validation", VALIDATION, by_centre=True)
    for name, costs in found.pinned_costs.items():
        assert (costs <= known.pinned_costs[name] + 1e-9).all() and costs.mean() < known.pinned_costs[name].mean()


def test_points_of_scenarios_add_up_to_scores(known: Results) -> None:
    for name, own in points(known.pinned_costs, known).items():
        assert mean_and_error(own, known)[0] == pytest.approx(known.scores[name].value, abs=1e-9)
    assert first(known, 3).seeds == tuple(VALIDATION[:3]) and len(first(known, 3).episodes) == 9


def test_a_hanging_sensor_shows_what_it_showed_last() -> None:
    seen = []

    class Watching:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            seen.append(observation)
            return np.zeros((len(observation), 4)), (state or 0) + 1

    entry = dataclasses.replace(load_entries("fast-droop")[0], policy=Watching())
    for fault, since in FAULTS.values():
        policy, state = with_fault(entry, fault, since).policy, None
        shown = np.random.default_rng(0).normal(size=(since + 2, 1, 28))
        seen.clear()
        for row in shown:
            _, state = policy.predict(row, state=state)
        assert (np.array(seen)[:since] == shown[:since]).all() and state[2] == since + 2
        assert (seen[-1][:, 7:] == shown[-1][:, 7:]).all()
        assert seen[-1][0, 0] == (shown[since, 0, 0] if fault.__name__ == "hanging" else 0.0)


def test_the_matrix_names_lost_marks(players: list[Any]) -> None:
    test = list(get_suite(SUITE).test[:6])
    found = with_faults(players, test)
    assert set(found) == {*CHANGES, *FAULTS}
    laws = {name: {key: own.pinned_costs[name] for key, own in found.items()} for name in V1.anchors}
    assert all((laws[name]["delay +0.5 s"] == laws[name]["wind bias × 4"]).all() for name in laws)
    assert (laws["coordinated-tuned"]["no governor"] != laws["coordinated-tuned"]["delay +0.5 s"]).any()
    assert "| fast-droop |" in section({SUITE: found["delay +0.5 s"]}, found)


def test_without_governor_no_scenario_has_one_lost_later() -> None:
    lost = [event for seed in VALIDATION for event in without_governor(get_suite(SUITE).scenario(seed)).events]
    assert [event.time_s for event in lost if type(event).__name__ == "GovernorLoss"] == [0.0] * len(VALIDATION)


def test_all_conditions_are_measured_without_any_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("conditions.PARTIAL", tmp_path)
    quick = Planning(horizon_s=3.0, population=8, generations=1)
    n = 15
    size = Size(
        n_scenarios=n, n_searched=n, n_sieved=n, every=100, n_parts=n, n_test=n, n_fresh=n,
        generations=1, planning=quick, aftermath_s=10.0,
    )  # fmt: skip
    found, ranked, searched = conditions(all_entries()._replace(feedbacks=[], agents=[]), size)
    assert [each.letter for each in found] == list("abcdefghijklmno")
    assert next(each for each in found if each.letter == "e").met is None
    assert {"planner-exact", "planner-measured"} <= set(searched.pinned_costs)
    assert strata(ranked).count("\n") == 4 and "| extreme |" in strata(ranked)
