"""The command that makes the shipped policies: what it ships, and that it goes on where it stopped."""

from __future__ import annotations

import re
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


def pairs(words: list[str]) -> dict[str, str]:
    return dict(zip(words[::2], words[1::2], strict=True))


def test_every_shipped_policy_is_there_and_comes_from_the_command() -> None:
    for name, (module, *given) in shipped.commands().items():
        (entry,) = load_entries(POLICIES / name)
        assert (str(entry.training_seed), entry.kind) == (name.rpartition("-")[2], "learned")
        card = (POLICIES / name / "README.md").read_text(encoding="utf-8")
        (line,) = re.findall(rf"^python.* -m {re.escape(module)} (.*)$", card, re.MULTILINE)
        # In whatever order. Without a suite the commits that the cards name trained on v0.
        assert {"--suite": "standard", **pairs(line.split())} == pairs(given)
        assert sha256((POLICIES / name / "policy.onnx").read_bytes()) in card


def test_command_trains_exports_goes_on_and_writes_into_runs_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run_here(command: list[str], **_: Any) -> SimpleNamespace:
        """Run `python -m MODULE …` in this process."""
        main = {"agents.train": train.main, "agents.export": export.main}[command[2]]
        return SimpleNamespace(returncode=main(command[3:]))

    command = " ".join(["agents.train", *options(tmp_path, "ppo"), "--timesteps", "256"])
    monkeypatch.setattr(shipped, "SHIPPED", {"ppo-k": (command, 1)})
    monkeypatch.setattr(shipped, "subprocess", SimpleNamespace(run=run_here))
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert shipped.main(["ppo-k-0"]) == 0
    assert Run.read(tmp_path / "runs" / "ppo-k-0").finished
    assert load_entries(tmp_path / "runs" / "policies" / "ppo-k-0")[0].name == "PPO (k)"
    capsys.readouterr()
    assert shipped.main([]) == 0 and capsys.readouterr().out == "ppo-k-0\n"
    assert shipped.main(["ppo-9"]) == 2 and "unknown ppo-9; known: ppo-k-0" in capsys.readouterr().err
