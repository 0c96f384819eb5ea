"""A training run with a damaged file names it in one line, and nothing of the run is touched."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from agents.folders import folders
from agents.train import main
from tests.agents.small import trained

#: All that a checkpoint of this learner consists of.
FILES = ("state.pkl", "vec_normalize.pkl", "model.zip", "replay_buffer.pkl")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained(tmp_path_factory.mktemp("runs"), "sac", "run")


def error_of_resume(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert main(["--resume", str(folder)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("wtg_gym comp")]
    assert len(lines) == 1 and lines[0].startswith("error: ")
    return lines[0]


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_of_a_checkpoint_is_named(
    run_folder: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = folders(run_folder / "checkpoints")[-1] / name
    intact = path.read_bytes()
    path.write_bytes(intact[: len(intact) // 2])
    assert str(path) in error_of_resume(run_folder, capsys)
    path.unlink()
    assert str(path) in error_of_resume(run_folder, capsys)
    path.write_bytes(intact)


EDITS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "no settings": lambda data: data.pop("settings"),
    "settings as text": lambda data: data.update(settings="ppo"),
    "hyperparameters as a list": lambda data: data["settings"].update(hyperparameters=[1]),
    "suite as a list": lambda data: data["settings"].update(suite=[]),
    "curve as a number": lambda data: data.update(curve=1),
    "row without a score": lambda data: data["curve"][0].pop("score"),
    "score as text": lambda data: data["curve"][0].update(score="high"),
    "provenance as null": lambda data: data.update(provenance=None),
    "versions as a list": lambda data: data["provenance"].update(versions=[]),
    "hash as a number": lambda data: data["provenance"].update(source_hash=1),
    "resumed as text": lambda data: data.update(resumed="once"),
    "unknown key": lambda data: data.update(winner="me"),
}


@pytest.mark.usefixtures("one_thread")
def test_a_description_of_a_run_with_wrong_values_is_named(
    run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = run_folder / "run.json"
    intact = path.read_text()
    texts = [intact[: len(intact) // 2], "[]", "null", "[" * 5000]
    for edit in EDITS.values():
        data = json.loads(intact)
        edit(data)
        texts.append(json.dumps(data))
    for text in texts:
        path.write_text(text)
        assert str(path) in error_of_resume(run_folder, capsys)
    path.write_text(intact)
