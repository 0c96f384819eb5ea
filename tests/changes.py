"""Data that somebody has changed at random, and what has to become of files with it."""

import copy
import math
from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st

ODD = [
    *(None, True, False, 0, -1, 1, 2**63, -(2**63), 2**64 - 1, 10**400),
    *(0.5, -0.5, 1e-300, 1e18, -1e308, 1e308, math.nan, math.inf, -math.inf),
    *("", "x", "0", "nan", "\0", "\ud800", "\ufeff", "a\nb", "é" * 300, "/dev/zero", "nowhere.json"),
    *([], {}, [[]], [{}], [None], [0, 0], ["x"] * 3, {"": 0}, {"x": {"y": []}}, [1] * 3000),
]


def places(data):
    """Every object and list in some data, with each of its keys; of a long list the first twenty."""
    if isinstance(data, (dict, list)):
        keys = list(data) if isinstance(data, dict) else range(min(len(data), 20))
        for key in keys:
            yield data, key
            yield from places(data[key])


@st.composite
def changed(draw: st.DrawFn, original):
    """Return data with one to three values or keys that are others, are gone, or are there twice."""
    data = copy.deepcopy(original)
    for _ in range(draw(st.integers(1, 3))):
        if able := list(places(data)):
            holder, key = able[draw(st.integers(0, len(able) - 1))]
            value = holder.pop(key)
            others = {
                "another": copy.deepcopy(draw(st.sampled_from(ODD))),
                "in a list": [value],
                "twice in a list": [value, value],
                "scaled": value * draw(st.floats()) if isinstance(value, float) else str(value),
                "elsewhere": value,
            }
            how = draw(st.sampled_from([*others, "gone"]))
            if isinstance(holder, dict) and how != "gone":
                holder[f"{key}_" if how == "elsewhere" else key] = others[how]
            elif how != "gone":
                holder.insert(key, others[how])
    return data


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    return path


def read_or_refused(path: Path, read: Callable[[Path], object]) -> None:
    try:
        read(path)
    except ValueError as error:
        message = str(error)
        assert path.name in message and message.isprintable() and len(message) < 2000, message
