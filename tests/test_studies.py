"""Studies import, play as evaluations do and reproduce the paper; operators' tests; modes with an entry in the loop."""

import dataclasses
import functools
import importlib
import re
from pathlib import Path

import minari
import numpy as np
import paper
import performance
import pytest
from matrix import OWN, played
from minari_datasets import make_dataset
from reference import environment_page, laws, parameters_page

from docs.studies.small_signal import linearise
from wtg_gym import Scenario, evaluate, get_suite, load_entries, simulate
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.damping import POINT, SLOPES, Loop, damping
from wtg_gym.evaluation.faults import SENSOR_FAULTS, with_fault
from wtg_gym.evaluation.grid_tests import GRID_TESTS, SOURCES, Recording, _longest_beyond, run_grid_test
from wtg_gym.physics.parameters import PitchParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import LAWS
from wtg_gym.tasks import V1

DOCS = Path(__file__).resolve().parent.parent / "docs"
STUDIES = {path.stem for path in (DOCS / "studies").glob("*.py")}
#: By how much they move the power of all groups [p.u.].
ANGLE_STEPS = {"angle-step": 0.181, "angle-step-30": 0.511, "angle-step-forward": -0.54}
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


def test_unchanged_scenarios_cost_what_they_cost_in_an_evaluation():
    players = [each for name in (*V1.references, "fast-droop") for each in load_entries(name)]
    known = evaluate(players, OWN, "test", seeds=list(get_suite(OWN).test[:6]))
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
    run = simulate(Scenario(name="x", wind_speed=np.array([[wind], [8.0]]), duration_s=5.0), LAWS[strategy])
    pitch, k = PitchParameters(), LAWS[strategy].k_nominal
    limits = pitch.rotor_speed_limit_pu, (pitch.captured_power_limit_pu / k) ** (1.0 / 3.0)
    speed = min(paper.equilibria(1.0, LAWS[strategy], wind)[-1].rotor_speed_pu, *limits)
    assert run.rotor_speed_pu[-1, 0] == pytest.approx(speed, abs=1e-8)
    assert run.power_pu[-1, 0] == pytest.approx(k * speed**3, abs=1e-8)


#: The runs of the case studies, played once.
run_case = functools.cache(paper.run_case)


@pytest.fixture(scope="module")
def claims():
    return {claim["key"]: claim for claim in paper.paper_claims(run_case(0), run_case(1))}


def test_every_claim_holds_but_the_one_that_the_paper_drew_schematically(claims):
    assert len(claims) == 30
    assert {key for key, claim in claims.items() if not claim["holds"]} == {"high-deloading-high-wind"}
    assert all(claim["measured"] for claim in claims.values())
    assert claims["high-deloading-high-wind"]["remark"]


def test_claims_are_measured_not_written():
    """Exchange the runs of two strategies: the claims about them fall."""
    runs = run_case(0)
    exchanged = {"coordinated-piecewise": runs["deloaded-5"], "deloaded-5": runs["coordinated-piecewise"]}
    fallen = {claim["key"] for claim in paper.load_increase(runs | exchanged) if not claim["holds"]}
    assert fallen >= {"stays-stable", "stalls", "larger-step", "faster-rotor", "rocof", "nadir", "narrow-range"}


def test_the_pages_claims_and_figures_are_the_studys(claims, tmp_path):
    page = (DOCS / "validation.md").read_text(encoding="utf-8")
    assert all(claim["measured"] in page for key, claim in claims.items() if key not in LAST_DIGITS)
    paper.draw([run_case(seed) for seed in range(2)], tmp_path)
    figures = {path.name for path in tmp_path.iterdir()}
    assert figures == set(re.findall(r"\(validation/figures/([\w-]+\.svg)\)", page))


#: Continuous models know no secondary control, which acts at every simulation step.
PLANT = {"secondary_time_s": 0.0}


def outcome(name: str, law: str) -> tuple[Recording, bool]:
    result, (passed, _) = run_grid_test(GRID_TESTS[name], load_entries(law)[0])
    return result, passed


def test_every_test_says_where_it_comes_from():
    assert all(set(test.source.split(", ")) <= set(SOURCES) for test in GRID_TESTS.values())


def test_a_law_that_sheds_power_survives_a_surplus_and_one_that_cannot_does_not():
    result, passed = outcome("island-surplus", "mppt")
    assert passed and result.status is Status.RUNNING and result.shed_energy_mws[-1] == 0.0
    result, passed = outcome("island-surplus", "coordinated-piecewise")
    assert not passed and result.status is Status.FREQUENCY_LIMIT and result.frequency_hz[-1] > 51.4


def test_a_source_drags_the_groups_to_its_frequency_and_back():
    result, passed = outcome("rocof-up", "coordinated-tuned")
    assert passed
    # The ramp ends at 2.25 s, its way back begins at 7.25 s; in between the groups swing about its frequency.
    assert result.frequency_hz[result.at(4.0) : result.at(7.2) + 1].mean() == pytest.approx(51.0, abs=0.01)
    assert result.frequency_hz[-1] == pytest.approx(50.0, abs=0.01)


@pytest.mark.parametrize(("name", "power"), ANGLE_STEPS.items())
def test_an_angle_step_is_measured_one_simulation_step_after_it(name, power):
    result, _ = outcome(name, "coordinated-piecewise")
    total, before = result.total(), result.at(2.0)
    assert result.time_s[before + 1] == pytest.approx(2.025)
    assert total[before + 1] - total[before] == pytest.approx(power, abs=0.005)


def test_the_last_machine_is_lost_in_balance_and_with_more_load_than_the_groups_can_carry():
    balanced, passed = outcome("last-machine-balance", "coordinated-piecewise")
    assert passed and np.ptp(balanced.frequency_hz) < 0.2 and balanced.shed_energy_mws[-1] == 0.0
    loaded, passed = outcome("last-machine-limit", "coordinated-piecewise")
    assert passed and loaded.shed_energy_mws[-1] > 0.0 and loaded.total()[0] == pytest.approx(0.9975, abs=1e-3)


def test_the_current_limit_is_reached_held_and_left_and_a_voltage_above_the_curve_fails_at_any_bus():
    result, passed = outcome("current-limit", "coordinated-tuned")
    assert passed and 1.2 < result.bus_voltage_pu.max() < 1.25
    assert result.current_pu.max() == pytest.approx(1.2, abs=1e-6)
    assert result.limited.any() and not result.limited[result.at(3.0) :].any()
    voltage = result.bus_voltage_pu.copy()
    voltage[result.at(5.0) : result.at(8.0), 0] = 1.21
    above = dataclasses.replace(result, bus_voltage_pu=voltage)
    assert GRID_TESTS["current-limit"].verdict(above) == (False, "above 1.2 p.u. for 3.0 s")


def test_the_time_beyond_a_limit_is_that_of_the_longest_stretch():
    beyond = np.array([[0, 1, 1, 1, 0, 1, 1, 0], [0, 0, 0, 0, 0, 0, 0, 1]], dtype=bool).T
    assert _longest_beyond(0.1 * np.arange(8.0), beyond) == pytest.approx(0.3)


@pytest.mark.parametrize(("law", "wind_m_s"), [("deloaded-10", 10.0), ("coordinated-tuned", 11.0)])
def test_a_law_alone_has_the_modes_of_the_linearised_plant(law, wind_m_s):
    entry, plant = load_entries(law)[0], EnvSettings(suite="standard-v1", plant=PLANT).resolved_plant
    result, step_s = damping(entry, PLANT, {"wind_m_s": wind_m_s}), plant.simulation_dt
    scenario = Loop(entry, PLANT, {**POINT, "wind_m_s": wind_m_s}).scenario
    assert result.rest.is_reached and result.rest.largest_action == 0.0 and result.largest_rate < 0.0
    for slope, side in zip(SLOPES, ("under", "over"), strict=True):
        if not (seen := np.array([mode.eigenvalue for mode in result.modes if mode.slope in (slope, "both")])).size:
            continue
        linear = np.linalg.eigvals(linearise(scenario, entry.law, plant, side))
        steps = step_s * np.array([value for value in linear if value.imag > 0.0 and value.real > -9.0])
        # What a step of the classical Runge-Kutta method makes of a mode.
        simulated = np.log(1.0 + steps + steps**2 / 2.0 + steps**3 / 6.0 + steps**4 / 24.0) / step_s
        assert len(simulated) >= 10
        assert np.abs(seen[:, np.newaxis] - simulated).min(axis=0).max() < 1e-6
        # Beyond the integrator's own error they are those of the plant.
        assert np.abs(seen[:, np.newaxis] - steps / step_s).min(axis=0).max() < 1e-3


def test_a_policy_moves_the_modes_of_its_law():
    policy = load_entries("fast-droop")[0]
    result, alone = damping(policy), damping(load_entries(policy.law.name)[0])
    assert result.rest.is_reached and result.rest.largest_action < 1e-3
    assert result.modes[0].damping_ratio < alone.modes[0].damping_ratio - 0.02
