"""`wtg-gym bench` as a user calls it: its rows, not its speeds."""

from __future__ import annotations

import importlib.util
import itertools
import json
from pathlib import Path
from typing import Any

import pytest

from tests.cli.calls import error_of, json_of
from wtg_gym.analysis.benchmarks import environments, growth, parts, peers, training
from wtg_gym.analysis.benchmarks.timing import Stepper
from wtg_gym.cli import main

QUICK = ("--seconds", "0.01", "--repeats", "1")


def page_with(folder: Path, *parts: str) -> Path:
    page = folder / "page.md"
    page.write_text("".join(f"<!-- bench:{p}:start -->\n<!-- bench:{p}:end -->\n" for p in parts), encoding="utf-8")
    return page


@pytest.fixture
def small_growth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes whose kernels other tests need as well: each other one would compile for half a minute."""
    monkeypatch.setattr(growth, "GROUPS", (2,))
    monkeypatch.setattr(growth, "MACHINES", (4,))
    monkeypatch.setattr(growth, "LANES", (1, 16))
    monkeypatch.setattr(growth, "THREADED_BATCH", 128)


@pytest.fixture
def small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let batches have at most two environments: these tests do not depend on their size."""
    for name in ("_our_vector", "_gradients"):
        whole = getattr(environments, name)
        monkeypatch.setattr(environments, name, lambda benchmark, n, whole=whole: whole(benchmark, min(n, 2)))


def test_environments_are_measured_against_the_yardstick(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, small_batches: None
) -> None:
    page = page_with(tmp_path, "environments", "growth")
    data = json_of(capsys, "bench", "--only", "environments", *QUICK, "--json", "--page", str(page))
    cases = {case["name"]: case for case in data["cases"]}
    assert cases["Pendulum-v1"]["ratio"] == 1.0
    ours = {f"GFMWTG-14bus-{version}{batch}" for version in ("v0", "v1") for batch in ("", ", vector of 1024")}
    assert {*ours, "CartPole-v1"} <= set(cases)
    assert {"SB3 adapter of 64", "SB3 DummyVecEnv of 8"} <= set(cases)
    for case in cases.values():
        assert case["part"] == "environments" and case["steps_per_s"] > 0.0 and len(case["all"]) == 1
        assert case["ratio"] == pytest.approx(case["steps_per_s"] / cases["Pendulum-v1"]["steps_per_s"])
    assert data["machine"] and data["versions"]["numba"]
    assert data["parts"] == ["environments"] and data["growth"] == [] and data["roofline"] is None
    text = page.read_text(encoding="utf-8")
    assert text.count("\n| ") == 1 + 1 + len(cases) and data["machine"] in text
    # A part that was not measured stays as it was.
    assert text.endswith("<!-- bench:growth:start -->\n<!-- bench:growth:end -->\n")


def test_frames_are_drawn_at_every_step(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    page = page_with(tmp_path, "rendering")
    data = json_of(capsys, "bench", "--only", "rendering", *QUICK, "--json", "--page", str(page))
    names = [case["name"] for case in data["cases"] if case["part"] == "rendering"]
    assert names == [f"{name}, a frame each step" for name in ("GFMWTG-14bus-v0", "CartPole-v1", "Pendulum-v1")]
    assert names[0] in page.read_text(encoding="utf-8")


def test_training_is_the_same_on_every_vector_environment(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [case.name for case in training.training_cases()]
    assert names[:3] == ["PPO on SB3 adapter of 64", "PPO on SB3 adapter of 1024", "PPO on SB3 DummyVecEnv of 8"]
    assert names[-1].startswith("PPO on SB3 SubprocVecEnv of ")
    monkeypatch.setattr(training, "ROLLOUT", 256)
    monkeypatch.setattr(parts, "training_cases", lambda: itertools.islice(training.training_cases(), 1))
    data = json_of(capsys, "bench", "--only", "training", *QUICK, "--json")
    assert [case["name"] for case in data["cases"][1:]] == names[:1]
    assert "rollouts of 256 steps" in data["training"]


def test_growth_writes_curves_and_a_figure(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, small_growth: None
) -> None:
    page, folder = page_with(tmp_path, "growth"), tmp_path / "performance"
    options = ("--output", str(folder), "--formats", "svg", "--page", str(page))
    data = json_of(capsys, "bench", "--only", "growth", *QUICK, "--json", *options)
    curves = {curve["name"]: curve for curve in data["growth"]}
    assert list(curves) == ["groups", "groups, single", "machines", "lanes", "threads"]
    assert [point["n"] for point in curves["lanes"]["points"]] == [1, 16]
    for curve in curves.values():
        for point in curve["points"]:
            assert point["microseconds"] > 0.0 and point["compile_s"] >= 0.0
            assert point["bytes_per_lane"] > 1000.0
    assert curves["groups"]["exponent"] is None and isinstance(curves["lanes"]["exponent"], float)
    assert json.loads((folder / "bench.json").read_text(encoding="utf-8")) == data
    assert (folder / "growth.svg").read_text(encoding="utf-8").count("time per step [µs]") == 4
    assert "Lanes: a step costs" in page.read_text(encoding="utf-8")


def test_roofline_compares_counted_operations_with_the_peak(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    page = page_with(tmp_path, "roofline")
    assert main(["bench", "--only", "roofline", *QUICK, "--output", str(tmp_path), "--page", str(page)]) == 0
    said = capsys.readouterr().out
    assert "peak, vectors, fused multiply-add" in said and "environment step" in said
    data = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))["roofline"]
    flops = {
        name: sum(counts[kind] for kind in ("adds", "multiplies", "divisions", "roots", "powers"))
        for name, counts in data["counts"].items()
    }
    # Four Runge-Kutta steps of four evaluations, and one at the end.
    assert 17 * flops["right-hand side"] < flops["control interval"] < flops["environment step"]
    peaks = {(peak["name"], peak["threads"]): peak["giga_per_s"] for peak in data["peaks"]}
    single = data["achieved"][0]
    assert single["gflop_per_s"] == pytest.approx(1e-9 * flops["environment step"] * single["steps_per_s"])
    assert single["share"] == pytest.approx(single["gflop_per_s"] / peaks["vectors", 1])
    assert not (tmp_path / "growth.svg").exists()
    assert "of the vector peak" in page.read_text(encoding="utf-8")


def test_what_is_not_installed_is_left_out_with_a_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, small_batches: None
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["bench", "--only", "environments", "gradients", "training", "peers", *QUICK]) == 0
    said = capsys.readouterr()
    assert "processors, Python 3." in said.out and "GFMWTG-14bus-v0, vector of 64" in said.out
    assert "gradients of 64" in said.out
    assert "SB3" not in said.out and "Grid2Op" not in said.out
    assert "Stable-Baselines3 is left out; in a checkout: pip install '.[train]'" in said.err
    for package in ("gym-electric-motor", "gym-anm", "grid2op", "lightsim2grid", "envpool"):
        assert f"{package} is left out: pip install {package}\n" in said.err


def test_a_peer_that_is_installed_is_measured(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def make() -> Stepper:
        return lambda seconds: 7.0

    fake = peers._Peer("json", "json", "a peer", 1, make)
    monkeypatch.setattr(peers, "_PEERS", (fake, fake._replace(module="no_such_module", package="no-such")))
    data = json_of(capsys, "bench", "--only", "peers", *QUICK, "--json")
    assert [(case["name"], case["steps_per_s"]) for case in data["cases"][1:]] == [("a peer", 7.0)]
    assert data["missing"] == ["no-such is left out: pip install no-such"]


def test_grid2op_steps_without_an_action() -> None:
    class Grid:
        ended = 0

        def action_space(self, changes: dict[str, Any]) -> str:
            assert changes == {}
            return "nothing"

        def reset(self, seed: int | None = None) -> int:
            return 0

        def step(self, action: str) -> tuple[int, float, bool, dict[str, Any]]:
            assert action == "nothing"
            return 0, 1.0, True, {}

    env = peers._DoNothing(Grid())
    assert env.action_space.sample() == "nothing"
    assert env.step("nothing") == (0, 1.0, True, False, {})
    assert env.reset(seed=0) == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--seconds", "0"), "--seconds = 0 s is outside the allowed range 0.01 … 600 s"),
        (("--repeats", "0"), "--repeats = 0 is outside the allowed range 1 … 1000"),
        (("--only", "speed"), "invalid choice: 'speed'"),
        (("--page", "nowhere.md"), "--page: cannot read the file with the markers"),
        (("--output", "pyproject.toml"), "--output pyproject.toml: pyproject.toml is not a folder"),
    ],
)
def test_bad_input_is_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    said: str,
) -> None:
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.chdir(tmp_path)
    assert said in error_of(capsys, "bench", *arguments)


def test_a_page_without_the_markers_is_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    page = page_with(tmp_path, "growth")
    said = error_of(capsys, "bench", "--only", "roofline", "--page", str(page))
    assert "has no markers of a measured part: <!-- bench:roofline:start -->" in said
    page.write_text("<!-- bench:roofline:start -->\n", encoding="utf-8")
    said = error_of(capsys, "bench", "--only", "roofline", "--page", str(page))
    assert "must have the markers <!-- bench:roofline:start --> and <!-- bench:roofline:end --> once each" in said
