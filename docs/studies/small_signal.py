"""Small signal, for docs/validation.md: the paper's loop against the simulator, and margins.

The paper's transfer functions describe one WTG on an infinite bus. The simulator, linearised numerically from the
right-hand side that it integrates, must have the same poles there.
"""

import dataclasses

import numpy as np
from output import DOCS
from paper import single_machine

from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.grid import Branch, Bus, NetworkCase
from wtg_gym.physics.linearisation import moving_matrix, state_matrix
from wtg_gym.physics.machine_parameters import classical_machine
from wtg_gym.physics.parameters import WtgGroup
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import LAWS, group_laws
from wtg_gym.scenarios import get_suite

WINDS = (8.0, 11.4)
INFINITE_MVA = 1e9  # so large a machine that nothing moves it
SIDES = {"under": -1.0, "over": 1.0}  # slopes of g(ω) at ω_st


def at_rest(scenario, law, plant):
    """Return state, plant and layout of the equilibrium that a scenario starts from; its events do not matter."""
    duration_s = plant.interval_s * max(1, round(1.0 / plant.interval_s))
    simulator = Simulator(plant, duration_s=duration_s)
    laws = group_laws(law, plant.turbines, plant.control)
    simulator.start(0, dataclasses.replace(scenario, events=(), duration_s=duration_s), laws)
    return simulator.blocks[0, :, 0], simulator.plant, simulator.layout


def linearise(scenario, law, plant, side):
    """Return A of ẋ = A x around the equilibrium that a scenario starts from.

    The pitch protection at rest takes no part, since it only acts upwards.
    """
    matrix, _ = moving_matrix(*at_rest(scenario, law, plant), SIDES[side])
    return matrix


def synchronising_coefficients(scenario, law, plant):
    """Return K_p = ∂p/∂δ of each WTG group, on its own base, with the angles of all other units held [p.u./rad].

    This is the K_p of the paper's single-machine model in this network: 2H dω/dt falls by it per radian.
    """
    rows, tables, layout = at_rest(scenario, law, plant)
    matrix = state_matrix(rows, tables, layout, SIDES["under"])
    of_speed, of_angle = (np.flatnonzero(np.isin(layout.state_rows, layout.wtg(name))) for name in ("speed", "angle"))
    return -2.0 * plant.control.inertia_constant_s * matrix[of_speed, of_angle]


def infinite_bus(reactance_pu=0.2):
    """Return a plant of one WTG group (50 MW) behind a reactance [p.u. of 100 MVA] at an infinite bus, 50 Hz."""
    case = NetworkCase(
        name="infinite bus",
        base_mva=100.0,
        frequency_hz=50.0,
        slack_bus=1,
        buses=(Bus(number=1, voltage_pu=1.0), Bus(number=2, voltage_pu=1.0)),
        branches=(Branch(from_bus=1, to_bus=2, resistance=0.0, reactance=reactance_pu),),
        machines=(classical_machine(bus=1, rating_mva=INFINITE_MVA, two_h_s=1e3, damping_pu=0.0, x_d_transient=1e-3),),
    )
    return Plant(case=case, groups=(WtgGroup(bus=2, n_turbines=10.0),))


def compare(law, wind_m_s, side, plant):
    """Return K_p on an infinite bus, and how far the poles of the paper's loop are off there.

    The distance is the largest from a pole to the simulator's nearest eigenvalue, relative to the pole.
    """
    scenario = Scenario(name="infinite bus", wind_speed=np.array([[wind_m_s]]), load_noise_bus=1)
    k_p = float(synchronising_coefficients(scenario, law, plant)[0])
    poles = single_machine(law, wind_m_s, k_p, side).closed_loop_poles()
    eigenvalues = np.linalg.eigvals(linearise(scenario, law, plant, side))
    nearest = np.array([eigenvalues[np.argmin(np.abs(eigenvalues - pole))] for pole in poles])
    return k_p, float((np.abs(nearest - poles) / np.abs(poles)).max())


def margins_table():
    """Return how the models differ on an infinite bus, and the margins in the 14-bus system, a law in one row."""
    alone, system, paper = infinite_bus(), Plant(), get_suite("paper").scenario(0)
    differences, rows, coefficients = [], [], []
    for law in LAWS.values():
        in_system = dict(zip(paper.wind_speed[:, 0], synchronising_coefficients(paper, law, system), strict=True))
        cells, sides = [], tuple(SIDES) if law.k_min != law.k_max else ("under",)
        for wind in WINDS:
            on_bus, of_poles = zip(*(compare(law, wind, side, alone) for side in sides), strict=True)
            loops = [single_machine(law, wind, float(in_system[wind]), side) for side in sides]
            differences += of_poles
            coefficients.append((on_bus[0], in_system[wind]))
            # One number where the slopes of g(ω) do not differ.
            cells.append(" / ".join(dict.fromkeys(f"{loop.phase_margin_deg():.1f}" for loop in loops)))
        rows.append((law.name, *cells))
    (least, least_system), (most, most_system) = np.min(coefficients, axis=0), np.max(coefficients, axis=0)
    header = ("margin in the 14-bus system [°]", *(f"{wind:g} m/s" for wind in WINDS))
    return (
        f"Largest relative difference of a closed-loop pole between both models: {max(differences):.0e}. K_p is "
        f"{least:.2f} … {most:.2f} at the infinite bus, {least_system:.2f} … {most_system:.2f} in the 14-bus system."
        f"\n\n{markdown_table(header, rows, right=(1, 2))}"
    )


if __name__ == "__main__":
    update_between_markers(DOCS / "validation.md", margins_table(), "small-signal")
