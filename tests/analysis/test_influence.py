"""What parameters do to nadir, RoCoF and rotor speed: against runs with other values, and the command."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from tests.cli.calls import error_of, json_of
from wtg_gym.analysis.influence_study import LAW_NAMES, MEASURES, Influences, measure_influences
from wtg_gym.cli import main
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.gradients.tape import Tape
from wtg_gym.physics.tracking_law import get_law
from wtg_gym.scenarios import get_suite

Floats = npt.NDArray[np.float64]
SETTINGS = EnvSettings(suite="paper")
SCENARIO = get_suite("paper").scenario(0)


@functools.cache
def found() -> Influences:
    return measure_influences(SETTINGS, [SCENARIO], n_threads=1)


def measures_of(tape: Tape, share: float = 0.0, parameter: int = -1) -> Floats:
    """The three measures of a run, in the units of `MEASURES`, with a parameter of the law moved by a share."""
    tape.start([SCENARIO])
    law = tape.law()
    if parameter >= 0:
        law[:, :, parameter] *= 1.0 / (1.0 + share) if parameter == 3 else 1.0 + share
        tape.set_law(law)
    shown = []
    for _ in range(600):
        tape.step(np.zeros((1, 4)))
        shown.append(tape.outputs()[0])
    run = np.array(shown)
    return 1e3 * np.array([50.0 * run[:, 0].min(), np.abs(run[:, 1]).max(), run[:, 2:4].min()])


@pytest.mark.parametrize(
    "name",
    ["machines.1.governor.droop_pu", "machines.1.two_h_s", "control.droop_gain_pu", "turbine.inertia_constant_s"],
)
def test_an_effect_is_what_another_plant_shows(name: str) -> None:
    tape = Tape(SETTINGS, 1, 1, (name,))
    value, ends = tape.parameter_values()[name], []
    for share in (1e-5, -1e-5):
        tape.set_parameters({name: value * (1.0 + share)})
        ends.append(measures_of(tape))
    expected = 500.0 * (ends[0] - ends[1])
    assert np.abs(expected).max() > 0.05
    assert found().effects[0, found().parameters.index(name)] == pytest.approx(expected, rel=1e-3, abs=1e-5)


@pytest.mark.parametrize("parameter", [0, 2, 3])
def test_an_effect_of_the_law_is_what_another_law_shows(parameter: int) -> None:
    tape = Tape(SETTINGS, 1, 1)
    ends = [measures_of(tape, share, parameter) for share in (1e-5, -1e-5)]
    own = found().effects[0, found().parameters.index(LAW_NAMES[parameter])]
    # A k_max that acts for an instant only moves nothing by much.
    assert own == pytest.approx(500.0 * (ends[0] - ends[1]), rel=1e-3, abs=1e-5)


def test_another_k_nominal_starts_from_another_equilibrium() -> None:
    law, ends = get_law("coordinated-piecewise"), []
    for share in (1e-4, -1e-4):
        moved = dataclasses.replace(law, name="moved", k_nominal=law.k_nominal * (1.0 + share))
        ends.append(measures_of(Tape(EnvSettings(suite="paper", strategy=moved), 1, 1)))
    own = found().effects[0, found().parameters.index("law.k_nominal")]
    assert own == pytest.approx(50.0 * (ends[0] - ends[1]), rel=1e-2, abs=1e-3)
    assert np.abs(own).max() > 0.1


def test_values_are_those_of_the_run_and_the_largest_effects_come_first() -> None:
    assert 1e3 * found().values[0] == pytest.approx(measures_of(Tape(SETTINGS, 1, 1)), rel=1e-12)
    order = found().order()
    assert sorted(order) == list(range(len(found().parameters)))
    largest = np.abs(found().effects[0]).argmax(axis=0)
    assert set(largest.tolist()) <= set(order[:3])
    assert found().nominal[found().parameters.index("law.tau_s")] == pytest.approx(0.8)
    assert 0.0 not in found().nominal


def test_effects_in_v1_are_what_other_plants_show() -> None:
    """Of four groups, through sensors and limits, in a scenario with a droop and an inertia of its own."""
    settings = EnvSettings(suite="standard-v1", duration_s=20.0)
    own = get_suite("standard-v1").scenario(20_000, n_wtg=4)
    scenario = dataclasses.replace(own, duration_s=20.0)
    influences = measure_influences(settings, [scenario], n_threads=1)
    names = tuple(name for name in influences.parameters if not name.startswith("law."))
    # Three lanes and all parameters: the code that is compiled already.
    tape = Tape(settings, 3, 1, names)
    for name in ("machines.1.two_h_s", "control.droop_gain_pu"):
        value, ends = tape.parameter_values()[name], []
        for share in (1e-5, -1e-5):
            tape.set_parameters({name: value * (1.0 + share)})
            run = tape.play([scenario] * 3, np.zeros((200, 3, tape.lanes.n_action))).outputs[:, 0]
            ends.append(1e3 * np.array([50.0 * run[:, 0].min(), np.abs(run[:, 1]).max(), run[:, 2:6].min()]))
        expected = 500.0 * (ends[0] - ends[1])
        assert np.abs(expected).max() > 0.02
        effect = influences.effects[0, influences.parameters.index(name)]
        assert effect == pytest.approx(expected, rel=1e-3, abs=1e-5)


def test_the_command_prints_draws_and_writes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    plot, page = tmp_path / "bars.png", tmp_path / "page.md"
    page.write_text("<!-- influence:start -->\n<!-- influence:end -->\n")
    arguments = ("analyse", "influence", "--suite", "low-wind", "--seed", "20003-20004")
    both = json_of(capsys, *arguments, "--json", "--plot", str(plot), "--page", str(page))
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert len(both["scenarios"]) == 2 and len(both["parameters"]) == len(found().parameters)
    assert all(len(own["effect_of_one_percent"]["nadir"]) == 2 for own in both["parameters"])
    assert main([*arguments[:4], "--rows", "3"]) == 0
    text = capsys.readouterr().out
    assert len([line for line in text.splitlines() if line.startswith("| machines") or line.startswith("| law")]) <= 3
    assert "2 scenarios of low-wind" in page.read_text() and page.read_text().count("\n| ") == 17
    assert set(both["units"]) == set(MEASURES)


def test_droop_is_that_in_force(capsys: pytest.CaptureFixture[str]) -> None:
    drawn = json_of(capsys, "analyse", "influence", "--suite", "standard", "--seed", "20003", "--json")
    droop = next(own for own in drawn["parameters"] if own["name"] == "machines.1.governor.droop_pu")
    assert droop["value"] == get_suite("standard").scenario(20003).governor_droop != 0.018


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--case", "storm"), "known cases: load-increase"),
        (("--seed", "3"), "needs a suite"),
        (("--suite", "standard", "--seed", "7-3"), "--seed must be"),
        (("--rows", "0"), "1 or more"),
        (("--strategy", "best"), "known strategies"),
        (("--plot", "bars.txt"), "bars.txt"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], reason: str) -> None:
    assert reason in error_of(capsys, "analyse", "influence", *arguments)
