"""Facts about files that are written whole, and about sections between markers."""

from __future__ import annotations

from pathlib import Path

import pytest

from wtg_gym.files import update_between_markers, write_together

NAME = "leaderboard:standard"
START, END = f"<!-- {NAME}:start -->", f"<!-- {NAME}:end -->"


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_only_what_is_between_the_markers_changes(tmp_path: Path, newline: str) -> None:
    path = tmp_path / "README.md"
    path.write_bytes(newline.join(["# Title ä", START, "old", "older", END, "end  "]).encode())
    assert update_between_markers(path, "| a |\n| b |", NAME)
    assert path.read_bytes() == newline.join(["# Title ä", START, "| a |", "| b |", END, "end  "]).encode()
    assert not update_between_markers(path, "| a |\n| b |", NAME)


@pytest.mark.parametrize("text", ["", START, END, f"{END}\n{START}", f"{START}\n{START}\n{END}"])
def test_missing_markers_are_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "README.md"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"README.md must have the markers <!-- leaderboard:standard:start --> and"):
        update_between_markers(path, "table", NAME)
    assert path.read_text() == text


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nowhere\.md"):
        update_between_markers(tmp_path / "nowhere.md", "table", NAME)


def test_permissions_and_links_survive(tmp_path: Path) -> None:
    path, link = tmp_path / "README.md", tmp_path / "link.md"
    path.write_text(f"{START}\n{END}\n")
    path.chmod(0o640)
    link.symlink_to(path)
    update_between_markers(link, "table", NAME)
    assert link.is_symlink() and path.stat().st_mode & 0o777 == 0o640
    assert "table" in path.read_text()


@pytest.mark.parametrize("blocked", ["first", "second"])
def test_files_that_belong_together_are_replaced_all_or_none(tmp_path: Path, blocked: str) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    write_together({first: "old", second: b"old too"})
    (tmp_path / blocked).unlink()
    (tmp_path / blocked).mkdir()
    left = {path: path.is_dir() or path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(IsADirectoryError, match="directory") as caught:
        write_together({first: "new", second: "new"})
    assert caught.value.filename == str(tmp_path / blocked)
    assert {path: path.is_dir() or path.read_bytes() for path in tmp_path.iterdir()} == left
