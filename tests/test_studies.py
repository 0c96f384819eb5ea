"""The scripts of docs/studies: all of them import, and those that play do so as evaluations do."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import minari
import numpy as np
import pytest
from matrix import CHANGES, OWN, played, section, with_faults, without_governor
from minari_datasets import make_dataset
from policies import Population, law_of, tune_law, tune_mean_droop, tuning_of
from reference import environment_page, parameters_page

from wtg_gym.evaluation import Results, evaluate, load_entries
from wtg_gym.evaluation.faults import SENSOR_FAULTS, with_fault
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.tracking_law import TUNED, get_law
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks import V1

DOCS = Path(__file__).parent.parent / "docs"
STUDIES = {path.stem for path in (DOCS / "studies").glob("*.py")}


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_every_study_finds_what_it_imports(name: str) -> None:
    importlib.import_module(name)


@pytest.mark.parametrize(("page", "made"), [("environment", environment_page), ("parameters", parameters_page)])
def test_the_reference_is_that_of_the_code(page: str, made: Callable[[], str]) -> None:
    assert made().strip() in (DOCS / f"{page}.md").read_text(encoding="utf-8")


def test_points_of_a_search_are_laws_and_laws_are_tunings() -> None:
    for name, tuning in TUNED.items():
        law = get_law(name)
        point = np.array([tuning[0], 10.0 * tuning[1], tuning[2], np.log(tuning.time_constant_s / 0.8)])
        assert tuning_of(law) == pytest.approx(tuning, abs=1e-12)
        assert tuning_of(law_of(point)) == pytest.approx(tuning, abs=1e-3)
    # Three numbers: k ends at K_opt.
    capped = law_of(np.array([0.8, 0.0, 0.0]))
    assert capped.k_min == tracking_point(0.0).coefficient > capped.k_nominal > capped.k_max


def test_the_objective_of_a_search_is_the_logarithm_of_cost_and_offset() -> None:
    n_scenarios, laws = 6, [get_law("coordinated-tuned"), get_law("coordinated-free")]
    with Population(OWN, n_scenarios, len(laws), duration_s=12.0) as candidates:
        objectives, lanes = candidates.objectives(laws), candidates.lanes
        costs = lanes.cost_sums().sum(axis=1).reshape(len(laws), n_scenarios)
        offsets = dict(V1.cost_offsets)
        strata = [lanes.suite.stratum(seed) for seed in lanes.suite.train[:n_scenarios]]
    wanted = [[np.log(cost + offsets[s]) for cost, s in zip(row, strata, strict=True)] for row in costs]
    assert objectives == pytest.approx(np.mean(wanted, axis=1), rel=1e-12) and objectives[0] != objectives[1]


def test_searches_for_laws_and_numbers_run() -> None:
    quick = {"n_scenarios": 3, "generations": 1, "population": 4}
    best = tracking_point(0.0).coefficient
    assert tune_law(OWN, True, **quick).k_min == best < tune_law(OWN, False, **quick).k_min
    policy, cost = tune_mean_droop(OWN, **quick)
    assert policy.full_action_hz > 0.0 and np.isfinite(cost)


@pytest.fixture(scope="module")
def players() -> list[Any]:
    return [each for name in (*V1.references, "fast-droop") for each in load_entries(name)]


@pytest.fixture(scope="module")
def known(players: list[Any]) -> Results:
    return evaluate(players, OWN, "test", seeds=list(get_suite(OWN).test[:6]))


def test_unchanged_scenarios_cost_what_they_cost_in_an_evaluation(known: Results, players: list[Any]) -> None:
    assert played(players, known).episodes == known.episodes


def test_a_hanging_sensor_shows_what_it_showed_last() -> None:
    seen = []

    class Watching:
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            seen.append(observation)
            return np.zeros((len(observation), 4)), (state or 0) + 1

    entry = dataclasses.replace(load_entries("fast-droop")[0], policy=Watching())
    for fault, since in SENSOR_FAULTS.values():
        policy, state = with_fault(entry, fault, since).policy, None
        shown = np.random.default_rng(0).normal(size=(since + 2, 1, 28))
        seen.clear()
        for row in shown:
            _, state = policy.predict(row, state=state)
        assert (np.array(seen)[:since] == shown[:since]).all() and state[2] == since + 2
        assert (seen[-1][:, 7:] == shown[-1][:, 7:]).all()
        assert seen[-1][0, 0] == (shown[since, 0, 0] if fault.__name__ == "hanging" else 0.0)


def test_the_matrix_has_a_column_for_every_change_and_fault(known: Results, players: list[Any]) -> None:
    results = with_faults(players, known)
    assert set(results) == {*CHANGES, *SENSOR_FAULTS}
    laws = {name: {key: own.pinned_costs[name] for key, own in results.items()} for name in V1.anchors}
    assert all((laws[name]["delay +0.5 s"] == laws[name]["wind bias × 4"]).all() for name in laws)
    assert (laws["coordinated-tuned"]["no governor"] != laws["coordinated-tuned"]["delay +0.5 s"]).any()
    assert "| fast-droop |" in section({OWN: known}, results)


def test_without_governor_no_scenario_has_one_lost_later() -> None:
    suite = get_suite(OWN)
    events = [event for seed in suite.validation[:15] for event in without_governor(suite.scenario(seed)).events]
    assert [event.time_s for event in events if type(event).__name__ == "GovernorLoss"] == [0.0] * 15


def test_episodes_of_a_dataset_are_those_of_their_players_and_play_again_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    make_dataset("v1", "mixed", 3)
    with pytest.raises(ValueError, match="is there already"):
        make_dataset("v1", "mixed", 3)
    dataset = minari.load_dataset("gfmwtg/v1/mixed-v0")
    episodes, env = list(dataset.iterate_episodes()), dataset.recover_environment()
    assert [bool(np.abs(each.actions).max()) for each in episodes] == [False, True, True]
    for seed, episode in enumerate(episodes):
        assert all(int(own) in get_suite("standard-v1").train for own in episode.infos["scenario_seed"])
        observation, _ = env.reset(seed=seed)
        assert np.array_equal(observation, episode.observations[0])
        for action, expected, reward in zip(episode.actions, episode.observations[1:], episode.rewards, strict=True):
            observation, earned, *_ = env.step(action)
            assert np.array_equal(observation, expected) and earned == reward
