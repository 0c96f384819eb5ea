"""Facts about training: it is reproducible, survives a kill, and its export plays like the learner."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import agents.train
from agents.entry_file import entry_values
from agents.export import _model_card, export, largest_difference
from agents.export import main as export_command
from agents.folders import folders, held, new_folder, save_folder
from agents.hyperparameters import ALGORITHMS
from agents.runs import Run, RunSettings
from agents.train import main, start
from tests.agents.small import CONFIGS, V0, config_file, options, stopped_after, trained
from tests.interruption import end, interrupted
from wtg_gym.evaluation import evaluate, load_entries
from wtg_gym.policies.sb3_archive import CUSTOM_OBJECTS

ROOT = Path(__file__).resolve().parents[2]
#: Large enough for torch to use several threads where it may.
WIDE = {**CONFIGS["ppo"], "batch_size": 16, "policy_kwargs": "dict(net_arch=[64, 64])"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of PPO that tests read only."""
    return trained(tmp_path_factory.mktemp("runs"), "ppo", "whole")


@pytest.fixture
def copied(whole: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(whole, tmp_path / "run"))


def weights(folder: Path, algo: str) -> Any:
    """Networks and optimisers of a finished run's last checkpoint."""
    (path,) = folders(folder / "checkpoints")
    assert int(path.name) == 768
    return ALGORITHMS[algo].load(path / "model.zip", custom_objects=CUSTOM_OBJECTS).get_parameters()


def same(a: Any, b: Any) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    return torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_interrupted_run_goes_on_to_the_weights_of_an_undisturbed_one_and_its_export_plays(
    algo: str, tmp_path: Path
) -> None:
    undisturbed = trained(tmp_path, algo, "undisturbed")
    stopped = stopped_after(256, undisturbed, tmp_path / "stopped")
    assert main(["--resume", str(stopped)]) == 0
    assert same(weights(stopped, algo), weights(undisturbed, algo))
    runs = [Run.read(folder) for folder in (stopped, undisturbed)]
    curves = [[{**row, "wall_time_s": 0.0} for row in run.curve] for run in runs]
    assert curves[0] == curves[1]
    assert [(run.finished, run.resumed) for run in runs] == [(True, 1), (True, 0)]
    assert [row["timesteps"] for row in runs[0].curve] == [0, 256, 512, 768]

    difference = export(stopped, tmp_path / "entry", name="mine", authors=["A. Author"])
    assert difference <= 1e-6
    (entry,) = load_entries(tmp_path / "entry")
    assert (entry.name, entry.training_seed, entry.kind, entry.source) == ("mine", 0, "learned", "A. Author")
    results = evaluate([entry], "standard", "test", seeds=[20_000, 20_001], duration_s=5.0)
    assert len(results.episodes_of("mine")) == 2
    card = (tmp_path / "entry" / "README.md").read_text()
    assert all(text in card for text in (algo, "A. Author", "python", f"{runs[0].best['score']:.1f}"))


def test_killed_process_leaves_a_run_that_goes_on_to_the_same_weights(whole: Path, tmp_path: Path) -> None:
    killed = tmp_path / "killed"
    command = [sys.executable, "-m", "agents.train", *options(tmp_path, "ppo"), "--output", str(killed)]
    process = subprocess.Popen(command, cwd=ROOT)
    end(process, signal.SIGKILL, (killed / "checkpoints" / f"{256:012d}").exists)
    assert process.returncode == -signal.SIGKILL
    assert main(["--resume", str(killed)]) == 0
    assert same(weights(killed, "ppo"), weights(whole, "ppo"))


def test_run_stopped_at_its_first_checkpoint_goes_on_to_the_same_weights(whole: Path, tmp_path: Path) -> None:
    stopped = stopped_after(0, whole, tmp_path / "stopped")
    assert main(["--resume", str(stopped)]) == 0
    assert same(weights(stopped, "ppo"), weights(whole, "ppo"))


def test_run_stopped_before_its_first_checkpoint_begins_anew_with_the_same_weights(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert Run.read(whole).settings.hyperparameters["use_sde"]

    folder = tmp_path / "run"
    monkeypatch.setattr("agents.train.configure", interrupted(agents.train.configure))
    assert main([*options(tmp_path, "ppo"), "--output", str(folder)]) == 130
    assert {path.name for path in folder.iterdir()} == {"run.json", ".lock"}
    monkeypatch.undo()
    assert main(["--resume", str(folder)]) == 0
    assert same(weights(folder, "ppo"), weights(whole, "ppo"))


@pytest.mark.parametrize("missing", ["row", "checkpoint"])
def test_kill_between_two_files_is_mended(missing: str, copied: Path) -> None:
    complete, damaged = Run.read(copied), Run.read(copied)
    del damaged.curve[-1 if missing == "row" else 0 :]
    damaged.write(copied)
    if missing == "checkpoint":
        shutil.rmtree(copied / "checkpoints")
        shutil.rmtree(copied / "best")
    assert main(["--resume", str(copied)]) == 0
    scores = [[(row["timesteps"], row["score"]) for row in run.curve] for run in (complete, Run.read(copied))]
    assert scores[0] == scores[1]
    assert [int(path.name) for path in folders(copied / "best")] == [complete.best["timesteps"]]


def test_first_weights_do_not_depend_on_the_number_of_threads() -> None:
    run = Run.new(RunSettings(algo="ppo", hyperparameters=WIDE, suite="standard", timesteps=16, n_envs=2, interval=16))
    found = []
    for n_threads in (1, 2):
        torch.set_num_threads(n_threads)
        model = start(run)
        found.append(model.get_parameters()["policy"])
        model.get_env().close()
    assert same(*found)


def test_export_describes_the_policy_that_it_writes(
    copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, entry = copied, tmp_path / "entry"
    (best,) = folders(folder / "best")
    run = Run.read(folder)
    # A row with a better score whose policy is not there, as an interruption may leave it.
    other = next(row for row in run.curve if row["timesteps"] != int(best.name))
    other["score"] = run.best["score"] + 1.0
    run.write(folder)
    export(folder, entry, name="mine")
    (row,) = (row for row in run.curve if row["timesteps"] == int(best.name))
    assert f"| {row['score']:.1f} on 2 scenarios" in (entry / "README.md").read_text()
    text = (entry / "entry.toml").read_text()
    assert f"for {int(best.name)} steps" in text
    assert f'trained_on = "standard, split train, {int(best.name)} steps; chosen on split validation"' in text

    def fails(*_: Any) -> Any:
        raise AssertionError("the work was begun")

    monkeypatch.setattr("agents.export._trained", fails)
    for name in ("a|b", " a", "x" * 61, "Fast Droop"):
        assert export_command([str(folder), "--output", str(tmp_path / "other"), "--name", name]) == 2
        assert "entry's name must " in capsys.readouterr().err
    run.curve.remove(row)
    run.write(folder)
    assert export_command([str(folder), "--output", str(tmp_path / "other")]) == 2
    assert "resume it first" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("file", ["policy.onnx", "README.md", "entry.toml"])
def test_export_replaces_files_only_when_told(
    file: str, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = tmp_path / "entry"
    entry.mkdir()
    (entry / file).write_text("kept")
    command = [str(whole), "--output", str(entry), "--name", "mine"]
    assert export_command(command) == 2
    assert f"{entry} has {file} already; --overwrite replaces" in capsys.readouterr().err
    assert [(path.name, path.read_text()) for path in entry.iterdir()] == [(file, "kept")]
    assert export_command([*command, "--overwrite"]) == 0
    assert load_entries(entry)[0].name == "mine"
    assert b"kept" not in (entry / file).read_bytes()


@pytest.mark.parametrize(
    ("algo", "policy_kwargs", "text"),
    [
        ("ppo", "dict(net_arch=[8], squash_output=True)", "cannot export actions of StateDependentNoise"),
        ("recurrent_ppo", "dict(lstm_kwargs=dict(bias=False))", "cannot export an LSTM with {'bias': False"),
        ("ppo", "dict(net_arch=5)", "ppo refuses its hyperparameters"),
    ],
)
def test_policies_that_could_not_be_exported_are_refused_at_the_start(
    algo: str, policy_kwargs: str, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, new = config_file(tmp_path, algo, policy_kwargs=policy_kwargs), tmp_path / "new"
    assert main([*V0, "--algo", algo, "--config", config, "--output", str(new)]) == 2
    error = capsys.readouterr().err
    assert text in error and error.count("\n") == 1 and not new.exists()


def test_other_versions_are_refused_on_resumption_unless_they_are_allowed(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    run = Run.new(Run.read(whole).settings)
    now = run.provenance
    run.provenance = {**now, "source_hash": "0" * 64, "suite_hash": "1" * 64, "versions": {**now["versions"]}}
    run.provenance["versions"]["torch"] = "0.1"
    run.write(folder)
    before = (folder / "run.json").read_bytes()
    capsys.readouterr()
    assert main(["--resume", str(folder)]) == 2
    error = capsys.readouterr().err
    for text in ("source hash was 000000000000", "suite hash was 111111111111", "torch was 0.1", "--allow-other-"):
        assert text in error
    assert error.count("\n") == 1 and (folder / "run.json").read_bytes() == before
    assert main(["--resume", str(folder), "--allow-other-versions"]) == 0
    after = Run.read(folder)
    assert after.resumed == 1 and len(after.resumptions) == 1
    assert len(after.resumptions[0]["differences"]) == 3 and after.resumptions[0]["source_hash"] == now["source_hash"]
    # The process before is what the next one is compared with; a finished run is not gone on with.
    assert main(["--resume", str(folder)]) == 0
    assert (Run.read(folder).resumed, len(Run.read(folder).resumptions)) == (1, 1)
    assert main([*options(tmp_path, "ppo"), "--output", str(tmp_path / "new"), "--allow-other-versions"]) == 2


def test_folder_is_of_one_process_and_refuses_what_cannot_go_on(
    copied: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copied
    with held(folder):
        assert main(["--resume", str(folder)]) == 2
    assert f"another process trains in {folder}" in capsys.readouterr().err
    with new_folder(tmp_path / "new"):
        assert main([*options(tmp_path, "ppo"), "--output", str(tmp_path / "new")]) == 2
    assert "another process trains in" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    shutil.rmtree(folder / "checkpoints")
    assert main(["--resume", str(folder)]) == 2
    error = capsys.readouterr().err
    assert "no checkpoint to go on from" in error and error.count("\n") == 1


def test_another_seed_gives_other_weights(whole: Path, tmp_path: Path) -> None:
    assert main([*options(tmp_path, "ppo"), "--seed", "1", "--output", str(tmp_path / "two")]) == 0
    assert Run.read(tmp_path / "two").settings.seed == 1
    assert not same(weights(whole, "ppo"), weights(tmp_path / "two", "ppo"))


def test_comparison_of_policies_finds_a_difference() -> None:
    settings = RunSettings(algo="ppo", hyperparameters={}, suite="standard", timesteps=1, n_envs=1, interval=1)

    class Still:
        def __init__(self, value: float) -> None:
            self.value = value

        def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
            return np.full((len(observation), 4), self.value), state

    assert largest_difference(Still(0.0), Still(2e-6), settings) == 2e-6


def test_run_describes_itself_and_tensorboard_shows_the_grid(whole: Path) -> None:
    data = json.loads((whole / "run.json").read_text())
    assert data["settings"]["action_mode"] == "k+tau" and data["settings"]["hyperparameters"]["n_steps"] == 8
    assert {"command", "git_commit", "suite_hash", "source_hash", "versions"} <= data["provenance"].keys()
    events = EventAccumulator(str(whole / "tensorboard"))
    events.Reload()
    shown = set(events.Tags()["scalars"])
    keys = ("nadir_hz", "largest_rocof_hz_s", "duty_error_percent", "failure", "cost_frequency", "cost_failure")
    assert {"rollout/ep_rew_mean", "validation/score", *(f"episode/{key}" for key in keys)} <= shown
    # The only episode that ends in so short a run is the last seconds of one, with its frequency above nominal.
    assert 50.0 < events.Scalars("episode/nadir_hz")[-1].value < 50.5


def test_folder_is_complete_or_not_there(tmp_path: Path) -> None:
    save_folder(tmp_path, 1, lambda path: (path / "a").write_text("1"))

    def fails(path: Path) -> None:
        (path / "a").write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        save_folder(tmp_path, 2, fails)
    assert [path.name for path in folders(tmp_path)] == [f"{1:012d}"]
    save_folder(tmp_path, 3, lambda path: (path / "a").write_text("3"))
    assert [path.name for path in folders(tmp_path)] == [f"{3:012d}"]
    assert {path.name for path in tmp_path.iterdir()} == {f"{3:012d}"}
    # A second one of the same step is the same policy.
    save_folder(tmp_path, 3, fails)
    assert [(path / "a").read_text() for path in folders(tmp_path)] == ["3"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "--output FOLDER is needed"),
        (["--output", "new"], "--algo is needed"),
        (["--algo", "dqn", "--output", "new"], "invalid choice"),
        (["--algo", "ppo", "--output", "."], "not an empty folder"),
        (["--algo", "ppo", "--output", "new", "--timesteps", "0"], "error: --timesteps must be a whole number, 1"),
        (["--algo", "ppo", "--output", "new", "--validation-episodes", "101"], r"--validation-episodes .* 1 … 100"),
        ([*V0, "--algo", "ppo", "--output", "new", "--config", "bad.yml", "--n-envs", "2"], "bad.yml: n_envs must be"),
        (
            [*V0, "--algo", "ppo", "--output", "new", "--config", "many.yml"],
            "error: n_envs must be a whole number, 1 … 1000",
        ),
        (["--algo", "ppo", "--output", "new", "--suite", "paper"], "fixed list of cases"),
        (["--algo", "ppo", "--output", "new", "--config", "no.yml"], "cannot read the hyperparameter file"),
        (["--resume", "no-such-run"], "cannot read the description of the run"),
        (["--resume", "no-such-run", "--seed", "1", "--n-envs", "2"], "leave out --n-envs, --seed"),
        (["--algo", "ppo", "--output", "/proc/x"], "cannot create the folder /proc/x"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(
    arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, n_envs in (("bad.yml", 0), ("many.yml", 200_000)):
        Path(config_file(tmp_path, "ppo", n_envs=n_envs)).rename(name)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert re.search(text, error), error
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(("suite", "version"), [("standard", "v0"), ("standard-v1", "v1")])
def test_entry_file_names_the_environment_of_a_run(suite: str, version: str) -> None:
    settings = RunSettings(algo="ppo", hyperparameters={}, suite=suite, timesteps=1, n_envs=1, interval=1)
    assert entry_values(settings, 1)["environment"] == f"GFMWTG-14bus-{version}"


@pytest.mark.parametrize(
    ("suite", "scale"),
    [
        ("weak-grid", "(mppt 0, coordinated-piecewise 100)"),
        ("gusty-v1", "(coordinated-piecewise 0, coordinated-tuned 100)"),
    ],
)
def test_model_card_names_the_scale_and_the_suite_of_its_run(suite: str, scale: str) -> None:
    settings = RunSettings(algo="ppo", hyperparameters={}, suite=suite, timesteps=1, n_envs=1, interval=1)
    row = dict.fromkeys(("timesteps", "wall_time_s", "score", "cost", "failures_percent"), 1.0)
    row |= dict.fromkeys(("nadir_hz", "rocof_hz_s", "duty_error_percent"), 1.0)
    run = Run.new(settings)
    run.curve.append(row)
    card = _model_card(run, row, "mine", (), b"")
    assert scale in card and f"--entries FOLDER --suite {suite}\n" in card
