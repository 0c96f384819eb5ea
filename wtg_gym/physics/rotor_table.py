"""C_p(λ, β) of a rotor as a table: reading it, and a smooth surface through its points.

The surface is the bicubic spline through the table's points. Where an axis is uneven, or β = 0 is none of its points,
it is that spline to about 1e-4, once continuously differentiable. Each cell of a regular grid has the sixteen
coefficients of its polynomial, Σ c_nm v^n u^m with 0 ≤ u, v ≤ 1 along λ and β. Below the table's least λ the power
coefficient falls in proportion to λ; beyond its other edges it keeps the edge's value. Source of the spline: C. de
Boor: A Practical Guide to Splines, chapter XVII.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from wtg_gym.files import interpreting, read_text
from wtg_gym.systems import expressions as ex
from wtg_gym.systems.elementary import clip, fma

#: Coefficients of each cell's polynomial (n_λ - 1, n_β - 1, 16); without cells where a turbine has no table.
Cells = npt.NDArray[np.float64]
#: Most points of a table along one axis.
_MOST_POINTS = 500
#: The highest power coefficient of any rotor: Betz' limit.
_BETZ_LIMIT = 16.0 / 27.0


class Grid(NamedTuple):
    """Where a table's cells lie; the first node of β is 0."""

    ratio_min: float  # λ of the first node [-]
    inv_ratio_min: float
    inv_ratio_step: float
    inv_pitch_step: float  # [1/deg]


@dataclass(frozen=True, kw_only=True)
class RotorTable:
    """Power coefficients of a rotor over tip-speed ratio and pitch angle.

    A ValueError names too few or too many points, an axis that does not rise, a missing value, or a C_p above Betz'
    limit.
    """

    tip_speed_ratio: tuple[float, ...]  # λ, rising (n_λ,) [-]
    pitch_deg: tuple[float, ...]  # β, rising, from 0 or below on (n_β,) [deg]
    power_coefficient: tuple[tuple[float, ...], ...]  # C_p (n_λ, n_β) [-]

    def __post_init__(self) -> None:
        try:
            ratios, pitches = (tuple(map(float, axis)) for axis in (self.tip_speed_ratio, self.pitch_deg))
            rows = tuple(tuple(map(float, row)) for row in self.power_coefficient)
        except (TypeError, ValueError) as error:
            raise ValueError(f"a rotor table must be rows of numbers: {error}") from None
        for name, axis in (("tip-speed ratios", ratios), ("pitch angles", pitches)):
            if not 4 <= len(axis) <= _MOST_POINTS:
                raise ValueError(f"a rotor table needs 4 … {_MOST_POINTS} {name}, got {len(axis)}")
            if not np.isfinite(axis).all() or not (np.diff(axis) > 1e-6).all():
                raise ValueError(f"the {name} of a rotor table must be finite and rise by more than 1e-6")
        if not 0.0 < ratios[0] < ratios[-1] <= 100.0:
            raise ValueError(f"tip-speed ratios of a rotor table must lie in 0 … 100, got {ratios[0]:g} …")
        if not -90.0 <= pitches[0] <= 0.0 < pitches[-1] <= 90.0:
            raise ValueError(
                "pitch angles of a rotor table must reach from 0 deg or below to above 0 deg within ±90 deg, got "
                f"{pitches[0]:g} … {pitches[-1]:g} deg"
            )
        widths = {len(row) for row in rows}
        if len(rows) != len(ratios) or widths != {len(pitches)}:
            raise ValueError(
                f"a rotor table of {len(ratios)} tip-speed ratios and {len(pitches)} pitch angles needs as many rows "
                f"and columns of power coefficients, got {len(rows)} rows of {sorted(widths)} values"
            )
        values = np.array(rows)
        for i, j in np.argwhere(~np.isfinite(values)):
            at = f"a tip-speed ratio of {ratios[i]:g} and {pitches[j]:g} deg"
            raise ValueError(f"a rotor table has no number at {at}")
        if values.max() > _BETZ_LIMIT:
            raise ValueError(
                f"a C_p of a rotor table is {values.max():g}; allowed: at most Betz' limit, {_BETZ_LIMIT:.4f}"
            )
        object.__setattr__(self, "tip_speed_ratio", ratios)
        object.__setattr__(self, "pitch_deg", pitches)
        object.__setattr__(self, "power_coefficient", rows)

    def surface(self) -> tuple[Grid, Cells]:
        """Return the grid and the coefficients of its cells, from β = 0 on."""
        return _surface(self)


@functools.lru_cache(maxsize=16)
def _surface(table: RotorTable) -> tuple[Grid, Cells]:
    # Few plants have a table, and this takes a fifth of a second.
    ratio, pitch = np.array(table.tip_speed_ratio), np.array(table.pitch_deg)
    spline = RectBivariateSpline(ratio, pitch, np.array(table.power_coefficient), kx=3, ky=3, s=0.0)
    n_ratio = _n_steps(ratio[-1] - ratio[0], np.diff(ratio).min())
    n_pitch = _n_steps(pitch[-1], np.diff(pitch).min())
    ratios, pitches = np.linspace(ratio[0], ratio[-1], n_ratio + 1), np.linspace(0.0, pitch[-1], n_pitch + 1)
    du, dv = ratios[1] - ratios[0], pitches[1] - pitches[0]
    # Value and slopes at the four corners of each cell, on the unit square.
    corners = np.empty((n_ratio, n_pitch, 4, 4))
    for m, n, i, j in itertools.product((0, 1), repeat=4):
        at_nodes = spline(ratios, pitches, dx=m, dy=n) * du**m * dv**n
        corners[:, :, 2 * m + i, 2 * n + j] = at_nodes[i : i + n_ratio, j : j + n_pitch]
    # Cubic Hermite form: 1, u, u², u³ from the values at 0 and 1 and the slopes at 0 and 1.
    hermite = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]])
    cells = np.einsum("mp,ijpq,nq->ijnm", hermite, corners, hermite).reshape(n_ratio, n_pitch, 16)
    grid = Grid(float(ratios[0]), float(1.0 / ratios[0]), float(1.0 / du), float(1.0 / dv))
    return grid, np.ascontiguousarray(cells)


def _n_steps(length: float, step: float) -> int:
    return min(max(1, round(length / step)), _MOST_POINTS)


def tabulated_power_coefficient(ratio: float, pitch_deg: float, cells: Cells | ex.Cells, g: Grid) -> float:
    """Return C_p at a tip-speed ratio λ and a pitch angle β [deg]."""
    n_ratio, n_pitch = cells.shape[0], cells.shape[1]
    u = clip((ratio - g.ratio_min) * g.inv_ratio_step, 0.0, n_ratio * 1.0)
    v = clip(pitch_deg * g.inv_pitch_step, 0.0, n_pitch * 1.0)
    first, second = min(math.floor(u), n_ratio - 1.0), min(math.floor(v), n_pitch - 1.0)
    i, j, u, v = np.int64(first), np.int64(second), u - first, v - second
    orders = [_cubic([cells[i, j, 4 * n + m] for m in range(4)], u) for n in range(4)]
    # To zero at a rotor that stands still.
    return _cubic(orders, v) * min(ratio * g.inv_ratio_min, 1.0)


def _cubic(c: Sequence[float], x: float) -> float:
    return fma(fma(fma(c[3], x, c[2]), x, c[1]), x, c[0])


def read_rotor_table(path: Path) -> RotorTable:
    """Read the power coefficients of a rotor performance file in the form of NREL's ROSCO toolbox.

    Between comments that begin with "#" it has a row of pitch angles [deg], one of tip-speed ratios, one of wind
    speeds, and a row of power coefficients per tip-speed ratio; thrust and torque coefficients may follow. A ValueError
    says that the file is missing, is not of that form, or its table is not complete.
    """
    lines = read_text(path, "rotor table").splitlines()
    with interpreting(path, "rotor table"):
        rows = [tuple(map(float, line.split())) for line in lines if line.strip() and not line.startswith("#")]
        pitch_deg, ratios, _, *power = rows
        return RotorTable(tip_speed_ratio=ratios, pitch_deg=pitch_deg, power_coefficient=tuple(power[: len(ratios)]))
