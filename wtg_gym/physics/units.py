"""What all units share: the lane that they are in, and the network between them."""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.wind_turbine import Limits
from wtg_gym.systems.elementary import select
from wtg_gym.systems.systems import Kind, system


class Phasor(NamedTuple):
    """A voltage, a current or an admittance [p.u.]."""

    re: float
    im: float


class Terminal(NamedTuple):
    """What a unit starts from at its terminal [p.u.]."""

    power: float
    voltage: Phasor
    magnitude: float  # of the voltage
    current: Phasor  # into the network


#: A lane: a run. What is of one unit here is of the lane.
LANE = Kind(
    name="lanes",
    rows={
        "angle": float,  # of the first unit against a frame at nominal frequency [rad]
        "active": float,  # 1 while it runs, 0 once it has ended
        "step": float,  # simulation steps since the reset
        "next_change": float,  # simulation step of the next network change
        "last_change": float,  # simulation step at which the network was last reduced
        "status": float,  # of protection.Status
        "coi": float,  # frequency of the centre of inertia [p.u.]
        "coi_min": float,  # least since the start [p.u.]
        "coi_max": float,
        "noise_z": Phasor,  # Thévenin impedance at the bus of the load noise [p.u.]
        "noise_per_mw": float,  # admittance per MW of load noise [p.u.]
        "noise_y": float,  # conductance of the load noise in the present control interval [p.u.]
        "healthy_step": float,  # last simulation step at which the protections found no low voltage
    },
    scratch={
        "reference_speed": float,  # of the first unit, or where it stands still after an outage [p.u.]
        "noise_factor": Phasor,  # of the load noise's part in the reduced admittance: Δy/(1 + Δy z) [p.u.]
        "exceeded": float,  # groups whose current is too large
        "unsettled": float,  # groups whose voltage the latest sweep has moved
        "momentum": float,  # Σ 2H (ω - 1) of connected units [s]
        "inertia": float,  # Σ 2H [s]
        "least_angle": float,  # of all connected units [rad]
        "largest_angle": float,
        "least_squared_voltage": float,  # at the terminals of all connected units, squared [p.u.²]
        "finding": float,  # status that the protections find now
        "finite": float,  # 1 where all speeds are finite numbers
        "stops": float,  # 1 where a protection ends the run now
    },
    constants={"omega_n": float, "simulation_dt": float, "limits": Limits, "trips_groups": bool},
    states=("angle",),
)

#: All units as the network sees them, machines first.
UNITS = Kind(
    name="units",
    rows={"transfer": Phasor},  # y_i Z_in to the bus of the load noise
    scratch={
        "voltage": Phasor,  # behind the internal impedance
        "current": Phasor,  # into the network
        "start": Terminal,
    },
    sees={"lane": LANE},
)

#: Pairs of units, row by row of the reduced admittance matrix.
PAIRS = Kind(
    name="pairs",
    rows={"fixed_admittance": Phasor},  # without load noise
    scratch={"admittance": Phasor},
    sees={"row_": UNITS, "column_": UNITS, "lane": LANE},
)


@system(LANE, "noise_factor")
def load_noise(noise_y: float, noise_z: Phasor) -> Phasor:
    """Return Δy/(1 + Δy z) of the load noise's conductance Δy."""
    d_re, d_im = 1.0 + noise_y * noise_z.re, noise_y * noise_z.im
    size = noise_y / (d_re * d_re + d_im * d_im)
    return Phasor(size * d_re, -size * d_im)


@system(PAIRS, "admittance")
def admittance_with_noise(
    row_transfer: Phasor, column_transfer: Phasor, noise_factor: Phasor, fixed_admittance: Phasor
) -> Phasor:
    """Put the load noise into the reduced admittance by a rank-one update.

    Y = Y0 + Δy/(1 + Δy z) u uᵀ (Sherman-Morrison): exact for one bus of a network without phase shifters, whose Z is
    symmetric, and cheap enough for every control interval.
    """
    v_re = row_transfer.re * column_transfer.re - row_transfer.im * column_transfer.im
    v_im = row_transfer.re * column_transfer.im + row_transfer.im * column_transfer.re
    f, y0 = noise_factor, fixed_admittance
    return Phasor(y0.re + f.re * v_re - f.im * v_im, y0.im + f.re * v_im + f.im * v_re)


@system(LANE, "angle_rates")
def reference_rate(reference_speed: float, omega_n: float) -> float:
    """Return the rate of the first unit's angle against a frame at nominal frequency."""
    return omega_n * (reference_speed - 1.0)


reference_stage = moving(reference_rate)


@system(LANE, "step")
def count_step(step: float, active: float) -> float:
    """Count a simulation step of a running lane."""
    return step + select(active > 0.5, 1.0, 0.0)
