"""`wtg-gym results matrix` and `front` as a user calls them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.calls import error_of, json_of
from wtg_gym.cli import main
from wtg_gym.evaluation import Results
from wtg_gym.evaluation.matrix import PERTURBATIONS, changed_sensors, matrix_of

FEW = ("--suites", "standard-v1", "paper-v1", "--split", "validation", "--scenarios", "12", "--entries", "fast-droop")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("matrix")
    (folder / "page.md").write_text("before\n<!-- matrix:start -->\n<!-- matrix:end -->\nafter\n")
    options = ("--results", str(folder), "--page", str(folder / "page.md"))
    assert main(["results", "matrix", *FEW, *options]) == 0
    return folder


def test_results_of_each_column_are_stored_and_make_the_table(folder: Path) -> None:
    names = ["standard-v1-validation.json", "paper-v1-validation.json"]
    names += [f"{name}/standard-v1-validation.json" for name in PERTURBATIONS]
    results = [Results.read(folder / name) for name in names]
    assert [changed_sensors(each) for each in results] == ["", "", "delay +0.1 s", "delay +0.2 s", "wind bias × 2"]
    assert [len(each.seeds) for each in results] == [12, 2, 12, 12, 12]
    page = (folder / "page.md").read_text()
    assert page == f"before\n<!-- matrix:start -->\n{matrix_of(results).page()}\n<!-- matrix:end -->\nafter\n"


def test_stored_results_are_used_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = json_of(capsys, "results", "matrix", *FEW, "--results", str(folder), "--json")
    assert [column["heading"] for column in data["columns"]][:2] == ["standard", "paper"]
    assert main(["results", "matrix", *FEW, "--results", str(folder)]) == 0
    said = capsys.readouterr()
    assert said.err.count("1 of 1 entries are stored") == 5
    assert "Mean pinned cost of the worst tenth" in said.out and "fast-droop" in said.out


def test_a_suite_without_sensors_has_no_other_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = ("--suites", "paper", "--perturb", "paper", "--entries", "deloaded-5", "--results", str(tmp_path))
    data = json_of(capsys, "results", "matrix", *few, "--json")
    assert [column["heading"] for column in data["columns"]] == ["paper"] and data["version"] == "v0"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--suites", "standard", "standard-v1"), "--suites are of two versions of the benchmark"),
        (("--suites", "storm"), "unknown suite 'storm'"),
        (("--perturb", "storm"), "unknown suite 'storm'"),
        (("--scenarios", "0"), "--scenarios = 0 is outside the allowed range"),
        (("--entries", "agents/policies/ppo-k-0"), "is for GFMWTG-14bus-v0, these scenarios are of GFMWTG-14bus-v1"),
        (("--page", "missing.md"), "cannot read the file with the markers missing.md"),
    ],
)
def test_bad_input_is_refused_before_anything_is_played(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    folder = tmp_path / "results"
    assert said in error_of(capsys, "results", "matrix", *arguments, "--results", str(folder))
    assert not folder.exists()


def test_results_of_other_scenarios_are_not_overwritten(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "standard-v1-validation.json").read_bytes()
    other = [text if text != "12" else "11" for text in FEW]
    assert "is of other seeds and would be lost" in error_of(
        capsys, "results", "matrix", *other, "--results", str(folder)
    )
    assert (folder / "standard-v1-validation.json").read_bytes() == before


def test_front_is_drawn_and_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plot = folder / "front.svg"
    assert main(["results", "front", str(folder / "standard-v1-validation.json"), "--plot", str(plot)]) == 0
    assert "no other entry has more support and more energy than: " in capsys.readouterr().out
    assert "captured share of the available energy" in plot.read_text()
    paper = str(folder / "paper-v1-validation.json")
    assert "is not worse than coordinated-tuned" in error_of(capsys, "results", "front", paper, "--plot", str(plot))
