"""The scripts of docs/studies: all of them import, play as evaluations do, and reproduce the paper."""

import dataclasses
import importlib
import json
from pathlib import Path

import minari
import numpy as np
import paper
import performance
import pytest
from matrix import OWN, played
from minari_datasets import make_dataset
from reference import environment_page, laws, parameters_page

from wtg_gym import Scenario, evaluate, get_suite, load_entries, simulate
from wtg_gym.evaluation.faults import SENSOR_FAULTS, with_fault
from wtg_gym.physics.parameters import PitchParameters
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.tasks import V1

DOCS = Path(__file__).resolve().parent.parent / "docs"
STUDIES = {path.stem for path in (DOCS / "studies").glob("*.py")}
#: Claims whose numbers are rounding.
LAST_DIGITS = {"coordination", "compatible", "stays-stable"}


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_every_study_finds_what_it_imports(name):
    importlib.import_module(name)


@pytest.mark.parametrize("suite", ["standard", "standard-v1", "ieee39-v1"])
def test_batches_that_are_timed_step(suite):
    step, n_envs, step_s = performance.vector(suite, 2)
    assert len(step()[1]) == n_envs == 2 and step_s == (0.1 if suite == "standard" else 0.5)


PAGES_OF_CODE = [("environment", environment_page), ("parameters", parameters_page), ("benchmark", laws)]


@pytest.mark.parametrize(("page", "made"), PAGES_OF_CODE)
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


@pytest.mark.parametrize("wind", [8.0, 13.0, 20.0])
@pytest.mark.parametrize("strategy", ["mppt", "coordinated-piecewise"])
def test_simulation_starts_in_the_stable_equilibrium(wind, strategy):
    """At 13 and 20 m/s the pitch protection holds the rotor where captured power or rotor speed reaches its limit."""
    run = simulate(Scenario(name="x", wind_speed=np.array([[wind], [8.0]]), duration_s=5.0), STRATEGIES[strategy])
    pitch, k = PitchParameters(), STRATEGIES[strategy].k_nominal
    limits = pitch.rotor_speed_limit_pu, (pitch.captured_power_limit_pu / k) ** (1.0 / 3.0)
    speed = min(paper.equilibria(1.0, STRATEGIES[strategy], wind)[-1].rotor_speed_pu, *limits)
    assert run.rotor_speed_pu[-1, 0] == pytest.approx(speed, abs=1e-8)
    assert run.power_pu[-1, 0] == pytest.approx(k * speed**3, abs=1e-8)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("docs")
    paper.main(folder)
    return folder / "validation"


def test_every_claim_holds_but_the_one_that_the_paper_drew_schematically(written):
    text = (written / "claims.json").read_text(encoding="utf-8")
    claims = {claim["key"]: claim for claim in json.loads(text)["claims"]}
    assert len(claims) == 30
    assert {key for key, claim in claims.items() if not claim["holds"]} == {"high-deloading-high-wind"}
    assert all(claim["values"] and claim["measured"] for claim in claims.values())
    assert claims["high-deloading-high-wind"]["remark"]


def test_claims_are_measured_not_written():
    """Exchange the runs of two strategies: the claims about them fall."""
    runs = paper.run_case(0)
    exchanged = {"coordinated-piecewise": runs["deloaded-5"], "deloaded-5": runs["coordinated-piecewise"]}
    fallen = {claim["key"] for claim in paper.load_increase(runs | exchanged) if not claim["holds"]}
    assert fallen >= {"stays-stable", "stalls", "larger-step", "faster-rotor", "rocof", "nadir", "narrow-range"}


def test_the_pages_claims_and_figures_are_the_studys(written):
    claims = json.loads((written / "claims.json").read_text(encoding="utf-8"))["claims"]
    page = (DOCS / "validation.md").read_text(encoding="utf-8")
    assert all(claim["measured"] in page for claim in claims if claim["key"] not in LAST_DIGITS)
    figures = {path.name for path in (written / "figures").iterdir()}
    assert len(figures) == 2 and all(f"validation/figures/{name}" in page for name in figures)
