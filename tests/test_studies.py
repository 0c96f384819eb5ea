"""The scripts of docs/studies: all of them import, and those that play do so as evaluations do."""

import dataclasses
import importlib
from pathlib import Path

import minari
import numpy as np
import pytest
from matrix import OWN, played
from minari_datasets import make_dataset
from reference import environment_page, parameters_page

from wtg_gym.evaluation import evaluate, load_entries
from wtg_gym.evaluation.faults import SENSOR_FAULTS, with_fault
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks import V1

DOCS = Path(__file__).parent.parent / "docs"
STUDIES = {path.stem for path in (DOCS / "studies").glob("*.py")}


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_every_study_finds_what_it_imports(name):
    importlib.import_module(name)


@pytest.mark.parametrize(("page", "made"), [("environment", environment_page), ("parameters", parameters_page)])
def test_the_reference_is_that_of_the_code(page, made):
    assert made().strip() in (DOCS / f"{page}.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def players():
    return [each for name in (*V1.references, "fast-droop") for each in load_entries(name)]


@pytest.fixture(scope="module")
def known(players):
    return evaluate(players, OWN, "test", seeds=list(get_suite(OWN).test[:6]))


def test_unchanged_scenarios_cost_what_they_cost_in_an_evaluation(known, players):
    assert played(players, known).episodes == known.episodes


def test_a_hanging_sensor_shows_what_it_showed_last():
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


def test_episodes_of_a_dataset_are_those_of_their_players_and_play_again_to_the_bit(tmp_path, monkeypatch):
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
