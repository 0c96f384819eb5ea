"""Traces and other rows of numbers as text: rounded to a resolution, and packed."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.evaluation.recording import Recording
from wtg_gym.physics.ieee14 import modified_ieee14

Floats = npt.NDArray[np.float64]

#: Samples of the page's traces come this far apart [s].
TRACE_STEP_S = 0.2
#: Steps that the traces' numbers are rounded to, a fraction of a pixel of the panels; the wind comes once a scenario,
#: everything else once an entry, the frequency as its deviation from the nominal one.
RESOLUTIONS: Mapping[str, float] = {
    "frequency": 0.0005,
    "rocof": 0.005,
    "rotor": 0.001,
    "power": 0.001,
    "k": 0.001,
    "tau": 0.01,
}
WIND_RESOLUTION = 0.01
#: Code of a missing value: the episode is over, or the law has no such quantity.
MISSING = -32768


def scenario_traces(recordings: Sequence[Recording], place: int) -> dict[str, Any]:
    """Return the traces of a scenario, all entries together: packed rows, and how many samples each has."""
    if not recordings:
        return {"n": 0, "step": TRACE_STEP_S, "packed": ""}
    first = recordings[0]
    step = float(first.time_s[1] - first.time_s[0])
    stride = max(1, round(TRACE_STEP_S / step))
    longest = max(recordings, key=lambda recording: recording.time_s.size)
    n = len(range(0, longest.time_s.size, stride))
    # Wind is the scenario's: the longest recording shows most of it.
    full = max(recordings, key=lambda recording: int(np.isfinite(recording.wind_m_s[place, :, 0]).sum()))
    rows = [quantised(wind, WIND_RESOLUTION) for wind in full.wind_m_s[place, ::stride].T]
    for recording in recordings:
        for name, resolution in RESOLUTIONS.items():
            rows += [quantised(values, resolution) for values in _values(recording, name, place)[::stride].T]
    table = np.full((len(rows), n), MISSING, dtype=np.int16)
    for index, row in enumerate(rows):
        table[index, : row.size] = row
    return {"n": n, "step": round(stride * step, 6), "packed": packed(table)}


def _values(recording: Recording, name: str, place: int) -> Floats:
    """Return one of the page's quantities, (n, 1) of the grid or (n, n_wtg)."""
    if name == "frequency":
        deviation: Floats = recording.frequency_hz[place][:, np.newaxis] - modified_ieee14().frequency_hz
        return deviation
    arrays: dict[str, Floats] = {
        "rocof": recording.rocof_hz_s,
        "rotor": recording.rotor_speed_pu,
        "power": recording.power_pu,
        "k": recording.coefficient_pu,
        "tau": recording.time_constant_s,
    }
    values: Floats = arrays[name][place]
    return values


def quantised(values: Floats, resolution: float) -> npt.NDArray[np.int16]:
    """Return numbers as whole steps of a resolution, :data:`MISSING` where there is none, limited to what fits."""
    steps = np.clip(np.round(np.nan_to_num(values, posinf=0.0, neginf=0.0) / resolution), MISSING + 1, -MISSING - 1)
    whole: npt.NDArray[np.int16] = np.where(np.isfinite(values), steps, MISSING).astype(np.int16)
    return whole


def packed(table: npt.NDArray[np.int16]) -> str:
    """Return rows of whole numbers as base64 of their deflated differences, all low bytes before all high bytes."""
    differences = np.diff(table.astype(np.int32), axis=1, prepend=0).astype(np.int16)
    # Small differences of either sign become small numbers, whose high bytes are all zero.
    folded = ((differences << 1) ^ (differences >> 15)).astype(np.uint16)
    low, high = (folded & 0xFF).astype(np.uint8), (folded >> 8).astype(np.uint8)
    return base64.b64encode(zlib.compress(low.tobytes() + high.tobytes(), 9)).decode()
