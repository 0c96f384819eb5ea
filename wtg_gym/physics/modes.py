"""The whole system linearised numerically from the simulator's own right-hand side: eigenvalues and participation.

Source for participation factors: P. Kundur: Power System Stability and Control, section 12.2.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from wtg_gym.physics.layout import Floats
from wtg_gym.physics.linearisation import moving_states, state_matrix
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import TrackingLaw, group_laws

#: The slope of g(ω) that counts at ω_st: that of under-frequency, or that of over-frequency.
Side = Literal["under", "over"]
#: Step of the finite differences [rad, p.u.]; truncation and rounding are both near 1e-9 of a power.
_STEP = 2e-6


@dataclass(frozen=True, kw_only=True)
class LinearModel:
    """ẋ = A x around an equilibrium."""

    matrix: Floats  # A, shape (n, n) [1/s, with p.u. and rad]
    state_names: tuple[str, ...]  # name of each state, such as ``sync0.speed`` or ``wtg1.rotor_speed``
    #: States without a part in the dynamics: constants, and those that nothing depends on or nothing else drives.
    left_out: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """An eigenvalue, or a conjugate pair of them."""

    eigenvalue: complex  # with the imaginary part of the pair that is not negative [1/s]
    frequency_hz: float  # of the oscillation, 0 for a real eigenvalue [Hz]
    damping_ratio: float  # ζ = -Re λ/|λ| [-]
    #: Share of each state in the mode, by name, largest first; the magnitudes sum to 1 [-].
    participation: dict[str, float]


def linearise(
    scenario: Scenario,
    laws: str | TrackingLaw | Sequence[str | TrackingLaw],
    settings: PlantSettings | None = None,
    *,
    side: Side = "under",
) -> LinearModel:
    """Linearise the plant around the equilibrium that a scenario starts from, before any of its events.

    Central differences of the simulator's right-hand side; one-sided ones of the same order for the frequencies of the
    WTGs, where g(ω) has a corner. The pitch protection at rest takes no part, since it only acts upwards.

    Args:
        scenario: wind, load level, governor droop and inertia.
        laws: one law or strategy name for all WTG groups, or one per group; a name is the law of the plant's turbine.
        settings: the plant; the paper's by default.
        side: which slope of g(ω) counts at ω_st.

    Raises:
        ValueError: scenario, laws and plant do not fit, there is no equilibrium, or `side` is unknown.
    """
    if side not in ("under", "over"):
        raise ValueError(f"side must be 'under' or 'over', got {side!r}")
    simulator = _at_rest(scenario, laws, settings or PlantSettings())
    rows, layout = simulator.blocks[0], simulator.layout
    matrix = state_matrix(rows, simulator.plant, layout, -1.0 if side == "under" else 1.0)
    keep, names = moving_states(matrix, rows, layout), layout.state_names
    return LinearModel(
        matrix=matrix[np.ix_(keep, keep)],
        state_names=tuple(name for name, kept in zip(names, keep, strict=True) if kept),
        left_out=tuple(name for name, kept in zip(names, keep, strict=True) if not kept),
    )


def _at_rest(
    scenario: Scenario, laws: str | TrackingLaw | Sequence[str | TrackingLaw], settings: PlantSettings
) -> Simulator:
    """Return a simulator in the equilibrium that a scenario starts from; its events do not matter."""
    duration_s = settings.control_dt * max(1, round(1.0 / settings.control_dt))
    simulator = Simulator(settings, duration_s=duration_s)
    laws = group_laws(laws, len(settings.groups), settings.turbine, settings.control)
    simulator.start(0, dataclasses.replace(scenario, events=(), duration_s=duration_s), laws)
    return simulator


def modes(model: LinearModel) -> tuple[Mode, ...]:
    """Return the modes of a linear model, the least damped first (by real part)."""
    values, right = np.linalg.eig(model.matrix)
    left = np.linalg.inv(right)
    found = []
    for i in np.argsort(-values.real):
        value = complex(values[i])
        if value.imag < 0.0:
            continue
        share = np.abs(left[i] * right[:, i])
        share /= share.sum()
        order = np.argsort(-share)
        found.append(
            Mode(
                eigenvalue=value,
                frequency_hz=abs(value.imag) / (2.0 * math.pi),
                damping_ratio=-value.real / abs(value) if value != 0.0 else 0.0,
                participation={model.state_names[k]: float(share[k]) for k in order},
            )
        )
    return tuple(found)


def synchronising_coefficients(
    scenario: Scenario, laws: str | TrackingLaw | Sequence[str | TrackingLaw], settings: PlantSettings | None = None
) -> Floats:
    """Return ∂p_i/∂δ_j between WTG groups, on the base of group i, shape (n_wtg, n_wtg) [p.u./rad].

    The diagonal is the K_p of the paper's single-machine model in this network, with the angles of all other units
    held. The sum of a row is K_p where all groups swing together against the synchronous machines.

    Args, Raises: as for :func:`linearise`.
    """
    simulator = _at_rest(scenario, laws, settings or PlantSettings())
    here = simulator.state()
    layout = simulator.layout
    n_wtg = layout.n_wtg
    result = np.empty((n_wtg, n_wtg))
    for j in range(n_wtg):
        place = int(np.flatnonzero(layout.state_rows == layout.wtg("angle")[j])[0])
        result[:, j] = slope(simulator, here, place, lambda: simulator.wtg_values("power")[0])
    return result


def slope(simulator: Simulator, here: Floats, place: int, read: Callable[[], Floats]) -> Floats:
    """Return the central difference of `read()` with respect to one of the states `here`; it moves the simulator."""
    ends = []
    for sign in (-1.0, 1.0):
        state = here.copy()
        state[place] += sign * _STEP
        simulator.set_state(state)
        simulator.evaluate()
        ends.append(read())
    return (ends[1] - ends[0]) / (2.0 * _STEP)
