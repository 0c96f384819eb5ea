"""`wtg-gym reproduce` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.calls import error_of
from wtg_gym.cli import main


def _page(path: Path, *sections: str) -> Path:
    markers = [f"<!-- {name}:start -->\n<!-- {name}:end -->" for name in sections]
    path.write_text("# Page\n\n" + "\n\ntext\n\n".join(markers) + "\nend\n", encoding="utf-8")
    return path


def test_reproduce_writes_claims_and_every_figure(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = tmp_path / "docs" / "out"
    folder.parent.mkdir()
    page = _page(tmp_path / "docs" / "page.md", "claims", "figures")
    assert main(["reproduce", "--output", str(folder), "--formats", "svg", "--page", str(page)]) == 0
    said = capsys.readouterr().out
    claims = json.loads((folder / "claims.json").read_text(encoding="utf-8"))["claims"]
    assert len(claims) == said.count(" holds\n") + said.count("DOES NOT HOLD\n") == 30
    figures = {path.stem for path in (folder / "figures").iterdir()}
    assert figures == {
        "bode-comparison",
        "bode-proposed",
        *(f"characteristic-{n}" for n in ("mppt", "deloaded-5", "deloaded-10", "coordinated-piecewise")),
        "load-decrease",
        "load-increase",
        "power-coefficient",
    }
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# Page\n") and text.endswith("\nend\n") and "\ntext\n" in text
    assert all(f"(out/figures/{name}.svg)" in text for name in figures)
    assert text.count(" | holds") == sum(claim["holds"] for claim in claims)
    assert all(claim["measured"] in text for claim in claims)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("reproduce", "--page", "nowhere.md"), "--page: cannot read the file with the markers nowhere.md"),
        (("reproduce", "--formats", "jpg"), "invalid choice"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str) -> None:
    assert said in error_of(capsys, *arguments)


def test_folder_that_cannot_be_written_is_refused_before_anything_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("x")
    assert "is not a folder" in error_of(capsys, "reproduce", "--output", str(tmp_path / "file"))


def test_page_without_markers_is_refused_and_left_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    page = _page(tmp_path / "page.md", "claims")
    before = page.read_bytes()
    assert "must have the markers <!-- figures:start -->" in error_of(
        capsys, "reproduce", "--page", str(page), "--output", str(tmp_path / "out")
    )
    assert page.read_bytes() == before and not (tmp_path / "out").exists()
