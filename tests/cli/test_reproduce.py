"""`wtg-gym reproduce` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from wtg_gym.cli import main


def test_reproduce_writes_claims_and_every_figure(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder, page = tmp_path / "docs" / "out", tmp_path / "docs" / "page.md"
    folder.parent.mkdir()
    markers = [f"<!-- {name}:start -->\n<!-- {name}:end -->" for name in ("claims", "figures")]
    page.write_text("# Page\n\n" + "\n\ntext\n\n".join(markers) + "\nend\n", encoding="utf-8")
    assert main(["reproduce", "--output", str(folder), "--formats", "svg", "--page", str(page)]) == 0
    said = capsys.readouterr().out
    claims = json.loads((folder / "claims.json").read_text(encoding="utf-8"))["claims"]
    assert len(claims) == said.count(" holds\n") + said.count("DOES NOT HOLD\n") == 30
    figures = {path.stem for path in (folder / "figures").iterdir()}
    assert len(figures) == 9 and {"bode-proposed", "load-increase", "power-coefficient"} <= figures
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# Page\n") and text.endswith("\nend\n") and "\ntext\n" in text
    assert all(f"(out/figures/{name}.svg)" in text for name in figures)
    assert text.count(" | holds") == sum(claim["holds"] for claim in claims)
    assert all(claim["measured"] in text for claim in claims)
