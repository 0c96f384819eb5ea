"""The command that makes the shipped policies: what it ships, and that it goes on where it stopped."""

from __future__ import annotations

import re
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agents import export, shipped, train
from agents.runs import Run
from tests.agents.small import options
from wtg_gym.evaluation import load_entries
from wtg_gym.files import sha256

POLICIES = Path(shipped.__file__).parent / "policies"


def test_every_shipped_policy_is_there_and_comes_from_the_command() -> None:
    for name, (setup, seed) in shipped.names().items():
        (entry,) = load_entries(POLICIES / name)
        assert (entry.name, entry.training_seed, entry.kind) == (setup.name, seed, "learned")
        card = (POLICIES / name / "README.md").read_text(encoding="utf-8")
        (line,) = re.findall(rf"^python.* -m {re.escape(setup.command)} (.*)$", card, re.MULTILINE)
        # The options that matter, in whatever order. Without a suite the commits that the cards name trained on v0.
        given = {"--suite": "standard", **dict(zip(line.split()[::2], line.split()[1::2], strict=True))}
        options = dict(zip(setup.options[::2], setup.options[1::2], strict=True))
        assert given == {**options, "--seed": str(seed), "--output": f"runs/{name}"}
        assert sha256((POLICIES / name / "policy.onnx").read_bytes()) in card


def test_nothing_in_agents_is_written_unless_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[str, Path, Path]] = []
    monkeypatch.setattr(shipped, "_make", lambda *given: made.append(given))
    monkeypatch.chdir(tmp_path)
    assert shipped.main(["--only", "ppo-k-0"]) == 0
    assert made == [("ppo-k-0", Path("runs"), Path("runs/policies"))]


def test_command_without_a_choice_lists_and_trains_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shipped, "_make", lambda *given: pytest.fail("trained"))
    monkeypatch.chdir(tmp_path)
    assert shipped.main([]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[0] for row in rows] == list(shipped.names()) and not list(tmp_path.iterdir())
    # As the model cards say.
    assert all(float(row.split()[-2].replace(",", "")) > 60.0 for row in rows)


def test_command_trains_exports_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock = threading.Lock()

    def run_here(command: list[str], **_: Any) -> SimpleNamespace:
        """Run `python -m MODULE …` in this process, one at a time."""
        with lock:
            main = {"agents.train": train.main, "agents.export": export.main}[command[2]]
            return SimpleNamespace(returncode=main(command[3:]))

    tiny = shipped.Shipped("tiny", "Tiny", "A test.", (*options(tmp_path, "ppo"), "--timesteps", "256"), 2)
    monkeypatch.setattr(shipped, "SHIPPED", (tiny,))
    monkeypatch.setattr(shipped, "subprocess", SimpleNamespace(run=run_here))
    folders = ["--runs", str(tmp_path / "runs"), "--policies", str(tmp_path / "policies")]
    assert shipped.main(["--only", "tiny-1", *folders]) == 0
    first = (tmp_path / "policies" / "tiny-1" / "policy.onnx").read_bytes()
    assert shipped.main(["--all", "--jobs", "2", *folders]) == 0
    assert (tmp_path / "policies" / "tiny-1" / "policy.onnx").read_bytes() == first
    assert [load_entries(tmp_path / "policies" / f"tiny-{seed}")[0].training_seed for seed in range(2)] == [0, 1]
    assert Run.read(tmp_path / "runs" / "tiny-1").finished


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--only", "ppo-9"], "unknown ppo-9; known: ppo-k+tau-0"),
        (["--all", "--only", "ppo-k-0"], "not allowed with argument"),
        (["--all", "--jobs", "0"], "--jobs = 0 is outside the allowed range 1 … 64"),
    ],
)
def test_bad_options_are_refused(arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert shipped.main(arguments) == 2
    assert text in capsys.readouterr().err
