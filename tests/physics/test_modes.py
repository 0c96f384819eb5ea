"""The linearised system: against transfer functions, against the simulator's own motion, and as linear algebra."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

from docs.studies.small_signal import compare, infinite_bus, sides
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.modes import linearise, modes, synchronising_coefficients
from wtg_gym.physics.parameters import default_groups
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.scenarios import get_suite

PAPER = get_suite("paper").scenario(0)
REFERENCE = STRATEGIES["coordinated-piecewise"]


def test_eigenvalues_on_an_infinite_bus_are_the_poles_of_the_transfer_functions() -> None:
    plant = infinite_bus()
    for law, wind in itertools.product(STRATEGIES.values(), (8.0, 11.4)):
        for side in sides(law):
            _, difference = compare(law, wind, side, plant)
            assert difference < 1e-6, (law.name, wind, side)


@pytest.mark.parametrize("side", ["under", "over"])
@pytest.mark.parametrize("model", ["genrou", "classical"])
def test_small_motion_of_the_simulator_is_that_of_the_linear_model(side: str, model: str) -> None:
    """A push of 1e-6, let go for 0.1 s, before the WTGs' frequencies come back to the corner of g(ω)."""
    settings = PlantSettings(case=modified_ieee14(classical=model == "classical"), simulation_dt=0.0025)
    linear = linearise(PAPER, REFERENCE, settings, side=side)  # type: ignore[arg-type]
    simulator = Simulator(settings)
    rest = Scenario(name="rest", wind_speed=PAPER.wind_speed)
    simulator.start(0, rest, (REFERENCE,) * 2)
    names = list(simulator.layout.state_names)
    index = [names.index(name) for name in linear.state_names]
    here = simulator.state()
    # The WTGs' frequencies leave the corner and stay away from it; the others follow.
    push = np.zeros(here.size)
    for j in range(2):
        push[names.index(f"wtg{j}.speed")] = -1e-6 if side == "under" else 1e-6
        push[names.index(f"wtg{j}.rotor_speed")] = 3e-7
    simulator.set_state(here + push)
    simulator.advance()
    moved = (simulator.state() - here)[index]
    expected = expm(0.1 * linear.matrix) @ push[index]
    assert np.abs(moved - expected).max() < 2e-4 * np.abs(expected).max()
    other = linearise(PAPER, REFERENCE, settings, side="over" if side == "under" else "under")
    wrong = expm(0.1 * other.matrix) @ push[index]
    assert np.abs(moved - wrong).max() > 2e-3 * np.abs(expected).max()


@pytest.mark.parametrize("law", STRATEGIES.values(), ids=lambda law: law.name)
def test_modes_are_the_eigenvalues_and_participations_are_shares(law: object) -> None:
    model = linearise(PAPER, law)  # type: ignore[arg-type]
    found = modes(model)
    count = sum(2 if mode.eigenvalue.imag > 0.0 else 1 for mode in found)
    assert count == model.matrix.shape[0] == len(model.state_names)
    total = sum((2.0 if mode.eigenvalue.imag > 0.0 else 1.0) * mode.eigenvalue.real for mode in found)
    assert total == pytest.approx(float(np.trace(model.matrix)), rel=1e-9)
    for mode in found:
        assert sum(mode.participation.values()) == pytest.approx(1.0)
        assert min(mode.participation.values()) >= 0.0
        assert -1.0 <= mode.damping_ratio <= 1.0
        assert mode.eigenvalue.real < 0.0
    reals = [mode.eigenvalue.real for mode in found]
    assert reals == sorted(reals, reverse=True)


def test_undamped_law_leaves_the_wtg_mode_least_damped() -> None:
    def least(name: str) -> float:
        return min(mode.damping_ratio for mode in modes(linearise(PAPER, STRATEGIES[name], side="over")))

    assert least("coordinated-undamped") < 0.15 < least("coordinated-piecewise")


def test_only_states_without_a_part_in_the_dynamics_are_left_out() -> None:
    left_out = linearise(PAPER, REFERENCE).left_out
    assert {name.split(".")[-1] for name in left_out} == {
        "angle",
        "e_d_transient",
        "gate",
        "reheat",
        "pitch",
        "pitch_integral",
        "energy_captured",
        "energy_delivered",
        "reference_angle",
    }
    assert "sync0.gate" not in left_out and "sync0.angle" in left_out and "sync1.angle" not in left_out
    # Nothing drives E'_d of a machine with x'_q = x_q, such as that at bus 1.
    assert [name for name in left_out if name.endswith("e_d_transient")] == ["sync0.e_d_transient"]


def test_pitch_takes_part_above_rated_wind() -> None:
    windy = Scenario(name="windy", wind_speed=np.array([[16.0], [8.0]]))
    model = linearise(windy, REFERENCE)
    assert "wtg0.pitch" in model.state_names and "wtg1.pitch" not in model.state_names
    assert all(mode.eigenvalue.real < 0.0 for mode in modes(model))


def test_synchronising_coefficients_are_the_power_angle_slope() -> None:
    """One group on an infinite bus: K_p = V E cos δ/X, with the power E V sin δ/X = p."""
    settings = infinite_bus(0.2)
    scenario = Scenario(name="x", wind_speed=np.array([[11.4]]), load_noise_bus=1)
    k_p = synchronising_coefficients(scenario, REFERENCE, settings)
    simulator = Simulator(settings)
    simulator.start(0, scenario, (REFERENCE,))
    power = 0.9663590
    # Reactances on the group's 50 MVA: 0.55 behind the voltage and half of 0.2.
    delta = simulator.state()[list(simulator.layout.state_names).index("wtg0.angle")]
    assert k_p.shape == (1, 1)
    assert k_p[0, 0] == pytest.approx(power / np.tan(delta), rel=1e-5)


def test_groups_of_any_number_can_be_linearised() -> None:
    wind = np.array([[11.0], [9.0], [7.0]])
    model = linearise(Scenario(name="x", wind_speed=wind), REFERENCE, PlantSettings(groups=default_groups(3)))
    assert sum(name == "wtg2.rotor_speed" for name in model.state_names) == 1
    with pytest.raises(ValueError, match="wind for 3 WTG groups"):
        linearise(Scenario(name="x", wind_speed=wind), REFERENCE)
