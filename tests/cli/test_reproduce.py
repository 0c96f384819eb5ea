"""`wtg-gym reproduce` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from wtg_gym.cli import main


def test_reproduce_writes_claims_and_every_figure(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["reproduce", "--output", str(tmp_path), "--formats", "svg"]) == 0
    said = capsys.readouterr().out
    claims = json.loads((tmp_path / "claims.json").read_text(encoding="utf-8"))["claims"]
    assert len(claims) == said.count(" holds\n") + said.count("DOES NOT HOLD\n") == 30
    assert all(claim["measured"] in said for claim in claims)
    figures = {path.stem for path in (tmp_path / "figures").iterdir()}
    assert len(figures) == 9 and {"bode-proposed", "load-increase", "power-coefficient"} <= figures
