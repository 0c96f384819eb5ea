"""Facts about archives of Stable-Baselines3: played as their exports are, and never opened without --trust-pickle."""

from __future__ import annotations

import base64
import functools
import io
import json
import os
import pickle
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from agents.folders import folders
from agents.hyperparameters import ALGORITHMS as TRAINED
from agents.runs import Run
from tests.agents.small import largest_difference, trained
from tests.cli.calls import ROOT, json_of
from wtg_gym.cli import main
from wtg_gym.evaluation import OnnxPolicy, load_entries
from wtg_gym.policies.sb3_archive import NormalizedPolicy, load_archive

ENV_ID = "GFMWTG-14bus-v0"

TOML = f'name = "mine"\naction_mode = "k+tau"\nenvironment = "{ENV_ID}"\nalgorithm = "PPO"\n'
SHORT = ("--suite", "standard", "--scenarios", "3", "--duration", "10")
#: Width of the local observation of two groups with both actions.
N = 20


#: An archive is played on one thread.
pytestmark = pytest.mark.usefixtures("one_thread", "short_validations")


@pytest.fixture(scope="module")
def archive() -> bytes:
    """A small untrained PPO, as it saves itself."""
    model = PPO("MlpPolicy", gym.make(ENV_ID), policy_kwargs={"net_arch": [8]}, n_steps=8, batch_size=8, device="cpu")
    content = io.BytesIO()
    model.save(content)
    return content.getvalue()


@pytest.fixture(scope="module")
def run_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A short run of an algorithm, trained once."""
    return functools.cache(lambda algo: trained(tmp_path_factory.mktemp(algo), algo))


def archive_of(run: Path, path: Path, algorithm: str) -> Path:
    """The learner in a run's checkpoint as an entry of an archive."""
    (checkpoint,) = folders(run / "checkpoints")
    entry = folder(path, (checkpoint / "model.zip").read_bytes(), TOML.replace('"PPO"', f'"{algorithm}"'))
    shutil.copy(checkpoint / "vec_normalize.pkl", entry)
    return entry


def folder(path: Path, content: bytes, toml: str = TOML) -> Path:
    path.mkdir()
    (path / "entry.toml").write_text(toml)
    (path / "model.zip").write_bytes(content)
    return path


def changed(content: bytes, key: str, pickled: Any) -> bytes:
    """The archive with another pickle under a key of its data."""
    old, new = zipfile.ZipFile(io.BytesIO(content)), io.BytesIO()
    with zipfile.ZipFile(new, "w") as archive:
        for name in old.namelist():
            if name != "data":
                archive.writestr(name, old.read(name))
        data = json.loads(old.read("data"))
        data[key] = {":type:": "harmless", ":serialized:": base64.b64encode(pickle.dumps(pickled)).decode()}
        archive.writestr("data", json.dumps(data))
    return new.getvalue()


class Creates:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("algo", TRAINED)
def test_archive_plays_as_the_policy_that_its_run_exported(
    algo: str, run_of: Callable[[str], Path], tmp_path: Path
) -> None:
    run, name = run_of(algo), TRAINED[algo].__name__
    policy, _ = load_archive(archive_of(run, tmp_path / "archive", name), name)
    (best,) = folders(run / "best")
    onnx, settings = OnnxPolicy(best / "policy.onnx"), Run.read(run).settings
    # Episodes of many lanes, which begin anew at different times: memory and normalisation are in it.
    assert largest_difference(policy, onnx, settings) <= 1e-6
    assert largest_difference(NormalizedPolicy(policy.policy, None), onnx, settings) > 1e-4


def test_policy_goes_to_another_process_as_it_is(run_of: Callable[[str], Path], tmp_path: Path) -> None:
    best = archive_of(run_of("ppo"), tmp_path / "archive", "PPO")
    policy, fingerprint = load_archive(best, "PPO")
    content = pickle.dumps(policy)
    torch.set_num_threads(2)
    other = pickle.loads(content)
    assert torch.get_num_threads() == 1
    observations = np.random.default_rng(0).normal(size=(3, N)).astype(np.float32)
    actions = [each.predict(observations, deterministic=True)[0] for each in (policy, other)]
    assert np.array_equal(*actions)
    # The entry is identified by the bytes that are loaded.
    assert load_archive(best, "PPO")[1] == fingerprint
    (best / "vec_normalize.pkl").unlink()
    assert load_archive(best, "PPO")[1] != fingerprint


_WATCHED = """
import json, os, sys
opened = []
def watch(event, arguments):
    if event == "open":
        opened.append(str(arguments[0]))
sys.addaudithook(watch)
from wtg_gym.cli import main
for command in json.loads(sys.argv[1]):
    assert main(command) in (1, 2), command
assert [name for name in opened if name.endswith((".py", ".pyc"))]
assert not {"model.zip", "vecnormalize.pkl"} & {os.path.basename(name) for name in opened}
assert not {"stable_baselines3", "sb3_contrib", "torch"} & set(sys.modules)
"""


def test_archive_is_not_opened_without_the_flag(archive: bytes, tmp_path: Path) -> None:
    trap = tmp_path / "trap"
    entry = folder(tmp_path / "entry", changed(archive, "lr_schedule", Creates(trap)))
    (entry / "vecnormalize.pkl").write_bytes(pickle.dumps(Creates(trap)))
    scoring = [[command, "--entries", str(entry)] for command in ("evaluate", "leaderboard")]
    submission = [["submission", command, str(entry)] for command in ("check", "score")]
    call = [sys.executable, "-c", _WATCHED, json.dumps([*scoring, *submission])]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}
    done = subprocess.run(call, cwd=tmp_path, env=environment, capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    refusals = [line for line in done.stderr.splitlines() if "was not opened" in line]
    assert len(refusals) == len(scoring) and all("--trust-pickle" in line for line in refusals)
    assert (done.stdout + done.stderr).count("allowed are entry.toml, policy.onnx, README.md") == len(submission)
    assert [path.name for path in tmp_path.iterdir()] == ["entry"]


def test_flag_means_what_it_says(archive: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trap = tmp_path / "trap"
    entry = folder(tmp_path / "entry", changed(archive, "lr_schedule", Creates(trap)))
    summary = json_of(capsys, "evaluate", "--entries", str(entry), "--trust-pickle", *SHORT, "--json")["summary"]
    assert set(summary) == {"mine", "mppt", "coordinated-piecewise"}
    assert trap.is_dir()


def refusal(entry: Path) -> str:
    """Why a folder is refused although its archive may be loaded."""
    with pytest.raises(ValueError) as caught:
        load_entries(entry, load_archive)
    return str(caught.value)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[: len(content) // 2],
        lambda content: b"PK\x05\x06" + bytes(18),
        lambda content: changed(content, "policy_class", 3),
        lambda content: changed(content, "policy_kwargs", {"net_arch": [9]}),
    ],
    ids=["cut short", "empty zip", "pickle", "weights"],
)
def test_damaged_archive_is_named(damage: Callable[[bytes], bytes], archive: bytes, tmp_path: Path) -> None:
    entry = folder(tmp_path / "entry", damage(archive))
    assert f"{entry / 'model.zip'} is no archive of PPO that can be loaded" in refusal(entry)


@pytest.mark.parametrize(
    ("toml", "text"),
    [
        (TOML.replace("PPO", "DQN"), "algorithm must be one of PPO, SAC, TD3, TQC, RecurrentPPO, got 'DQN'"),
        (TOML.replace('"PPO"', '["PPO"]'), "algorithm must be one of PPO"),
        (TOML.replace("PPO", "SAC"), "model.zip is no archive of SAC that can be loaded"),
        (TOML.replace('algorithm = "PPO"\n', ""), "missing: ['algorithm']"),
        (TOML + "training_seed = -1\n", "training_seed"),
    ],
)
def test_wrong_entry_file_says_what_is_allowed(toml: str, text: str, archive: bytes, tmp_path: Path) -> None:
    assert text in refusal(folder(tmp_path / "entry", archive, toml))


def test_archive_that_was_trained_with_another_action_mode_fails_and_says_so(
    archive: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = folder(tmp_path / "entry", archive, TOML.replace("k+tau", "k"))
    assert main(["evaluate", "--entries", str(entry), "--trust-pickle", *SHORT]) == 1
    text = "shape (lanes, 20), got (3, 18): was it trained with another action_mode"
    assert any(text in line for line in capsys.readouterr().err.splitlines())


def test_folder_must_have_one_policy_and_an_entry_file_that_fits_it(archive: bytes, tmp_path: Path) -> None:
    entry = folder(tmp_path / "entry", archive)
    (entry / "policy.onnx").write_bytes(b"")
    assert "has both policy.onnx and model.zip" in refusal(entry)
    (entry / "model.zip").unlink()
    assert "unknown: ['algorithm']" in refusal(entry)
    (entry / "policy.onnx").rename(entry / "model.zip")
    (entry / "entry.toml").unlink()
    assert f"cannot read the entry file {entry / 'entry.toml'}" in refusal(entry)


def test_archive_and_normalisation_of_another_environment_are_refused(archive: bytes, tmp_path: Path) -> None:
    other = folder(tmp_path / "other", b"")
    PPO("MlpPolicy", gym.make("CartPole-v1"), n_steps=8, batch_size=8, device="cpu").save(other / "model.zip")
    assert "must take a list of observations and give a list of actions, -1 … 1" in refusal(other)
    entry = folder(tmp_path / "entry", archive)
    path = entry / "vecnormalize.pkl"
    path.write_bytes(b"no pickle")
    assert f"{path} is no VecNormalize that can be loaded" in refusal(entry)
    path.write_bytes(pickle.dumps([1]))
    assert f"{path} must be the VecNormalize that the policy was trained with" in refusal(entry)
    VecNormalize(DummyVecEnv([lambda: gym.make("CartPole-v1")])).save(str(path))
    assert "for observations of shape (20,); it holds VecNormalize for (4,)" in refusal(entry)
    (entry / "vec_normalize.pkl").write_bytes(b"")
    assert "it has vec_normalize.pkl, vecnormalize.pkl" in refusal(entry)
