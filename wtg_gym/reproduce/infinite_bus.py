"""The linearised right-hand side of the simulator against the paper's transfer functions, where they must agree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wtg_gym.physics.machine_parameters import classical_machine
from wtg_gym.physics.modes import Side, linearise, synchronising_coefficients
from wtg_gym.physics.network import Branch, Bus, NetworkCase
from wtg_gym.physics.parameters import WtgGroup
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.reproduce.loops import SingleMachine, single_machine
from wtg_gym.scenarios import get_suite

#: So large a machine that nothing moves it [MVA].
_INFINITE_MVA = 1e9


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Eigenvalues of one WTG group on an infinite bus, by both ways."""

    law: str  # name of the strategy
    wind_m_s: float  # [m/s]
    side: Side  # slope of g(ω)
    synchronising_coefficient: float  # K_p that the network makes [p.u./rad]
    phase_margin_deg: float  # of the transfer function at that K_p [deg]
    poles: tuple[complex, ...]  # closed-loop poles of the transfer function (n,) [1/s]
    eigenvalues: tuple[complex, ...]  # the nearest eigenvalues of the linearised simulator (n,) [1/s]
    largest_difference: float  # largest distance of a pair, relative to its pole [-]


def infinite_bus(reactance_pu: float = 0.2) -> PlantSettings:
    """Return a plant of one WTG group (50 MW) behind a reactance [p.u. of 100 MVA] at an infinite bus, 50 Hz."""
    machine = classical_machine(bus=1, rating_mva=_INFINITE_MVA, two_h_s=1e3, damping_pu=0.0, x_d_transient=1e-3)
    case = NetworkCase(
        name="infinite bus",
        base_mva=100.0,
        frequency_hz=50.0,
        slack_bus=1,
        buses=(Bus(number=1, voltage_pu=1.0), Bus(number=2, voltage_pu=1.0)),
        branches=(Branch(from_bus=1, to_bus=2, resistance=0.0, reactance=reactance_pu),),
        machines=(machine,),
    )
    return PlantSettings(case=case, groups=(WtgGroup(bus=2, n_turbines=10.0),))


def agreements(winds: tuple[float, ...] = (8.0, 11.4)) -> Iterator[Agreement]:
    """Compare every strategy at every wind and on both slopes of g(ω)."""
    settings = infinite_bus()
    for law in STRATEGIES.values():
        sides: tuple[Side, ...] = ("under", "over") if law.k_min != law.k_max else ("under",)
        for wind in winds:
            for side in sides:
                yield compare(law, wind, side, settings)


def compare(law: TrackingLaw, wind_m_s: float, side: Side, settings: PlantSettings) -> Agreement:
    """Compare one strategy on a plant of one WTG group at an infinite bus."""
    scenario = Scenario(name="infinite bus", wind_speed=np.array([[wind_m_s]]), load_noise_bus=1)
    k_p = float(synchronising_coefficients(scenario, law, settings)[0, 0])
    loop = single_machine(law, wind_m_s, k_p, side=side, turbine=settings.turbine)
    poles = loop.closed_loop_poles()
    found = np.linalg.eigvals(linearise(scenario, law, settings, side=side).matrix)
    nearest = np.array([found[np.argmin(np.abs(found - pole))] for pole in poles])
    return Agreement(
        law=law.name,
        wind_m_s=wind_m_s,
        side=side,
        synchronising_coefficient=k_p,
        phase_margin_deg=loop.margins().phase_margin_deg,
        poles=tuple(complex(pole) for pole in poles),
        eigenvalues=tuple(complex(value) for value in nearest),
        largest_difference=float((np.abs(nearest - poles) / np.abs(poles)).max()),
    )


def system_margins() -> Iterator[SingleMachine]:
    """Return the single-machine loops of every strategy at the K_p that the paper's case gives each WTG group."""
    scenario = get_suite("paper").scenario(0)
    for law in STRATEGIES.values():
        coefficients = np.diag(synchronising_coefficients(scenario, law))
        sides: tuple[Side, ...] = ("under", "over") if law.name.startswith("coordinated") else ("under",)
        for wind, k_p in zip(scenario.wind_speed[:, 0], coefficients, strict=True):
            for side in sides:
                yield single_machine(law, float(wind), float(k_p), side=side)
