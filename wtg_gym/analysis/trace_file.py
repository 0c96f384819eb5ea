"""Traces of other simulators: CSV with a column per machine or bus and quantity."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wtg_gym.analysis.case_file import ReferenceCase
from wtg_gym.files import read_text
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import LoadStep
from wtg_gym.ranges import require_range

#: Quantities of a machine and of a bus that a trace may hold, with their units.
MACHINE_QUANTITIES = {"w": "p.u.", "Pe": "p.u.", "Qe": "p.u.", "Tm": "p.u.", "delta": "rad"}
BUS_QUANTITIES = {"V": "p.u.", "th": "rad"}
_LONGEST_TRACE_S = 3600.0


@dataclass(frozen=True)
class Trace:
    """A run of another simulator: `time_s` (n,) [s] and named columns (n,), such as ``w1`` or ``V14``."""

    time_s: Floats
    columns: Mapping[str, Floats]


def read_trace(path: str | Path, case: ReferenceCase) -> tuple[Trace, tuple[str, ...]]:
    """Read a trace in CSV: a column `t` [s] and columns of the known quantities, such as ``w1``, ``Pe2a`` or ``V14``.

    Returns:
        the trace, and the names of columns that are not known and were left out.

    Raises:
        ValueError: the file is missing, not such a table, or not of this case; the message names column and row.
    """
    text = read_text(Path(path), "trace", encoding="utf-8-sig")
    # Comments may come before the names, too.
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    text = "\n".join(lines[1:])
    names = [name.strip().strip("\"'") for name in lines[0].split(",")] if lines else [""]
    if names[0] != "t" or len(set(names)) != len(names):
        raise ValueError(f"the trace {path} must begin with a line of different column names, the first one 't'")
    if not text:
        raise ValueError(f"the trace {path} has no rows")
    try:
        table = np.loadtxt(io.StringIO(text), delimiter=",", ndmin=2)
    except ValueError as error:
        raise ValueError(f"the trace {path} is not a table of numbers: {error}") from error
    if table.shape[1] != len(names):
        raise ValueError(f"the trace {path} has {len(names)} column names and a table of shape {table.shape}")
    if not np.isfinite(table).all():
        row, column = np.argwhere(~np.isfinite(table))[0]
        raise ValueError(f"the trace {path} has {table[row, column]} in row {row + 1} of column {names[column]}")
    time_s = table[:, 0]
    if time_s[0] < 0.0 or (np.diff(time_s) < 0.0).any():
        raise ValueError(f"the times t of the trace {path} must begin at 0 s or later and not decrease")
    require_range(f"the last time of the trace {path}", float(time_s[-1]), 0.0, _LONGEST_TRACE_S, "s")
    known = known_columns(case)
    columns = {name: table[:, i] for i, name in enumerate(names) if name in known}
    if not columns:
        raise ValueError(f"the trace {path} has none of the columns of this case, such as {', '.join(list(known)[:3])}")
    return Trace(time_s, columns), tuple(name for name in names[1:] if name not in known)


def known_columns(case: ReferenceCase) -> dict[str, str]:
    """The quantity of every column a trace of this case may have."""
    columns = {f"{q}{key}": q for q in MACHINE_QUANTITIES for key in case.machine_keys}
    columns.update({f"{q}{bus}": q for q in BUS_QUANTITIES for bus in case.network.bus_numbers})
    return columns


def choose_events(case: ReferenceCase, trace_path: str | Path, name: str | None = None) -> tuple[LoadStep, ...]:
    """Return the event list of a trace: the named one, the only one, or the one its file name ends with (`…_a.csv`).

    Raises:
        ValueError: there is no such list, or several could be meant; the message lists them.
    """
    known = ", ".join(case.events) or "none"
    if name is None and not case.events:
        return ()
    if name is not None:
        if name not in case.events:
            raise ValueError(f"unknown event list {name!r}; the parameter file has: {known}")
        return case.events[name]
    if len(case.events) == 1:
        return next(iter(case.events.values()))
    ending = re.split(r"[_\-.]", Path(trace_path).stem)[-1]
    if ending not in case.events:
        raise ValueError(f"which events does {Path(trace_path).name} show? Say so with --events; there are: {known}")
    return case.events[ending]
