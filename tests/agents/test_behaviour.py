"""Facts about `agents.research.behaviour`: slopes are those of the policy, files repeat, bad input is refused."""

from __future__ import annotations

import csv
import hashlib
import re
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from agents.research.behaviour import CURVE_SECTION, ENTRY_SECTIONS, main
from agents.research.learning_curves import curves_by_setup, read_csv, read_runs, to_csv
from agents.research.slopes import policy_slopes
from agents.runs import Run, RunSettings
from wtg_gym.envs import EnvSettings, GFMWTGEnv
from wtg_gym.evaluation import load_entries
from wtg_gym.evaluation.recording import record
from wtg_gym.physics.tracking_law import coordinated_piecewise
from wtg_gym.scenarios import get_suite

#: The policy moves k with the group's own wind and τ with its own frequency, in both groups alike.
K_PER_WIND, TAU_PER_FREQUENCY = 0.3, -0.5
LIMIT_BYTES = 250_000


def entry_folder(path: Path, name: str = "linear", seed: int = 0) -> str:
    """Write a linear policy as an entry and return its folder."""
    # Not on import: every process that collects the tests would compile for it.
    names = GFMWTGEnv(version="v0").observation_names
    weights = np.zeros((len(names), 4), dtype=np.float32)
    for group in range(2):
        weights[names.index(f"wtg{group}.wind [5 m/s from 10 m/s]"), 2 * group] = K_PER_WIND
        weights[names.index(f"wtg{group}.frequency_deviation [0.5 Hz]"), 2 * group + 1] = TAU_PER_FREQUENCY
    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "weights"], ["action"])],
        "linear",
        [value("observation", TensorProto.FLOAT, ["batch", len(names)])],
        [value("action", TensorProto.FLOAT, ["batch", 4])],
        [numpy_helper.from_array(weights, "weights")],
    )
    path.mkdir(parents=True)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, path / "policy.onnx")
    text = f'name = "{name}"\naction_mode = "k+tau"\nenvironment = "GFMWTG-14bus-v0"\ntraining_seed = {seed}\n'
    (path / "entry.toml").write_text(text)
    return str(path)


def run_folder(path: Path, seed: int = 0, algo: str = "ppo", n: int = 3, suite: str = "standard") -> str:
    """Write the description of a run with n validations and return its folder."""
    steps = {"timesteps": 3000, "n_envs": 1, "interval": 1000}
    settings = RunSettings(algo=algo, hyperparameters={}, suite=suite, seed=seed, **steps)
    numbers = {"cost": 30.0, "failures_percent": 0.0}
    curve = [{"timesteps": 1000 * i, "wall_time_s": 2.0 * i, "score": 100.0 + i + seed, **numbers} for i in range(n)]
    path.mkdir(parents=True)
    Run(settings=settings, provenance={}, curve=curve).write(path)
    return str(path)


def page(path: Path) -> Path:
    path.write_text("".join(f"<!-- {n}:start -->\n<!-- {n}:end -->\n" for n in (*ENTRY_SECTIONS, CURVE_SECTION)))
    return path


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def test_slopes_find_what_a_linear_policy_does(tmp_path: Path) -> None:
    (entry,) = load_entries(entry_folder(tmp_path / "entry"))
    scenarios = get_suite("standard").scenarios(range(10_000, 10_004), duration_s=30.0)
    found = policy_slopes(record(entry, EnvSettings(duration_s=30.0, version="v0"), scenarios))
    law = coordinated_piecewise()
    full = 0.5 * (law.k_min - law.k_max) / law.k_min
    k, tau = found["k"], found["tau"]
    alone = {row.quantity: row for row in k.alone}
    assert alone["wind"].slope == pytest.approx(K_PER_WIND * full, rel=1e-4)
    assert alone["wind"].unit == "5 m/s from 10 m/s" and alone["wind"].share == pytest.approx(1.0, abs=1e-6)
    together = {row.quantity: row for row in k.together}
    assert together["wind"].slope == pytest.approx(K_PER_WIND * full / 5.0, rel=1e-4)
    assert sum(row.share for row in k.together) == pytest.approx(k.explained) == pytest.approx(1.0, abs=1e-6)
    assert abs(together["frequency deviation"].slope) < 1e-6
    frequency = {row.quantity: row for row in tau.alone}["frequency_deviation"]
    # Full action is two doublings.
    assert frequency.slope == pytest.approx(2.0 * TAU_PER_FREQUENCY, rel=1e-4) and frequency.share > 0.999999
    for result in (k, tau):
        assert result.with_others == pytest.approx(1.0, abs=1e-6) and result.each_group == pytest.approx(1.0, abs=1e-6)


def test_law_without_actions_has_no_slopes_of() -> None:
    (reference,) = load_entries("coordinated-piecewise")
    assert policy_slopes(record(reference, EnvSettings(suite="paper"), get_suite("paper").scenarios([0]))) == {}


def test_everything_is_written_small_and_the_same_each_time(tmp_path: Path) -> None:
    entries = [entry_folder(tmp_path / f"entry-{seed}", seed=seed) for seed in (0, 1)]
    runs = [run_folder(tmp_path / f"run-{seed}", seed=seed) for seed in (0, 1)]
    text = page(tmp_path / "page.md")
    written = []
    for name in ("one", "two"):
        options = [
            "--suite",
            "standard",
            "--entries",
            *entries,
            "--runs",
            *runs,
            "--split",
            "validation",
            "--scenarios",
            "2",
        ]
        assert main([*options, "--output", str(tmp_path / name), "--page", str(text)]) == 0
        written.append(digests(tmp_path / name))
    assert written[0] == written[1]
    assert set(written[0]) == {
        "costs.svg",
        "learning-curves.svg",
        "learning_curves.csv",
        "slopes.csv",
        "responses-linear.svg",
        *(f"run-linear-{where}.svg" for where in ("paper-load-increase", "paper-load-decrease", "standard-10000")),
    }
    assert all(path.stat().st_size < LIMIT_BYTES for path in (tmp_path / "one").iterdir())
    shown = re.findall(r"\]\((.*)\)", text.read_text())
    assert {Path(link).name for link in shown} == {name for name in written[0] if name.endswith(".svg")}
    assert all((tmp_path / link).is_file() for link in shown)
    assert "2 training seeds" in text.read_text() and "| wind | 1 m/s | +0.0139 (" in text.read_text()
    rows = list(csv.DictReader((tmp_path / "one" / "slopes.csv").open()))
    assert {row["entry"] for row in rows} == {"linear"} and {row["action"] for row in rows} == {"k", "tau"}


def test_suite_of_v1_is_drawn_with_its_own_cases_and_anchors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    of_v1 = run_folder(tmp_path / "run", suite="standard-v1")
    folder = tmp_path / "out"
    options = ["--suite", "standard-v1", "--entries", "fast-droop", "--split", "validation", "--scenarios", "2"]
    assert main([*options, "--runs", of_v1, "--output", str(folder)]) == 0
    cases = ("paper-v1-load-increase", "paper-v1-load-decrease", "standard-v1-10000")
    assert {f"run-fast-droop-{case}.svg" for case in cases} <= {path.name for path in folder.iterdir()}
    assert "coordinated-tuned" in (folder / "learning-curves.svg").read_text()
    capsys.readouterr()
    assert main(["--runs", of_v1, run_folder(tmp_path / "old"), "--output", str(tmp_path / "no")]) == 2
    assert "different scales" in capsys.readouterr().err and not (tmp_path / "no").exists()


def test_curves_are_drawn_again_from_the_file_alone(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    assert main(["--runs", run_folder(tmp_path / "run"), "--output", str(folder)]) == 0
    before = digests(folder)
    (folder / "learning-curves.svg").unlink()
    assert main(["--output", str(folder)]) == 0
    assert digests(folder) == before


def test_curves_survive_their_file_and_are_sorted_by_set_up_and_seed(tmp_path: Path) -> None:
    folders = [
        run_folder(tmp_path / f"{algo}-{seed}", seed, algo) for algo, seed in (("sac", 0), ("ppo", 1), ("ppo", 0))
    ]
    rows = read_runs(map(Path, folders))
    (tmp_path / "curves.csv").write_text(to_csv(rows))
    assert read_csv(tmp_path / "curves.csv") == rows
    curves = curves_by_setup(rows)
    assert {name: len(own) for name, own in curves.items()} == {"ppo, k+tau": 2, "sac, k+tau": 1}
    assert curves["ppo, k+tau"][1].score.tolist() == [101.0, 102.0, 103.0]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ([], "nothing to draw: give --entries or --runs"),
        (["--entries", "no-such"], "unknown entry 'no-such'"),
        (["--entries", "ENTRY", "ENTRY"], "given more than once"),
        (["--entries", "ENTRY", "--scenarios", "0"], "--scenarios must be 1 … 200 for standard/test, got 0"),
        (["--entries", "ENTRY", "--page", "no.md"], "--page: cannot read"),
        (["--runs", "no-such"], "cannot read the description of the run"),
        (["--runs", "RUN", "RUN"], "are both of ppo, k\\+tau"),
        (["--runs", "EMPTY"], "has no validation yet"),
    ],
)
def test_bad_input_ends_in_one_line_and_writes_nothing(
    options: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {
        "ENTRY": entry_folder(tmp_path / "entry"),
        "RUN": run_folder(tmp_path / "run"),
        "EMPTY": run_folder(tmp_path / "empty", n=0),
    }
    given = ["--suite", "standard", *(places.get(option, option) for option in options)]
    assert main([*given, "--output", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert re.search(text, error), error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("", "must have the columns algo, "),
        ("a,b\n1,2\n", "must have the columns algo, "),
        ("HEAD\nppo,k\n", "line 2: "),
    ],
)
def test_damaged_file_of_curves_is_refused(content: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "learning_curves.csv").write_text(content.replace("HEAD", to_csv([]).strip()))
    with pytest.raises(ValueError, match=text):
        read_csv(tmp_path / "learning_curves.csv")
