"""`wtg-gym analyse physics` as a user calls it, and its page."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.cli.calls import ROOT, error_of
from wtg_gym.analysis import physics_study
from wtg_gym.analysis.load_models import run_with_loads
from wtg_gym.analysis.physics_study import COMPARED, count_suite
from wtg_gym.analysis.plant_forms import HONEST, HYDRO, NREL, PAPER, PRESETS, PlantRun, plant_forms, run_plant
from wtg_gym.cli import main
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.scenarios import get_suite

SECTIONS = ("survival", "cases", "parts", "suites", "rotor-energy", "margins", "policies", "loads")
#: How long a scenario of a suite is played where only their number counts [s].
SHORT_S = 10.0


@functools.cache
def played_once(settings: PlantSettings, scenarios: tuple[Scenario, ...], strategy: str) -> list[PlantRun | None]:
    return run_plant(settings, scenarios, strategy)


def play(settings: PlantSettings, scenarios: Sequence[Scenario], strategy: str) -> list[PlantRun | None]:
    """Run the paper's cases whole and a suite's scenarios for a short while, each of them once."""
    own = [s if "paper" in s.name else dataclasses.replace(s, duration_s=SHORT_S) for s in scenarios]
    return played_once(settings, tuple(own), strategy)


def test_physics_writes_study_figures_and_page(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # The other plants are compiled for themselves, which takes minutes.
    forms = plant_forms()
    few = {name: forms[name] for name in (PAPER, "rotor energy", HONEST)}
    few |= dict.fromkeys((NREL, HYDRO, *PRESETS), forms[HONEST])
    monkeypatch.setattr(physics_study, "plant_forms", lambda: few)
    monkeypatch.setattr(physics_study, "run_plant", play)
    page = tmp_path / "page.md"
    page.write_text("# Page\n\n" + "\n\n".join(f"<!-- {s}:start -->\n<!-- {s}:end -->" for s in SECTIONS) + "\nend\n")
    command = ["analyse", "physics", "--scenarios", "2", "--entries", "linear-feedback", "--output", str(tmp_path)]
    assert main([*command, "--formats", "svg", "--page", str(page)]) == 0
    said = capsys.readouterr().out
    data = json.loads((tmp_path / "physics.json").read_text(encoding="utf-8"))
    assert sorted(path.name for path in tmp_path.glob("*.svg")) == ["load-increase.svg", "margins.svg", "parts.svg"]
    for figure in ("load-increase", "parts"):
        drawn = (tmp_path / f"{figure}.svg").read_text(encoding="utf-8")
        assert all(strategy in drawn for strategy in COMPARED)
    for name, stalls in ((PAPER, "44.8/65.8/82.9"), ("rotor energy", "35.0/46.2/56.2")):
        assert [f"{data['increase'][name][s]['end_s']:.1f}" for s in COMPARED[1:]] == stalls.split("/")
        assert stalls in page.read_text(encoding="utf-8")
    assert data["increase"][HONEST]["coordinated-piecewise"]["status"] == "RUNNING"
    assert data["counts"][PAPER]["gust"]["mppt"]["n_scenarios"] == 2
    free, limited = (play for play in data["policies"] if play["entry"].startswith("linear-feedback"))
    assert limited["limited"] and not free["limited"]
    text = page.read_text(encoding="utf-8")
    assert text.count("| constant power |") == 1 and "| constant E | 1.045 | 1.32/1.24 |" in text
    assert "rotor energy" in said and "linear-feedback" in said


def test_page_shows_what_the_simulator_does() -> None:
    text = (ROOT / "docs" / "physics.md").read_text(encoding="utf-8")
    cases = get_suite("paper").scenarios([0, 1])
    for name in (PAPER, "rotor energy", "dead band", HONEST):
        runs = [play(plant_forms()[name], cases, strategy)[0] for strategy in COMPARED]
        ends = "/".join(f"{run.end_s:.1f}" for run in runs[1:] if run is not None)
        assert runs[0] is not None
        assert f"| {name} | {runs[0].nadir_hz:.3f} | {runs[0].rocof_hz_s:.3f} | {ends} |" in text
    trips = [play(plant_forms()["extended"], cases, strategy)[0] for strategy in COMPARED[1:]]
    assert all(run is not None and run.status == Status.UNDER_SPEED for run in trips)
    ends = "/".join(f"{run.end_s:.1f}" for run in trips if run is not None)
    assert text.count(f"{ends} (under-speed)") == 2
    gust = count_suite(plant_forms()["extended"], "gust", COMPARED[0], 100)
    assert gust.ends == {"under-speed": gust.failures} and f"gust: {gust.failures} under-speed" in text
    load = run_with_loads("constant power", cases[0], COMPARED[0])
    assert f"| constant power | {load.nadir_hz:.3f} | {load.final_hz:.3f} |" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--scenarios", "0"), "the number of scenarios = 0 is outside the allowed range 1 … 100"),
        (("--page", "nowhere.md"), "--page: cannot read the file with the markers nowhere.md"),
        (("--entries", "nobody"), "nobody"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str) -> None:
    assert said in error_of(capsys, "analyse", "physics", *arguments)
