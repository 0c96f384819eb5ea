"""Facts about training: it is reproducible, survives a kill, and what it exports plays like the learner."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from agents.export import export, largest_difference
from agents.export import main as export_command
from agents.folders import folders, held, new_folder, save_folder
from agents.hyperparameters import ALGORITHMS
from agents.runs import Run, RunSettings
from agents.train import main, train
from tests.agents.small import CONFIGS, config_file, options, trained
from wtg_gym.evaluation import evaluate, load_entries
from wtg_gym.sb3_archive import CUSTOM_OBJECTS

ROOT = Path(__file__).resolve().parents[2]
#: Large enough for torch to use several threads where it may.
WIDE = {**CONFIGS["ppo"], "policy_kwargs": "dict(net_arch=[64, 64])"}


def kill_after_the_second_checkpoint(arguments: list[str], folder: Path) -> None:
    process = subprocess.Popen([sys.executable, "-m", "agents.train", *arguments, "--output", str(folder)], cwd=ROOT)
    deadline = time.monotonic() + 120.0
    while not (folder / "checkpoints" / f"{256:012d}").exists():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.002)
    process.kill()
    assert process.wait() == -signal.SIGKILL


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
def test_killed_run_goes_on_to_the_weights_of_an_undisturbed_one_and_its_export_plays(
    algo: str, tmp_path: Path
) -> None:
    killed, undisturbed = tmp_path / "killed", trained(tmp_path, algo, "undisturbed")
    kill_after_the_second_checkpoint(options(tmp_path, algo), killed)
    assert main(["--resume", str(killed)]) == 0
    assert same(weights(killed, algo), weights(undisturbed, algo))
    runs = [Run.read(folder) for folder in (killed, undisturbed)]
    curves = [[{**row, "wall_time_s": 0.0} for row in run.curve] for run in runs]
    assert curves[0] == curves[1]
    assert [(run.finished, run.resumed) for run in runs] == [(True, 1), (True, 0)]
    assert [row["timesteps"] for row in runs[0].curve] == [0, 256, 512, 768]

    difference = export(killed, tmp_path / "entry", name="mine", authors=["A. Author"])
    assert difference <= 1e-6
    (entry,) = load_entries(tmp_path / "entry")
    assert (entry.name, entry.training_seed, entry.kind, entry.source) == ("mine", 0, "learned", "A. Author")
    results = evaluate([entry], "standard", seeds=[20_000, 20_001], duration_s=5.0)
    assert len(results.episodes_of("mine")) == 2
    card = (tmp_path / "entry" / "README.md").read_text()
    assert all(text in card for text in (algo, "A. Author", "python", f"{runs[0].best['score']:.1f}"))


def test_run_stopped_at_its_first_checkpoint_goes_on_to_the_same_weights(tmp_path: Path) -> None:
    whole, stopped = trained(tmp_path, "ppo", "whole"), tmp_path / "stopped"
    run = Run.new(Run.read(whole).settings)

    def stop(timesteps: int, score: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(run, stopped, stop)
    assert [int(path.name) for path in folders(stopped / "checkpoints")] == [0]
    assert main(["--resume", str(stopped)]) == 0
    assert same(weights(stopped, "ppo"), weights(whole, "ppo"))


def test_run_killed_before_its_first_checkpoint_begins_anew_with_the_same_weights(tmp_path: Path) -> None:
    whole, killed = trained(tmp_path, "ppo", "whole"), tmp_path / "killed"
    assert Run.read(whole).settings.hyperparameters["use_sde"]
    Run.new(Run.read(whole).settings).write(killed)
    assert main(["--resume", str(killed)]) == 0
    assert same(weights(killed, "ppo"), weights(whole, "ppo"))


@pytest.mark.parametrize("missing", ["row", "checkpoint"])
def test_kill_between_two_files_is_mended(missing: str, tmp_path: Path) -> None:
    folder = trained(tmp_path, "ppo", "run")
    complete = Run.read(folder)
    damaged = Run.read(folder)
    del damaged.curve[-1 if missing == "row" else 0 :]
    damaged.write(folder)
    if missing == "checkpoint":
        shutil.rmtree(folder / "checkpoints")
        shutil.rmtree(folder / "best")
    assert main(["--resume", str(folder)]) == 0
    scores = [[(row["timesteps"], row["score"]) for row in run.curve] for run in (complete, Run.read(folder))]
    assert scores[0] == scores[1]
    assert [int(path.name) for path in folders(folder / "best")] == [complete.best["timesteps"]]


_FIRST_WEIGHTS = """
import hashlib, sys
from agents.runs import Run
from agents.train import start
from pathlib import Path
model = start(Run.read(Path(sys.argv[1])))
weights = b"".join(value.numpy().tobytes() for value in model.policy.state_dict().values())
print(hashlib.sha256(weights).hexdigest())
"""


def test_first_weights_do_not_depend_on_the_number_of_threads(tmp_path: Path) -> None:
    settings = RunSettings(algo="ppo", hyperparameters=WIDE, timesteps=16, n_envs=2, interval=16)
    Run.new(settings).write(tmp_path)
    hashes = []
    for n_threads in ("1", "2"):
        command = [sys.executable, "-c", _FIRST_WEIGHTS, str(tmp_path)]
        environment = {**os.environ, "OMP_NUM_THREADS": n_threads}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
        hashes.append(done.stdout)
    assert hashes[0] == hashes[1]


def test_export_describes_the_policy_that_it_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, entry = trained(tmp_path, "ppo", "run"), tmp_path / "entry"
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
    for name in ("a|b", " a", "x" * 61):
        assert export_command([str(folder), "--output", str(tmp_path / "other"), "--name", name]) == 2
        assert "an entry's name must be" in capsys.readouterr().err
    run.curve.remove(row)
    run.write(folder)
    assert export_command([str(folder), "--output", str(tmp_path / "other")]) == 2
    assert "resume it first" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


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
    assert main(["--algo", algo, "--config", config, "--output", str(new)]) == 2
    error = capsys.readouterr().err
    assert text in error and error.count("\n") == 1 and not new.exists()


def test_other_versions_are_refused_on_resumption_unless_they_are_allowed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    run = Run.new(Run.read(trained(tmp_path, "ppo", "whole")).settings)
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
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = trained(tmp_path, "ppo", "run")
    capsys.readouterr()
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


def test_description_is_the_first_file_of_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("agents.train.configure", killed)
    assert main([*options(tmp_path, "ppo"), "--output", str(tmp_path / "run")]) == 130
    assert {path.name for path in (tmp_path / "run").iterdir()} == {"run.json", ".lock"}
    monkeypatch.undo()
    assert main(["--resume", str(tmp_path / "run")]) == 0


def test_another_seed_gives_other_weights(tmp_path: Path) -> None:
    one = trained(tmp_path, "ppo", "one")
    assert main([*options(tmp_path, "ppo"), "--seed", "1", "--output", str(tmp_path / "two")]) == 0
    assert not same(weights(one, "ppo"), weights(tmp_path / "two", "ppo"))


def test_comparison_of_policies_finds_a_difference(tmp_path: Path) -> None:
    run = Run.read(trained(tmp_path, "ppo", "run"))

    class Still:
        def __init__(self, value: float) -> None:
            self.value = value

        def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
            return np.full((len(observation), 4), self.value), state

    assert largest_difference(Still(0.0), Still(2e-6), run.settings) == 2e-6


def test_run_says_what_it_was_and_tensorboard_shows_the_grid(tmp_path: Path) -> None:
    arguments = ["--timesteps", "12800", "--action-mode", "k", "--interval", "12800", "--validation-episodes", "2"]
    folder = tmp_path / "run"
    assert main(["--algo", "ppo", "--config", config_file(tmp_path, "ppo"), *arguments, "--output", str(folder)]) == 0
    data = json.loads((folder / "run.json").read_text())
    assert data["settings"]["action_mode"] == "k" and data["settings"]["hyperparameters"]["n_steps"] == 8
    assert {"command", "git_commit", "suite_hash", "source_hash", "versions"} <= data["provenance"].keys()
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    shown = set(events.Tags()["scalars"])
    keys = ("nadir_hz", "largest_rocof_hz_s", "duty_error_percent", "failure", "cost_frequency", "cost_failure")
    assert {"rollout/ep_rew_mean", "validation/score", *(f"episode/{key}" for key in keys)} <= shown
    assert 45.0 < events.Scalars("episode/nadir_hz")[-1].value < 50.0


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
        (["--algo", "ppo", "--output", "new", "--timesteps", "0"], "timesteps must be a whole number, 1"),
        (["--algo", "ppo", "--output", "new", "--validation-episodes", "101"], r"validation_episodes .* 1 … 100"),
        (["--algo", "ppo", "--output", "new", "--suite", "paper"], "fixed list of cases"),
        (["--algo", "ppo", "--output", "new", "--config", "no.yml"], "cannot read the hyperparameter file"),
        (["--resume", "no-such-run"], "cannot read the description of the run"),
        (["--resume", "no-such-run", "--seed", "1"], "leave out seed"),
        (["--algo", "ppo", "--output", "/proc/x"], "cannot create the folder /proc/x"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(
    arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "something").touch()
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert re.search(text, error), error
    assert not (tmp_path / "new").exists()
