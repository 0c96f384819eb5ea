"""`python docs/images/compare.py COMMITTED MADE`: which pictures of a folder are not those that their commands drew.

`make docs-check` draws the pictures into MADE first. The last digits of a number and the shade of a pixel depend on the
machine, so that they are compared within a tolerance.
"""

from __future__ import annotations

import re
import sys
from itertools import zip_longest
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

#: Pictures that no second run repeats: a browser's.
NOT_REPEATED = (
    "images/leaderboard-page.png",
    "images/live-play.png",
)
SUFFIXES = (".png", ".svg")

#: How far coordinates in an SVG may lie apart [pt]: a tenth of a line's width.
_LARGEST_SHIFT_PT = 0.1
#: The same for lines. Long lines are drawn with fewer points than they have, and which ones depends on the machine.
_LARGEST_DISTANCE_PT = 0.5
#: A pixel differs if one of its colours does by more than this, of 255; and so many pixels may.
_LARGEST_SHADE, _N_PIXELS = 32, 20
#: Not the digits of a colour or of a name.
_NUMBER = re.compile(r"(?<![#\w.])(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)")
_PATH = re.compile(r'\bd="([^"]*)"')
#: Names that matplotlib makes of a hash of coordinates.
_HASHED = re.compile(r"\b[a-z][0-9a-f]{10}\b")


def differences(committed: Path, made: Path) -> list[str]:
    """Return a line for every picture of one folder that is missing in the other one, or that looks different there."""
    there, drawn = ({_place(path, folder) for path in _pictures(folder)} for folder in (committed, made))
    lines = [f"{name}: no command draws it" for name in there - drawn - {*NOT_REPEATED}]
    lines += [f"{name}: its command draws it, but it is not there" for name in drawn - there]
    for name in there & drawn:
        found = difference(committed / name, made / name)
        if found:
            lines.append(f"{name}: {found}")
    return sorted(lines)


def _pictures(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.suffix in SUFFIXES]


def _place(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()


def difference(committed: Path, made: Path) -> str:
    """Return how two pictures of one kind differ; an empty text if they look the same."""
    if committed.read_bytes() == made.read_bytes():
        return ""
    if committed.suffix == ".svg":
        return _difference_of_drawings(committed.read_text(encoding="utf-8"), made.read_text(encoding="utf-8"))
    return _difference_of_pixels(committed, made)


def _difference_of_drawings(committed: str, made: str) -> str:
    old, new = (_PATH.split(_without_hashes(text)) for text in (committed, made))
    # Between the paths, at even places, stands everything else.
    pairs = list(zip_longest(map(_NUMBER.split, old[::2]), map(_NUMBER.split, new[::2]), fillvalue=[]))
    if any(a[::2] != b[::2] for a, b in pairs):
        return "other shapes, texts or styles"
    shift = max(
        abs(float(x) - float(y)) for a, b in pairs for x, y in zip(["0", *a[1::2]], ["0", *b[1::2]], strict=True)
    )
    if shift > _LARGEST_SHIFT_PT:
        return f"a coordinate or number is {shift:.1f} off"
    shift = max((_distance(a, b) for a, b in zip(old[1::2], new[1::2], strict=True)), default=0.0)
    return f"a line is {shift:.1f} pt off" if shift > _LARGEST_DISTANCE_PT else ""


def _distance(old: str, new: str) -> float:
    """Return how far two paths lie apart [pt], which may have different points on the same course."""
    a, b = (np.array(_NUMBER.findall(path), dtype=np.float64).reshape(-1, 2) for path in (old, new))
    letters = [_NUMBER.sub("", path).split() for path in (old, new)]
    if a.size and b.size and {*letters[0], *letters[1]} == {"M", "L"}:
        return max(_farthest(a, _segments(new)), _farthest(b, _segments(old)))
    return float(np.abs(a - b).max(initial=0.0)) if letters[0] == letters[1] else np.inf


def _segments(path: str) -> npt.NDArray[np.float64]:
    """Return the ends of the straight pieces of a path (n, 2, 2); a single point is a piece of no length."""
    courses = [np.array(_NUMBER.findall(part), dtype=np.float64).reshape(-1, 2) for part in path.split("M")[1:]]
    return np.concatenate([np.stack([course[[0, *range(len(course) - 1)]], course], axis=1) for course in courses])


def _farthest(points: npt.NDArray[np.float64], segments: npt.NDArray[np.float64]) -> float:
    """Return the largest distance of any of the points from the piece next to it."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    from_start = points[:, None] - start
    share = (from_start * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-12)
    nearest = from_start - np.clip(share, 0.0, 1.0)[:, :, None] * along
    return float(np.sqrt((nearest**2).sum(axis=2).min(axis=1).max()))


def _without_hashes(text: str) -> str:
    """Return an SVG with its hashed names by the order in which they come."""
    order: dict[str, str] = {}
    return _HASHED.sub(lambda match: order.setdefault(match[0], f"name_{'i' * (len(order) + 1)}"), text)


def _difference_of_pixels(committed: Path, made: Path) -> str:
    old, new = _pixels(committed), _pixels(made)
    if old.shape != new.shape:
        return "another size"
    n = int((np.abs(old - new).max(axis=2) > _LARGEST_SHADE).sum())
    return f"{n} pixels have another colour" if n > _N_PIXELS else ""


def _pixels(path: Path) -> npt.NDArray[np.int16]:
    """Return the pixels of a picture (height, width, 3)."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"), dtype=np.int16)


def main(arguments: list[str]) -> int:
    """Print what differs; return 1 if something does."""
    committed, made = map(Path, arguments)
    lines = differences(committed, made)
    for line in lines:
        print(f"{committed}/{line}")
    if lines:
        print(f"\n{len(lines)} pictures are stale: `make pictures` draws them, then look at them and commit them.")
        return 1
    print(f"{len(_pictures(made))} pictures in {committed} are what their commands draw.")
    print(f"Not compared: {', '.join(NOT_REPEATED)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
