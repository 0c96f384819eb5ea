"""Colours of the picture."""

PAGE, INK, SOFT, LINE, GRID = "#ffffff", "#1b2128", "#55606c", "#d5dbe1", "#e7ebef"
EVENT = "#a8276b"  # and the end of an episode that failed
#: One per WTG group; further groups begin again.
GROUPS = ("#0063a6", "#c14a00", "#00724f", "#7a5ab8")
LIMIT = "#c98aa9"  # beyond which a run fails, or that converters keep
BAND = "#eef6f2"  # shaded ranges of values


def group_colour(group: int) -> str:
    """Return the colour of a WTG group."""
    return GROUPS[group % len(GROUPS)]
