"""Facts about training: it is reproducible, survives a kill, and its export plays as the learner does."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import agents.train
from agents.export import _model_card, export
from agents.export import main as export_command
from agents.folders import folders, held, save_folder
from agents.hyperparameters import ALGORITHMS
from agents.learners import load_checkpoint
from agents.runs import Run, RunSettings
from agents.train import TRAINED, main
from agents.training import entry_values
from tests.agents.small import V0, config_file, largest_difference, options, stopped_after, trained
from tests.interruption import end, interrupted
from wtg_gym.evaluation import load_entries
from wtg_gym.policies.gate import check_submission
from wtg_gym.policies.sb3_archive import CUSTOM_OBJECTS, NormalizedPolicy

ROOT = Path(__file__).resolve().parents[2]


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
    own = ALGORITHMS["ppo" if algo == "ippo" else algo]
    return own.load(path / "model.zip", custom_objects=CUSTOM_OBJECTS).get_parameters()


def same(a: Any, b: Any) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    return torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b


@pytest.mark.parametrize("algo", TRAINED)
def test_interrupted_run_goes_on_to_the_weights_of_an_undisturbed_one_and_passes_the_gate(
    algo: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The last of the policies counts as the best: the gate takes the first ones for the law itself.
    monkeypatch.setattr(Run, "best", property(lambda run: run.curve[-1]))
    undisturbed = trained(tmp_path, algo, "undisturbed")
    stopped = stopped_after(256, undisturbed, tmp_path / "stopped")
    assert main(["--resume", str(stopped)]) == 0
    assert same(weights(stopped, algo), weights(undisturbed, algo))
    runs = [Run.read(folder) for folder in (stopped, undisturbed)]
    curves = [[{**row, "wall_time_s": 0.0} for row in run.curve] for run in runs]
    assert curves[0] == curves[1]
    assert [(run.finished, run.resumed) for run in runs] == [(True, 1), (True, 0)]
    assert [row["timesteps"] for row in runs[0].curve] == [0, 256, 512, 768]
    export(stopped, tmp_path / "entry", name="mine", authors=["A. Author"])
    report = check_submission(tmp_path / "entry")
    assert report.accepted, report.refusal
    (entry,) = load_entries(tmp_path / "entry")
    assert (entry.name, entry.training_seed, entry.kind, entry.source) == ("mine", 0, "learned", "A. Author")
    # The run's own best policy is the same entry.
    (best,) = folders(stopped / "best")
    assert (best / "policy.onnx").read_bytes() == (tmp_path / "entry" / "policy.onnx").read_bytes()


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_export_gives_the_actions_of_the_learner(algo: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    # The last of the policies counts as the best.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Run, "best", property(lambda run: run.curve[-1]))
        assert main([*options(tmp_path, algo), "--output", str(folder)]) == 0
    run = Run.read(folder)
    export(folder, tmp_path / "entry")
    (path,), (entry,) = folders(folder / "checkpoints"), load_entries(tmp_path / "entry")
    model = load_checkpoint(path, algo, "cpu")
    learner = NormalizedPolicy(model.policy, model.get_vec_normalize_env())
    assert largest_difference(learner, entry.policy, run.settings) <= 1e-6
    model.get_env().close()


def test_killed_process_leaves_a_run_that_goes_on_to_the_same_weights(whole: Path, tmp_path: Path) -> None:
    killed = tmp_path / "killed"
    command = [sys.executable, "-m", "agents.train", *options(tmp_path, "ppo"), "--output", str(killed)]
    process = subprocess.Popen(command, cwd=ROOT)
    end(process, signal.SIGKILL, (killed / "checkpoints" / f"{256:012d}").exists)
    assert process.returncode == -signal.SIGKILL
    assert main(["--resume", str(killed)]) == 0
    assert same(weights(killed, "ppo"), weights(whole, "ppo"))


def test_run_stopped_at_or_before_its_first_checkpoint_goes_on_to_the_same_weights(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped = stopped_after(0, whole, tmp_path / "stopped")
    before = tmp_path / "before"
    monkeypatch.setattr("agents.train.configure", interrupted(agents.train.configure))
    assert main([*options(tmp_path, "ppo"), "--output", str(before)]) == 130
    assert {path.name for path in before.iterdir()} == {"run.json", ".lock"}
    monkeypatch.undo()
    for folder in (stopped, before):
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


def test_another_seed_gives_other_weights(whole: Path, tmp_path: Path) -> None:
    assert main([*options(tmp_path, "ppo"), "--seed", "1", "--output", str(tmp_path / "two")]) == 0
    assert not same(weights(whole, "ppo"), weights(tmp_path / "two", "ppo"))


def test_export_describes_the_policy_that_it_writes_and_replaces_files_only_when_told(
    copied: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry, command = tmp_path / "entry", [str(copied), "--output", str(tmp_path / "entry"), "--name", "mine"]
    (best,) = folders(copied / "best")
    run = Run.read(copied)
    (row,) = (row for row in run.curve if row["timesteps"] == int(best.name))
    # A row with a better score whose policy is not there, as an interruption may leave it.
    next(other for other in run.curve if other is not row)["score"] = row["score"] + 1.0
    run.write(copied)
    assert export_command(command) == 0
    assert f"| {row['score']:.1f} on 2 scenarios" in (entry / "README.md").read_text()
    text = f'trained_on = "standard, split train, {int(best.name)} steps; chosen on split validation"'
    assert text in (entry / "entry.toml").read_text()
    assert export_command(command) == 2 and "already; --overwrite replaces" in capsys.readouterr().err
    assert export_command([*command, "--overwrite"]) == 0
    for name in ("a|b", " a", "x" * 61, "Fast Droop"):
        assert export_command([str(copied), "--output", str(tmp_path / "other"), "--name", name]) == 2
        assert "entry's name must " in capsys.readouterr().err
    run.curve.remove(row)
    run.write(copied)
    assert export_command([str(copied), "--output", str(tmp_path / "other")]) == 2
    assert "resume it first" in capsys.readouterr().err and not (tmp_path / "other").exists()


def test_other_versions_are_refused_on_resumption_unless_they_are_allowed(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, folder = Run.new(Run.read(whole).settings), tmp_path / "run"
    now = run.provenance
    run.provenance = {**now, "source_hash": "0" * 64, "versions": {**now["versions"], "torch": "0.1"}}
    run.write(folder)
    before = (folder / "run.json").read_bytes()
    assert main(["--resume", str(folder)]) == 2
    error = capsys.readouterr().err
    assert all(text in error for text in ("source hash was 000000000000", "torch was 0.1", "--allow-other-"))
    assert error.count("\n") == 1 and (folder / "run.json").read_bytes() == before
    assert main(["--resume", str(folder), "--allow-other-versions"]) == 0
    after = Run.read(folder)
    assert after.resumed == 1 and len(after.resumptions[0]["differences"]) == 2
    # A finished run is not gone on with.
    assert main(["--resume", str(folder)]) == 0 and Run.read(folder).resumed == 1


def test_folder_is_of_one_process(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with held(copied):
        assert main(["--resume", str(copied)]) == 2
    assert f"another process trains in {copied}" in capsys.readouterr().err
    shutil.rmtree(copied / "checkpoints")
    assert main(["--resume", str(copied)]) == 2
    assert "no checkpoint to go on from" in capsys.readouterr().err


def test_run_describes_itself_and_tensorboard_shows_the_grid(whole: Path) -> None:
    data = json.loads((whole / "run.json").read_text())
    assert data["settings"]["action_mode"] == "k+tau" and data["settings"]["hyperparameters"]["n_steps"] == 8
    assert {"command", "git_commit", "suite_hash", "source_hash", "versions"} <= data["provenance"].keys()
    events = EventAccumulator(str(whole / "tensorboard"))
    events.Reload()
    keys = ("nadir_hz", "largest_rocof_hz_s", "duty_error_percent", "failure", "cost_frequency", "cost_failure")
    shown = {"rollout/ep_rew_mean", "validation/score", *(f"episode/{key}" for key in keys)}
    assert shown <= set(events.Tags()["scalars"])


def test_folder_is_complete_or_not_there(tmp_path: Path) -> None:
    save_folder(tmp_path, 1, lambda path: (path / "a").write_text("1"))

    def fails(path: Path) -> None:
        (path / "a").write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        save_folder(tmp_path, 2, fails)
    assert [path.name for path in folders(tmp_path)] == [f"{1:012d}"]
    save_folder(tmp_path, 3, lambda path: (path / "a").write_text("3"))
    assert {path.name for path in tmp_path.iterdir()} == {f"{3:012d}"}


EDITS: list[Callable[[dict[str, Any]], Any]] = [
    lambda data: data.pop("settings"),
    lambda data: data.update(settings="ppo"),
    lambda data: data["settings"].update(hyperparameters=[1]),
    lambda data: data["settings"].update(suite=[]),
    lambda data: data.update(curve=1),
    lambda data: data["curve"][0].update(score="high"),
    lambda data: data.update(provenance=None),
    lambda data: data.update(winner="me"),
]


def test_a_damaged_file_of_a_run_is_named(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def error_of_resume() -> str:
        capsys.readouterr()
        assert main(["--resume", str(copied)]) == 2
        (line,) = (each for each in capsys.readouterr().err.splitlines() if not each.startswith("wtg_gym comp"))
        return line

    description = copied / "run.json"
    for path in (*sorted(folders(copied / "checkpoints")[-1].iterdir()), description):
        intact = path.read_bytes()
        path.write_bytes(intact[: len(intact) // 2])
        assert str(path) in error_of_resume()
        path.write_bytes(intact)
    intact_text = description.read_text()
    for edit in EDITS:
        data = json.loads(intact_text)
        edit(data)
        description.write_text(json.dumps(data))
        assert str(description) in error_of_resume()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "--output FOLDER is needed"),
        (["--output", "new"], "--algo is needed"),
        (["--algo", "dqn", "--output", "new"], "invalid choice"),
        (["--algo", "ppo", "--output", "."], "not an empty folder"),
        (["--algo", "ppo", "--output", "new", "--timesteps", "0"], "timesteps must be a whole number, 1"),
        (["--algo", "ppo", "--output", "new", "--validation-episodes", "101"], "validation_episodes .* 1 … 100"),
        (["--algo", "ppo", "--output", "new", "--config", "bad.yml"], "bad.yml: n_envs must be"),
        (["--algo", "ppo", "--output", "new", "--config", "net.yml"], "ppo refuses its hyperparameters"),
        (["--algo", "ppo", "--output", "new", "--config", "no.yml"], "cannot read the hyperparameter file"),
        (["--algo", "ppo", "--output", "new", "--suite", "paper"], "fixed list of cases"),
        (["--algo", "ppo", "--output", "new", "--suite", "storm"], "unknown suite 'storm'"),
        (["--algo", "td3", "--output", "new", "--suite", "standard-v1"], "must have a section 'GFMWTG-14bus-v1'"),
        (["--algo", "ppo", "--output", "/proc/x"], "cannot create the folder /proc/x"),
        (["--algo", "ppo", "--output", "new", "--allow-other-versions"], "is for --resume"),
        (["--algo", "ippo", "--n-envs", "7", "--output", "new"], "n_envs must be a whole multiple of the 2 WTG groups"),
        (["--algo", "ippo", "--observation-mode", "privileged", "--output", "new"], "leave out --observation-mode"),
        (["--algo", "ippo", "--groups", "0", "--output", "new"], "group"),
        (["--algo", "ippo", "--sensors", "exact", "--output", "new"], "sensors are part of version v1 and later"),
        (["--algo", "ppo", "--suite", "standard-v1", "--sensors", "{}x", "--output", "new"], "sensors must be"),
        (["--resume", "no-such-run"], "cannot read the description of the run"),
        (["--resume", "no-such-run", "--seed", "1", "--n-envs", "2"], "leave out --n-envs, --seed"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(
    arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, changes in (("bad.yml", {"n_envs": 0}), ("net.yml", {"policy_kwargs": "dict(net_arch=5)"})):
        Path(config_file(tmp_path, "ppo", **changes)).rename(name)
    of_v0 = [] if "--resume" in arguments or "--suite" in arguments else V0
    assert main([*of_v0, *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert re.search(text, error), error
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("suite", "environment", "scale"),
    [
        ("weak-grid", "GFMWTG-14bus-v0", "(mppt 0, coordinated-piecewise 100)"),
        ("gusty-v1", "GFMWTG-14bus-v1", "(coordinated-piecewise 0, coordinated-tuned 100)"),
    ],
)
def test_entry_and_model_card_name_version_scale_and_suite(suite: str, environment: str, scale: str) -> None:
    settings = RunSettings(algo="ppo", hyperparameters={}, suite=suite, timesteps=1, n_envs=1, interval=1)
    assert entry_values(settings, 1)["environment"] == environment
    row = dict.fromkeys(("timesteps", "wall_time_s", "score", "cost", "failures_percent"), 1.0)
    row |= dict.fromkeys(("nadir_hz", "rocof_hz_s", "duty_error_percent"), 1.0)
    run = Run.new(settings)
    run.curve.append(row)
    card = _model_card(run, row, "mine", (), b"")
    assert scale in card and f"--entries FOLDER --suite {suite}\n" in card
