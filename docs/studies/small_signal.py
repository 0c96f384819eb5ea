"""Small signal, for docs/validation.md: the paper's loop against the simulator, and margins.

The paper's transfer functions describe one WTG on an infinite bus. The simulator, linearised numerically from the
right-hand side that it integrates, must have the same poles there.
"""

import dataclasses

import numpy as np
from output import folder as output_folder
from paper import single_machine

from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.grid import Branch, Bus, NetworkCase
from wtg_gym.physics.linearisation import moving_matrix
from wtg_gym.physics.machine_parameters import classical_machine
from wtg_gym.physics.parameters import WtgGroup
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import LAWS, group_laws
from wtg_gym.scenarios import get_suite

WINDS = (8.0, 11.4)
INFINITE_MVA = 1e9  # so large a machine that nothing moves it
DIFFERENCE = 2e-6  # of a state [rad, p.u.]; truncation and rounding are both near 1e-9 of a power


# --- the linearised system --------------------------------------------------------------------------------------------


def at_rest(scenario, laws, settings=None):
    """Return a simulator in the equilibrium that a scenario starts from; its events do not matter."""
    settings = settings or Plant()
    duration_s = settings.interval_s * max(1, round(1.0 / settings.interval_s))
    simulator = Simulator(settings, duration_s=duration_s)
    laws = group_laws(laws, settings.turbines, settings.control)
    simulator.start(0, dataclasses.replace(scenario, events=(), duration_s=duration_s), laws)
    return simulator


def linearise(scenario, laws, settings=None, *, side="under"):
    """Return A of ẋ = A x around the equilibrium that a scenario starts from, and the names of the states.

    `laws` are one law or strategy name for all WTG groups or one for each. `side` is the slope of g(ω) at ω_st. The
    pitch protection at rest takes no part, since it only acts upwards.
    """
    simulator = at_rest(scenario, laws, settings)
    rows, layout = simulator.blocks[0, :, 0], simulator.layout
    matrix, keep = moving_matrix(rows, simulator.plant, layout, {"under": -1.0, "over": 1.0}[side])
    return matrix, np.array(layout.state_names)[keep].tolist()


def synchronising_coefficients(scenario, laws, settings=None):
    """Return ∂p_i/∂δ_j between WTG groups, on the base of group i, shape (n_wtg, n_wtg) [p.u./rad].

    The diagonal is the K_p of the paper's single-machine model in this network, with the angles of all other units
    held. The sum of a row is K_p where all groups swing together against the synchronous machines.
    """
    simulator = at_rest(scenario, laws, settings)
    rows, columns = simulator.blocks[0, :, 0], []
    for row in simulator.layout.wtg("angle"):
        powers, start = [], rows[row]
        for sign in (-1.0, 1.0):
            rows[row] = start + sign * DIFFERENCE
            simulator.evaluate()
            powers.append(simulator.wtg_values("power")[0])
        rows[row] = start
        columns.append((powers[1] - powers[0]) / (2.0 * DIFFERENCE))
    return np.stack(columns, axis=1)


# --- the tables -------------------------------------------------------------------------------------------------------


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


def compare(law, wind_m_s, side, settings):
    """Return the paper's loop on an infinite bus at the K_p of that network, and how far its poles are off.

    The distance is the largest from a pole to the simulator's nearest eigenvalue, relative to the pole.
    """
    scenario = Scenario(name="infinite bus", wind_speed=np.array([[wind_m_s]]), load_noise_bus=1)
    k_p = float(synchronising_coefficients(scenario, law, settings)[0, 0])
    loop = single_machine(law, wind_m_s, k_p, side, turbine=settings.turbine)
    poles = loop.closed_loop_poles()
    eigenvalues = np.linalg.eigvals(linearise(scenario, law, settings, side=side)[0])
    nearest = np.array([eigenvalues[np.argmin(np.abs(eigenvalues - pole))] for pole in poles])
    return loop, float((np.abs(nearest - poles) / np.abs(poles)).max())


def margins_table():
    """Return how the models differ on an infinite bus, and the margins in the 14-bus system, a law in one row."""
    plant, paper = infinite_bus(), get_suite("paper").scenario(0)
    differences, rows, coefficients = [], [], []
    for law in LAWS.values():
        in_system = dict(zip(paper.wind_speed[:, 0], np.diag(synchronising_coefficients(paper, law)), strict=True))
        cells, sides = [], ("under", "over") if law.k_min != law.k_max else ("under",)
        for wind in WINDS:
            alone, difference = zip(*(compare(law, wind, side, plant) for side in sides), strict=True)
            system = [single_machine(law, wind, float(in_system[wind]), side=side) for side in sides]
            differences += difference
            coefficients.append([loops[0].synchronising_coefficient for loops in (alone, system)])
            # One number where the slopes of g(ω) do not differ.
            cells.append(" / ".join(dict.fromkeys(f"{loop.margins().phase_margin_deg:.1f}" for loop in system)))
        rows.append((law.name, *cells))
    (least, least_system), (most, most_system) = np.min(coefficients, axis=0), np.max(coefficients, axis=0)
    header = ("margin in the 14-bus system [°]", *(f"{wind:g} m/s" for wind in WINDS))
    return (
        f"Largest relative difference of a closed-loop pole between both models: {max(differences):.0e}. K_p is "
        f"{least:.2f} … {most:.2f} at the infinite bus, {least_system:.2f} … {most_system:.2f} in the 14-bus system."
        f"\n\n{markdown_table(header, rows, right=(1, 2))}"
    )


if __name__ == "__main__":
    folder = output_folder(__doc__)
    update_between_markers(folder / "validation.md", margins_table(), "small-signal")
