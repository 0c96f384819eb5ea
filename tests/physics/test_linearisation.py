"""The linearised system: its modes, and which integration steps a plant takes."""

import dataclasses
import math

import numpy as np
import pytest

from tests.physics.extended import plant, scenario, with_machine
from wtg_gym import Plant, TrackingLaw, get_law
from wtg_gym.physics.linearisation import largest_stable_steps
from wtg_gym.physics.parameters import ConverterLimitParameters, GridFormingParameters, VoltageControlParameters
from wtg_gym.physics.simulator import Simulator

LAWS = (get_law("coordinated-piecewise"),) * 2


@pytest.mark.parametrize("value", [-40.0 + 0j, -8.9 + 46j, -0.2 + 17j])
def test_a_mode_grows_just_beyond_its_largest_step_and_not_just_below(value):
    limit = float(largest_stable_steps(np.array([value])).min())
    # What a step of the classical Runge-Kutta method multiplies by: the exponential series up to its fourth power.
    below, beyond = (abs(sum((s * limit * value) ** n / math.factorial(n) for n in range(5))) for s in (0.999, 1.001))
    assert below < 1.0 < beyond


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (Plant(case=with_machine(t_d0_subtransient_s=0.009)), r"eigenvalue -11\d.*mainly sync0.psi_1d.* at most 0.022"),
        (
            plant(voltage=VoltageControlParameters(integral_gain=1000.0)),
            r"eigenvalue -98\d.* 1/s \(mainly wtg[01].internal_voltage\) .* at most 0.0027 s",
        ),
        # It switches at 0.5 p.u. a step once the power exceeds its limit.
        (plant(limits=ConverterLimitParameters(power_gain=1.0)), r"mainly wtg[01].angle\)"),
    ],
)
def test_a_plant_that_is_too_fast_for_the_step_is_refused(settings, message):
    with pytest.raises(ValueError, match=r"simulation_dt = 0.025 s is too long for this plant.*" + message):
        Simulator(settings)


def test_an_inertia_that_is_too_small_for_the_step_is_refused_with_its_scenario():
    simulator = Simulator(Plant(case=with_machine(two_h_s=0.5)))
    light, lighter = (scenario(inertia_scale=scale) for scale in (0.3, 0.05))
    simulator.prepare([light], LAWS)
    for _ in range(2):
        with pytest.raises(ValueError, match=r"scenario 'x', inertia_scale = 0.05: simulation_dt = 0.025 s"):
            simulator.prepare([light, lighter], LAWS)
    simulator.prepare([light], LAWS)


@pytest.mark.parametrize(
    ("inertia_s", "k_min", "k_nominal", "k_max", "wind_m_s"),
    [
        # The slope below ω_st is what is fast, but only once the wind has risen: it acts on the cube of the speed.
        (2.0, 3.0, 0.6, 0.55, 5.0),
        # The steeper slope takes power away while the frequency falls; the other one is what is fast.
        (0.7, 0.05, 0.9, 0.2, 16.0),
    ],
)
def test_a_law_that_is_too_steep_for_the_step_is_refused(inertia_s, k_min, k_nominal, k_max, wind_m_s):
    law = TrackingLaw(name="steep", k_min=k_min, k_nominal=k_nominal, k_max=k_max)
    what = scenario(wind=np.full((2, 1), wind_m_s))
    light = Plant(control=GridFormingParameters(inertia_constant_s=inertia_s))
    with pytest.raises(ValueError, match=r"\(mainly wtg[01].speed\) would grow without bound"):
        Simulator(light).prepare([what], (law,) * 2)
    Simulator(dataclasses.replace(light, simulation_dt=0.01)).prepare([what], (law,) * 2)


def test_steps_and_inertias_that_are_allowed_suit_the_default_plant():
    Simulator(Plant(simulation_dt=0.04, control_dt=0.2)).prepare([scenario(inertia_scale=0.05)], LAWS)
    Simulator(Plant(simulation_dt=0.05)).prepare([scenario()], LAWS)
