"""The plant linearised around an equilibrium, and the largest step that its integration takes.

A Runge-Kutta method multiplies the mode of an eigenvalue λ by R(hλ) in every step h. Where a decaying mode lies outside
the method's stability region, |R(hλ)| > 1, the run grows without bound: that is the method's doing, not the plant's.
"""

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from wtg_gym.physics import converter, integration
from wtg_gym.physics.layout import Floats, Layout, Whole
from wtg_gym.physics.plant import PlantTables, programs_of, with_places
from wtg_gym.systems.programs import Complex

#: Step of the finite differences [p.u., rad]; truncation and rounding are both near 1e-9 of a rate.
_DIFFERENCE = 2e-6
#: States that are evaluated side by side: of a large plant all would not fit into memory.
_SIDE_BY_SIDE = 64
#: The largest stable step must exceed the chosen one by this factor. Load, line trips, wind and governor droop move it
#: by less than 1 % over the runs of the suites; the rest is for what lies beyond them.
STEP_MARGIN = 1.05
#: Frequencies at which rotors swing against each other, and controls with them [Hz].
SWINGS_HZ = (0.05, 5.0)


class StepError(ValueError):
    """A plant's modes are too fast for the step of the integration."""


def state_matrix(rows: Floats, plant: PlantTables, layout: Layout, side: npt.ArrayLike) -> Floats:
    """Return A of ẋ = A x around the state in one environment's rows (n_rows,), shape (n, n) [1/s, with p.u. and rad].

    Central differences of the simulator's right-hand side; one-sided ones of the same order for the frequencies of the
    WTGs, where g(ω) has a corner: `side` is -1 for the slope below ω_st, +1 for the one above, for all groups or each,
    (n_wtg,).
    """
    states, n = layout.state_rows, layout.state_rows.size
    sides = np.broadcast_to(np.asarray(side, dtype=np.float64), (layout.n_wtg,))
    speeds = np.flatnonzero(np.isin(states, layout.wtg("speed")))
    first, second = np.full(n, 1.0), np.full(n, -1.0)
    first[speeds], second[speeds] = sides, 2.0 * sides
    moved = np.concatenate([states, states, states[:1]])
    by = _DIFFERENCE * np.concatenate([first, second, [0.0]])
    rates = np.empty((2 * n + 1, n))
    blocks = np.repeat(rows[np.newaxis, :], min(_SIDE_BY_SIDE, 2 * n + 1), axis=0)
    scratches = np.empty((len(blocks), layout.n_scratch, 1))
    # Most rows of a large plant are the network's, which an evaluation leaves as they are.
    spans = (plant.network.facts.pairs, plant.network.facts.transfers)
    constant = sorted((span.first, span.first + span.n_units * span.n_rows) for span in spans)
    others = [slice(first, last) for (_, first), (last, _) in pairwise([(0, 0), *constant, (rows.size, 0)])]
    for start in range(0, 2 * n + 1, len(blocks)):
        part = slice(start, start + len(blocks))
        some, of_some = blocks[: moved[part].size], scratches[: moved[part].size]
        for other in others:
            some[:, other] = rows[other]
        of_some[:] = 0.0
        some[np.arange(len(some)), moved[part]] += by[part]
        integration.evaluate_blocks(some[:, :, np.newaxis], of_some, plant.network)
        rates[part] = of_some[:, layout.rate_rows, 0]
    change = rates[:n] - rates[n : 2 * n]
    change[speeds] = sides[:, np.newaxis] * (-3.0 * rates[2 * n] + 4.0 * rates[speeds] - rates[n + speeds])
    matrix: Floats = change.T / (2.0 * _DIFFERENCE)
    return matrix


def one_way_limits(rows: Floats, layout: Layout) -> Whole:
    """Return the rows of pitch protections and power limiters at rest: they act one way only and have no slope."""
    names = ("pitch_integral", "pitch", *(("over_power", "under_power") if layout.n_extended else ()))
    limits = np.concatenate([layout.wtg(name) for name in names])
    at_rest: Whole = limits[np.abs(rows[limits]) < 4.0 * _DIFFERENCE]
    return at_rest


def moving_matrix(
    rows: Floats, plant: PlantTables, layout: Layout, side: npt.ArrayLike
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return the part of :func:`state_matrix` that takes part in the dynamics, and which states that are (n,).

    Left out are constants, states that nothing depends on, and states that nothing else drives, which stay at rest.
    """
    matrix = state_matrix(rows, plant, layout, side)
    keep = ~np.isin(layout.state_rows, one_way_limits(rows, layout))
    while True:
        rest = np.where(np.outer(keep, keep), matrix, 0.0)
        driven = (rest - np.diag(np.diag(rest))).any(axis=1)
        kept = keep & rest.any(axis=0) & driven
        if (kept == keep).all():
            return matrix[np.ix_(keep, keep)], keep
        keep = kept


def swing_modes(eigenvalues: Complex) -> list[tuple[float, float]]:
    """Return damping [-] and frequency [Hz] of the modes in which rotors and controls swing, the least damped first."""
    modes = [(-value.real / abs(value), value.imag / math.tau) for value in eigenvalues.tolist() if value]
    return sorted((damping, hertz) for damping, hertz in modes if SWINGS_HZ[0] < hertz < SWINGS_HZ[1])


def largest_stable_steps(eigenvalues: npt.ArrayLike) -> Floats:
    """Return, for each mode, the largest step at which the integration does not let it grow, (n,) [s].

    |R(hλ)| ≤ 1, R(z) = 1 + z + z²/2 + z³/6 + z⁴/24 of the classical fourth-order method. A growing mode is treated as
    the decaying one with the same |Re λ|: a step that follows the one follows the other. Source: E. Hairer, G. Wanner:
    Solving Ordinary Differential Equations II, section IV.2.
    """
    # No ray from zero stays in the region, or comes back to it, beyond |z| = 4.
    modes = np.asarray(eigenvalues, dtype=np.complex128)
    values = -np.abs(modes.real) + 1j * modes.imag
    low, high = np.zeros(values.shape), 4.0 / np.maximum(np.abs(values), 1e-9)
    for _ in range(40):
        middle = 0.5 * (low + high)
        z = middle * values
        growth = np.abs(1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0))))
        stable = growth <= 1.0 + 1e-12
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return low


def check_step(rows: Floats, plant: PlantTables, layout: Layout) -> None:
    """Refuse a plant with modes too fast for its integration step at the state of one environment's rows (n_rows,).

    Of the two slopes of each law's g(ω), the steeper is checked, that with which power rises more as the frequency
    falls: its modes are faster. Only small deviations are checked. Limits are left out, except the power and reactive
    limits of converters: their controls may be fast, and are checked as if all of them acted. A StepError names the
    eigenvalue, the state it mainly belongs to, the step and the largest allowed.
    """
    t = plant.turbine[0]
    low, setpoint, high = (t[f"converter.corners.{name}"] for name in converter.Corners._fields)
    k_min, k_nominal, k_max = (rows[layout.wtg(name)] for name in ("k_min", "k_nominal", "k_max"))
    below, above = (k_min - k_nominal) / (setpoint - low), (k_nominal - k_max) / (high - setpoint)
    side = np.where(below >= above, -1.0, 1.0)
    _check_modes(rows, plant, layout, side)
    if layout.n_extended:
        # Limits so narrow that the power limiters and the takeovers of reactive power act.
        extension, beyond = plant.extension.copy(), rows.copy()
        extension["limits.power_max"], extension["voltage.reactive_max"] = 0.0, -10.0
        beyond[layout.wtg("over_power")] = -0.01
        # Programs of a caller, which stand behind those of the physics, are not run here.
        programs = programs_of(plant, *integration.PROGRAMS)
        _check_modes(beyond, with_places(plant._replace(extension=extension), layout, programs), layout, side)


def _check_modes(rows: Floats, plant: PlantTables, layout: Layout, side: Floats) -> None:
    matrix, keep = moving_matrix(rows, plant, layout, side)
    steps = largest_stable_steps(np.linalg.eigvals(matrix))
    if steps.min(initial=np.inf) >= STEP_MARGIN * plant.simulation_dt:
        return
    values, right = np.linalg.eig(matrix)
    steps = largest_stable_steps(values)
    at = int(np.argmin(steps))
    # Participation: the part of each state in the mode, whatever its unit.
    share = np.abs(np.linalg.pinv(right)[at] * right[:, at])
    state = np.array(layout.state_names)[keep][int(np.argmax(share))]
    raise StepError(
        f"simulation_dt = {plant.simulation_dt:g} s is too long for this plant: its mode with the eigenvalue "
        f"{values[at]:.4g} 1/s (mainly {state}) would grow without bound in the integration; "
        f"allowed: at most {steps[at] / STEP_MARGIN:.3g} s"
    )
