"""Parameters found from records: the Jacobian, true values recovered, and intervals that hold them."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.cli.calls import error_of, json_of
from tests.golden_cases import GOLDEN
from wtg_gym.analysis.estimation_study import UNKNOWNS, Noise, study_recorded_run
from wtg_gym.cli import main
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.gradients.estimator import Estimator, covered, estimates, unknown_of
from wtg_gym.gradients.jacobian import Responses
from wtg_gym.physics.scenario import GovernorLoss, LoadStep, Scenario

Floats = npt.NDArray[np.float64]
STEP = LoadStep(time_s=0.5, bus=4, power_mw=60.0)
SCENARIO = Scenario(name="step", wind_speed=np.array([[8.0], [9.0]]), events=(STEP,), duration_s=20.0)
SETTINGS = EnvSettings(scenario=SCENARIO, version="v0")
PLANT = SETTINGS.plant()
RECORDED = ("--recorded", str(GOLDEN / "grid-forming" / "params.json"), str(GOLDEN / "grid-forming" / "a.csv"))


@functools.cache
def estimator(n_steps: int = 60) -> Estimator:
    return Estimator(SETTINGS, SCENARIO, [unknown_of(PLANT, name) for name in UNKNOWNS], range(n_steps), n_threads=1)


def test_the_jacobian_of_a_run_is_that_of_central_differences() -> None:
    names = ("machines.1.two_h_s", "control.droop_gain_pu", "machines.1.governor.droop_pu")
    lost = Scenario(
        name="lost", wind_speed=SCENARIO.wind_speed, events=(STEP, GovernorLoss(time_s=2.05, bus=1)), duration_s=20.0
    )
    responses = Responses(SETTINGS, names, 1)
    given, found = responses.tape.parameter_values(), responses(lost, 50)
    assert found.outputs.shape == (50, len(responses.tape.output_names))
    for place, name in enumerate(names):
        ends = []
        for sign in (1.0, -1.0):
            responses.tape.set_parameters({name: given[name] * (1.0 + sign * 1e-4)})
            ends.append(responses(lost, 50).outputs)
        responses.tape.set_parameters({name: given[name]})
        expected = (ends[0] - ends[1]) / (2e-4 * given[name])
        for output in range(expected.shape[1]):
            size = np.abs(expected[:, output]).max()
            assert np.abs(found.parameters[:, output, place] - expected[:, output]).max() <= 1e-5 * size, (name, output)


def test_the_jacobian_and_the_gradient_with_respect_to_the_law_agree() -> None:
    responses = Responses(SETTINGS, (), 1)
    found, tape = responses(SCENARIO, 40), responses.tape
    played = tape.play([SCENARIO] * tape.lanes.n_lanes, np.zeros((40, tape.lanes.n_lanes, 4)))
    weights = np.random.default_rng(0).normal(size=found.outputs.shape)
    _, law, _ = tape.back(outputs=np.broadcast_to(weights[:, np.newaxis], played.outputs.shape))
    summed = np.einsum("so,sowp->wp", weights, found.law)
    assert summed == pytest.approx(law[0], rel=1e-9, abs=1e-12 * np.abs(law).max())
    assert np.abs(law[0]).max() > 1e-3


def test_a_record_without_noise_gives_the_true_values_back() -> None:
    record = estimator().run(np.ones(4))[0]
    found = estimator().fit(record, np.array([0.7, 1.4, 0.6, 1.5]))
    values = [unknown.value for unknown in estimator().unknowns]
    assert found.values == pytest.approx(values, rel=1e-5)
    assert found.noise < 1e-9 and found.n_runs < 20
    # Kinetic energy of the machines: ½ (615·10.296 + 60·13.08 + 2·25·10.12) MW s.
    assert values[0] == pytest.approx(3811.42)


def test_intervals_hold_the_true_values_about_as_often_as_they_say() -> None:
    # A record of 3 s: the time of a search grows with it.
    three_s = estimator(30)
    values = np.array([unknown.value for unknown in three_s.unknowns])
    record, noise, n = three_s.run(np.ones(4))[0], 4e-6, 60
    found = estimates(three_s, record, noise, n, seed=1)
    shares = covered(found, values)
    # 60 intervals of 95 % hold 51 … 60 of 60 with a probability of 0.998.
    assert (shares >= 51 / n).all(), shares
    assert shares.mean() < 1.0
    # As long as the estimates scatter: no interval is safe because it is long.
    scatter = np.std([own.values for own in found], axis=0)
    widths = np.mean([own.high - own.low for own in found], axis=0) / (2.0 * 1.96)
    assert widths == pytest.approx(scatter, rel=0.3)
    assert np.mean([own.noise for own in found]) == pytest.approx(noise, rel=0.05)
    half = three_s.fit(record + noise * np.random.default_rng(5).standard_normal(30), confidence=0.5)
    assert (half.high - half.low < 0.4 * (found[0].high - found[0].low)).all()


def test_converters_of_another_simulator_are_found_in_its_trace() -> None:
    study = study_recorded_run(
        GOLDEN / "grid-forming" / "params.json", GOLDEN / "grid-forming" / "a.csv", noise=Noise(mhz=1e-3, n_draws=1)
    )
    found = {own.name: own for own in study.unknowns}
    assert found["control.inertia_constant_s"].value == 4.0 and found["control.droop_gain_pu"].value == 50.0
    for own in study.unknowns:
        assert own.estimate == pytest.approx(own.value, rel=3e-3), own
    assert study.residual_mhz < 0.02 and study.n_values == 111


def test_the_command_prints_a_table_and_json(capsys: pytest.CaptureFixture[str], tmp_path: Any) -> None:
    arguments = ("analyse", "estimate", "--unknown", "inertia", "--duration", "4", "--draws", "2")
    found = json_of(capsys, *arguments, "--json")
    (own,) = found["unknowns"]
    assert found["n_draws"] == 2 and found["n_values"] == 40
    assert own["low"] < own["estimate"] < own["high"] and own["start"] == pytest.approx(0.7 * own["value"])
    page = tmp_path / "page.md"
    page.write_text("<!-- estimate:start -->\n<!-- estimate:end -->\n")
    assert main([*arguments, "--page", str(page)]) == 0
    text = page.read_text()
    assert "60 MW of load at bus 4" in text and "| inertia [MW s] | 3811.4 | 2668 |" in text
    assert capsys.readouterr().out == ""
    assert main(arguments) == 0
    assert capsys.readouterr().out.strip() in text


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--unknown", "control.reactance_pu"), "unknown parameters"),
        (("--unknown", "inertia", "machines.1.two_h_s"), "two unknowns move machines.1.two_h_s"),
        (("--unknown", "machines.1.governor.dead_band_pu"), "is 0 in this plant"),
        (("--noise", "0"), "noise"),
        (("--draws", "0"), "once or more"),
        (("--seed", "-1"), "seed of the noise"),
        (("--column", "w1"), "--column is for --recorded"),
        ((*RECORDED, "--power", "3"), "--power"),
        ((*RECORDED, "--column", "w2a"), "w1, w3, w6, w8"),
        ((*RECORDED, "--units-at", "3"), "bus 3"),
        (("--recorded", "no.json", "no.csv"), "no.json"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], reason: str) -> None:
    assert reason in error_of(capsys, "analyse", "estimate", *arguments)


def test_what_a_record_does_not_tell_is_refused() -> None:
    steps, unknown = range(30), unknown_of(PLANT, "pitch.speed_weight")
    with pytest.raises(ValueError, match="does not tell"):
        Estimator(SETTINGS, SCENARIO, [unknown], steps, n_threads=1).fit(np.linspace(1.0, 0.99, 30))
    with pytest.raises(ValueError, match="30 finite numbers"):
        Estimator(SETTINGS, SCENARIO, [unknown], steps, n_threads=1).fit(np.ones(29))
    with pytest.raises(ValueError, match="sets the droop"):
        given = Scenario(name="given", wind_speed=SCENARIO.wind_speed, governor_droop=0.05, duration_s=20.0)
        Estimator(SETTINGS, given, [unknown_of(PLANT, "machines.1.governor.droop_pu")], steps)
    with pytest.raises(ValueError, match="unknown output"):
        Estimator(SETTINGS, SCENARIO, [unknown], steps, "voltage")
    with pytest.raises(ValueError, match="increasing times"):
        Estimator(SETTINGS, SCENARIO, [unknown], [3, 3, 4])
