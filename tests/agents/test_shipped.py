"""The shipped policies come from the commands that are printed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from agents import shipped
from wtg_gym.evaluation import load_entries
from wtg_gym.files import sha256

POLICIES = Path(shipped.__file__).parent / "policies"


def pairs(words: list[str]) -> dict[str, str]:
    return dict(zip(words[::2], words[1::2], strict=True))


def test_every_shipped_policy_is_there_and_comes_from_its_command(capsys: pytest.CaptureFixture[str]) -> None:
    shipped.main()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 39 and all(" && python -m agents.export runs/" in line for line in lines)
    for name, (module, *given) in shipped.commands().items():
        (entry,) = load_entries(POLICIES / name)
        assert (str(entry.training_seed), entry.kind) == (name.rpartition("-")[2], "learned")
        card = (POLICIES / name / "README.md").read_text(encoding="utf-8")
        (line,) = re.findall(rf"^python.* -m {re.escape(module)} (.*)$", card, re.MULTILINE)
        # In whatever order. Without a suite the commits that the cards name trained on v0.
        assert {"--suite": "standard", **pairs(line.split())} == pairs(given)
        assert sha256((POLICIES / name / "policy.onnx").read_bytes()) in card
