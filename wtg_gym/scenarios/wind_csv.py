"""A measured wind series from a CSV file, checked line by line."""

import math
import os
from pathlib import Path

import numpy as np

from wtg_gym.files import interpreting, read_bytes
from wtg_gym.physics import parameters, scenario
from wtg_gym.physics.layout import Floats
from wtg_gym.ranges import require_count, require_range

_STEP_RANGE_S = (1e-3, 3600.0)
#: As many as a day has tenths of a second.
_MOST_ROWS = 864_001
#: Rounded time stamps (0.033, 0.067, 0.100 s) are still uniform; a missing row is a deviation of 100 %.
_STEP_TOLERANCE = 0.05
_FORMAT = "time_s,wind_1_m_s,wind_2_m_s,… (time [s] first, then one column of wind speed [m/s] per WTG group)"


def read_wind_csv(path: str | os.PathLike[str], *, duration_s: float | None = None) -> tuple[Floats, float]:
    """Return wind speeds (n_wtg, n_samples) [m/s] and their time step [s] from a CSV file, ready for a `Scenario`.

    The file is UTF-8, has a header and a uniform time step: `time_s` first, then one column per WTG group of any name
    [m/s]. The series is cut to `duration_s`, None takes all [s]. A ValueError names file, line, value and what is
    allowed.
    """
    raw = read_bytes(Path(path), "wind series")
    with interpreting(Path(path), "wind series"):
        return _parse(raw, duration_s)


def _parse(raw: bytes, duration_s: float | None) -> tuple[Floats, float]:
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, bad = raw.count(b"\n", 0, error.start) + 1, raw[error.start]
        raise ValueError(f"line {line}: byte 0x{bad:02x} is not UTF-8; expected text: {_FORMAT}") from error
    text = text.rstrip()
    require_count("the table", text.count("\n"), _MOST_ROWS)
    first, *lines = text.split("\n")
    require_count("line 1", first.count(",") + 1, parameters.MOST_GROUPS + 1)
    header = _cells(first)
    if header[0] != "time_s" or len(header) < 2:
        raise ValueError(f"line 1: the header is {first[:80]!r} or empty; expected: {_FORMAT}")
    if len(lines) < 2:
        raise ValueError(f"{len(lines)} data row(s) after the header, at least 2 are needed")
    values = np.array([_numbers(f"line {number}", header, line) for number, line in enumerate(lines, start=2)])
    dt_s = _uniform_step(values[:, 0])
    wind = np.ascontiguousarray(values[:, 1:].T)
    if duration_s is None:
        return wind, dt_s
    duration_s = require_range("duration_s", duration_s, dt_s, 1e9, "s")
    n_samples = math.ceil(duration_s / dt_s - 1e-6) + 1
    if n_samples > len(lines):
        raise ValueError(
            f"line {len(lines) + 1}: the series ends after {(len(lines) - 1) * dt_s:g} s, "
            f"at least {duration_s:g} s ({n_samples} rows of {dt_s:g} s) are needed"
        )
    return wind[:, :n_samples].copy(), dt_s


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split(",")]


def _numbers(where: str, header: list[str], line: str) -> list[float]:
    cells = _cells(line)
    if len(cells) != len(header):
        raise ValueError(f"{where}: {len(cells)} cells, the header has {len(header)}: {line[:80]!r}")
    low, high = scenario.WIND_SPEED_RANGE
    numbers: list[float] = []
    for name, text in zip(header, cells, strict=True):
        try:
            # Python reads 1_0 as ten; in a table it is a typing error.
            number = float("not a number" if "_" in text else text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or (numbers and not low <= number <= high):
            allowed = f"wind speeds of {low:g} … {high:g} m/s" if numbers else "finite times in s"
            shown = f"{text[:40]!r}" if text else "an empty cell"
            raise ValueError(f"{where}, column {name!r}: {shown} is none of the allowed {allowed}")
        numbers.append(number)
    return numbers


def _uniform_step(time_s: Floats) -> float:
    """Return the mean time step, or raise a ValueError that names the first line where the step is another one."""
    # Times such as 1e308 give steps that are not finite, which are refused below.
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(time_s)
        usual = float(np.median(steps))
        wrong = np.flatnonzero(~(np.abs(steps - usual) <= _STEP_TOLERANCE * abs(usual)))
    low, high = _STEP_RANGE_S
    if not low <= usual <= high or wrong.size:
        row = int(wrong[0]) + 1 if wrong.size else 1
        reason = "time does not increase" if steps[row - 1] <= 0.0 else "gap or change of step in time"
        raise ValueError(
            f"line {row + 2}: {reason}: time_s goes from {time_s[row - 1]:g} to {time_s[row]:g} s; "
            f"the step must be uniform ({usual:g} s in most rows) and within {low:g} … {high:g} s"
        )
    return float((time_s[-1] - time_s[0]) / (len(time_s) - 1))
