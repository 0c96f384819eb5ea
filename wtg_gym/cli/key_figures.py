"""Recorded runs as key figures, a table and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.cli.output import print_table
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.tasks.episode import ROCOF_WINDOW_S


def key_figures(name: str, run: Trajectory) -> dict[str, Any]:
    """Return the key figures of a run as JSON-ready data with units in the keys; groups count from 1.

    Those that are called local are the extremes over all groups, machines and, in extended physics, buses.
    """
    step = float(run.time_s[1] - run.time_s[0]) if run.time_s.size > 1 else ROCOF_WINDOW_S
    local = run.local_frequency_hz
    ratios, rotors = run.tip_speed_ratio[-1], run.rotor_speed_pu[-1]
    extremes = {Status.STALL: -ratios, Status.OVER_SPEED: rotors, Status.UNDER_SPEED: -rotors}
    failed = 1 + int(np.argmax(extremes[run.status])) if run.status in extremes else None
    # A disconnected group delivers exactly nothing; one that came back is not listed.
    off = run.power_pu == 0.0
    tripped = [
        {
            "group": 1 + int(group),
            "time_s": _plain(run.time_s[at]),
            "rotor_speed_pu": _plain(run.rotor_speed_pu[at, group]),
        }
        for group in np.flatnonzero(off[-1])
        for at in [_last_start(off[:, group])]
    ]
    return {
        "strategy": name,
        "status": "completed" if run.status == Status.RUNNING else run.status.name.lower().replace("_", "-"),
        "failed_group": failed,
        "tripped_groups": tripped,
        "end_time_s": _plain(run.time_s[-1]),
        "nadir_hz": _plain(run.frequency_hz.min()),
        "zenith_hz": _plain(run.frequency_hz.max()),
        "largest_rocof_hz_s": _farthest(run.rocof_hz_s(ROCOF_WINDOW_S)),
        "local_nadir_hz": _plain(local.min()),
        "local_zenith_hz": _plain(local.max()),
        "local_rocof_hz_s": _farthest(run.rocof_hz_s(ROCOF_WINDOW_S, local)),
        "local_rocof_100_ms_hz_s": _farthest(run.rocof_hz_s(0.1, local)),
        "shed_energy_mws": _plain(run.shed_energy_mws[-1]),
        "rocof_window_s": _plain(max(1, round(ROCOF_WINDOW_S / step)) * step),
        "final_frequency_hz": _plain(run.frequency_hz[-1]),
        "final_rotor_speed_pu": [_plain(value) for value in run.rotor_speed_pu[-1]],
        "final_power_pu": [_plain(value) for value in run.power_pu[-1]],
    }


def _last_start(off: npt.NDArray[np.bool_]) -> int:
    """The sample from which on a group is off to the end."""
    return 0 if off.all() else int(off.size - np.argmin(off[::-1]))


def _farthest(values: Floats) -> float | None:
    """The number that is farthest from zero."""
    return _plain(values.ravel()[np.argmax(np.abs(values))])


def _plain(value: float) -> float | None:
    """A float without the noise of its last digits; None where JSON has no number for it."""
    return round(float(value), 9) if np.isfinite(value) else None


def print_key_figures(figures: list[dict[str, Any]]) -> None:
    """Print the key figures of several runs as a table with units."""
    sheds = any(row["shed_energy_mws"] for row in figures)
    window_ms = round(1000 * figures[0]["rocof_window_s"])
    header = (
        "strategy",
        "nadir [Hz]",
        "zenith [Hz]",
        "range of all units [Hz]",
        f"RoCoF, {window_ms} ms [Hz/s]",
        "final [Hz]",
        "final rotor speed [p.u.]",
        "final power [p.u.]",
        *(("not served [MW s]",) if sheds else ()),
        "end",
    )
    rows = [
        (
            row["strategy"],
            _digits(row["nadir_hz"], 3),
            _digits(row["zenith_hz"], 3),
            f"{_digits(row['local_nadir_hz'], 3)} … {_digits(row['local_zenith_hz'], 3)}",
            _digits(row["largest_rocof_hz_s"], 3),
            _digits(row["final_frequency_hz"], 3),
            _per_group(row["final_rotor_speed_pu"]),
            _per_group(row["final_power_pu"]),
            *((_digits(row["shed_energy_mws"], 0),) if sheds else ()),
            _end(row),
        )
        for row in figures
    ]
    print_table(header, rows, left=(0, len(header) - 1))


def _end(row: Mapping[str, Any]) -> str:
    time_s = _digits(row["end_time_s"], 1)
    if row["status"] == "completed":
        trips: dict[str, list[str]] = {}
        for trip in row["tripped_groups"]:
            trips.setdefault(f"{trip['time_s']:.1f} s", []).append(str(trip["group"]))
        parts = [f"group {', '.join(groups)} tripped at {when}" for when, groups in trips.items()]
        return "; ".join([*parts, f"completed {time_s} s"])
    group = f" of group {row['failed_group']}" if row["failed_group"] else ""
    return f"{row['status'].replace('-', ' ')}{group} at {time_s} s"


def _digits(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _per_group(values: list[float | None]) -> str:
    return " / ".join(_digits(value, 3) for value in values)


def traces_csv(runs: Mapping[str, Trajectory]) -> str:
    """Return every sample of every run as CSV: one row per run and instant, units in the header, all from 1."""
    first = next(iter(runs.values()))
    others = ("machine_frequency_hz", "bus_frequency_hz")
    per_group = [name for name, values in vars(first).items() if getattr(values, "ndim", 0) == 2 and name not in others]
    n_groups = first.power_pu.shape[1]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [f"group_{group}_{name}" for group in range(1, n_groups + 1) for name in per_group]
    names += [
        f"{name.split('_')[0]}_{i + 1}_frequency_hz" for name in others for i in range(getattr(first, name).shape[1])
    ]
    writer.writerow(["strategy", "time_s", "frequency_hz", "rocof_hz_s", "shed_energy_mws", *names])
    for label, run in runs.items():
        series = [run.time_s, run.frequency_hz, run.rocof_hz_s(), run.shed_energy_mws]
        series += [getattr(run, name)[:, group] for group in range(n_groups) for name in per_group]
        series += [column for name in others for column in getattr(run, name).T]
        for row in zip(*series, strict=True):
            writer.writerow([label, *(f"{value:.9g}" for value in row)])
    return text.getvalue()
