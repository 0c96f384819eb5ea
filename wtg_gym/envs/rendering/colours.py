"""Colours of the picture, those of the leaderboard's page, and a matplotlib that a user's settings do not change."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from gymnasium.error import DependencyNotInstalled

from wtg_gym.extras import install_advice

PAGE, INK, SOFT, LINE, GRID = "#ffffff", "#1b2128", "#55606c", "#d5dbe1", "#e7ebef"
#: Events, and the end of an episode that failed.
EVENT = "#a8276b"
#: Quantities of the grid as a whole.
WHOLE_GRID = "#1b2128"
#: One per WTG group; further groups begin again.
GROUPS = ("#0063a6", "#c14a00", "#00724f", "#7a5ab8")
#: Limits beyond which a run fails, or that converters keep.
LIMIT = "#c98aa9"
#: Shaded ranges of values.
BAND = "#eef6f2"


def group_colour(group: int) -> str:
    """Return the colour of a WTG group."""
    return GROUPS[group % len(GROUPS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour "#rrggbb" as three numbers of 0 … 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def pale(colour: str) -> tuple[int, int, int]:
    """Return a colour halfway to the page's as three numbers of 0 … 255."""
    red, green, blue = ((a + b) // 2 for a, b in zip(rgb(colour), rgb(PAGE), strict=True))
    return red, green, blue


def require_matplotlib() -> None:
    """Raise Gymnasium's DependencyNotInstalled where matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise DependencyNotInstalled(f"rendering needs matplotlib; {install_advice('render')}") from error


@contextmanager
def plain_matplotlib() -> Iterator[None]:
    """Draw with matplotlib's own settings inside the `with` block."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        yield
