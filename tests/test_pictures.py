"""The check of pictures names stale ones, and passes those that differ within its tolerance only."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.pictures import NOT_REPEATED, difference, differences, main
from wtg_gym.plotting import save_figure
from wtg_gym.reproduce.figures import plot_bode
from wtg_gym.reproduce.loops import ideal_source_loop

DOCS = Path(__file__).resolve().parent.parent / "docs"
DRAWING = "validation/figures/bode-proposed.svg"


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A copy of the committed pictures, in place of ones drawn anew."""
    folder = tmp_path / "docs"
    shutil.copytree(DOCS, folder)
    for name in NOT_REPEATED:
        (folder / name).unlink()
    return folder


def change(path: Path, pattern: str, replacement: str) -> None:
    """Replace the first match of a pattern in a drawing."""
    text, n = re.subn(pattern, replacement, path.read_text(encoding="utf-8"), count=1)
    assert n == 1
    path.write_text(text, encoding="utf-8")


def test_equal_pictures_pass(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(DOCS), str(made)]) == 0
    assert "are what their commands draw" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("pattern", "replacement", "said"),
    [
        ("#0072b2", "#0072b3", "other shapes, texts or styles"),
        ("stroke-width: 1.1", "stroke-width: 1.6", "is 0.5 off"),
        ("undamped", "damped", "other shapes, texts or styles"),
        (r"55\.4°", "55.2°", "is 0.2 off"),
    ],
)
def test_a_drawing_of_another_colour_line_or_text_is_named(
    made: Path, capsys: pytest.CaptureFixture[str], pattern: str, replacement: str, said: str
) -> None:
    change(made / DRAWING, pattern, replacement)
    assert main([str(DOCS), str(made)]) == 1
    (line, *_) = capsys.readouterr().out.splitlines()
    assert line.startswith(f"{DOCS}/{DRAWING}: ") and said in line


def test_a_drawing_with_other_curves_is_named(tmp_path: Path) -> None:
    for gain in (1.4, 1.6):
        save_figure(plot_bode({"ideal-source": ideal_source_loop(gain)}), tmp_path / f"gain-{gain}", ["svg"])
    assert difference(tmp_path / "gain-1.4.svg", tmp_path / "gain-1.6.svg")


def test_the_last_digits_and_hashed_names_of_a_drawing_do_not_matter(made: Path) -> None:
    path = made / DRAWING
    hashed = re.search(r'id="([a-z][0-9a-f]{10})"', path.read_text(encoding="utf-8"))
    assert hashed is not None
    path.write_text(path.read_text(encoding="utf-8").replace(hashed[1], "p0123456789"), encoding="utf-8")
    change(path, r"(\d\.\d\d\d)\d\d\d", r"\g<1>999")
    assert differences(DOCS, made) == []


def test_a_line_through_other_points_on_the_same_course_is_the_same_line(made: Path) -> None:
    path = made / DRAWING
    # Of a path with many points the second one: a frame has four.
    change(path, r'(d="M \S+ \S+ )\nL \S+ \S+ ((?:\nL \S+ \S+ ){5})', r"\1\2")
    assert differences(DOCS, made) == []
    change(path, r'(d="M \S+ \S+ )\nL (\S+) \S+ ((?:\nL \S+ \S+ ){5})', r"\1\nL \2 200 \3")
    (line,) = differences(DOCS, made)
    assert re.fullmatch(rf"{DRAWING}: a line is \d+\.\d pt off", line)


def test_a_picture_with_a_moved_line_is_named_and_a_shade_is_not(made: Path) -> None:
    name = "images/render.png"
    with Image.open(DOCS / name) as picture:
        pixels = np.array(picture.convert("RGB"))
    shaded = pixels.astype(np.int16) + 8
    Image.fromarray(np.clip(shaded, 0, 255).astype(np.uint8)).save(made / name)
    assert differences(DOCS, made) == []
    pixels[100, 400:450] = (0, 99, 166)
    Image.fromarray(pixels).save(made / name)
    assert differences(DOCS, made) == [f"{name}: 50 pixels have another colour"]


def test_a_picture_without_a_command_and_one_that_was_not_committed_are_named(made: Path) -> None:
    (made / DRAWING).rename(made / "new.svg")
    assert differences(DOCS, made) == [
        "new.svg: its command draws it, but it is not there",
        f"{DRAWING}: no command draws it",
    ]
