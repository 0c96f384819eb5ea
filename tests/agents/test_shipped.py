"""The shipped policies are what their model cards say, and the command makes them by these."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from agents import export, shipped, train
from agents.runs import Run
from tests.agents.small import options
from wtg_gym.evaluation import load_entries
from wtg_gym.files import sha256


def test_every_shipped_policy_is_the_one_of_its_model_card() -> None:
    commands = shipped.commands()
    assert len(commands) == 39
    for name, (_, *words) in commands.items():
        (entry,), given = load_entries(shipped.POLICIES / name), dict(zip(words[::2], words[1::2], strict=True))
        assert (given["--seed"], given["--output"]) == (name.rpartition("-")[2], f"runs/{name}")
        assert (str(entry.training_seed), entry.kind) == (given["--seed"], "learned")
        assert given.get("--action-mode", "k+tau") == entry.action_mode
        assert given["--suite"] == ("standard-v1" if entry.environment.endswith("v1") else "standard")
        card = (shipped.POLICIES / name / "README.md").read_text(encoding="utf-8")
        assert sha256((shipped.POLICIES / name / "policy.onnx").read_bytes()) in card


def test_command_trains_exports_goes_on_and_writes_into_runs_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run_here(command: list[str], **_: Any) -> SimpleNamespace:
        """Run `python -m MODULE …` in this process."""
        main = {"agents.train": train.main, "agents.export": export.main}[command[2]]
        return SimpleNamespace(returncode=main(command[3:]))

    given = ["agents.train", *options(tmp_path, "ppo"), "--timesteps", "256", "--output", "runs/ppo-k-0"]
    monkeypatch.setattr(shipped, "commands", lambda: {"ppo-k-0": given})
    monkeypatch.setattr(shipped, "subprocess", SimpleNamespace(run=run_here))
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert shipped.main(["ppo-k-0"]) == 0
    assert Run.read(tmp_path / "runs" / "ppo-k-0").finished
    assert load_entries(tmp_path / "runs" / "policies" / "ppo-k-0")[0].name == "PPO (k)"
    capsys.readouterr()
    assert shipped.main([]) == 0 and capsys.readouterr().out == "ppo-k-0\n"
    assert shipped.main(["ppo-9"]) == 2 and "unknown ppo-9; known: ppo-k-0" in capsys.readouterr().err
