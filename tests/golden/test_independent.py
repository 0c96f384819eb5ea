"""Limits of power and torque, and the chopper, against a second implementation of the equations."""

import math

import numpy as np

from tests.golden.independent import IndependentConverter
from tests.physics.extended import recorded
from wtg_gym.physics.grid import Branch, Bus, NetworkCase, Source
from wtg_gym.physics.parameters import ConverterLimitParameters, ProtectionParameters, TurbineParameters, WtgGroup
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import FrequencyRamp, PhaseJump, Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import TrackingLaw


def test_limits_of_power_and_torque_and_the_chopper_agree_with_a_second_implementation():
    network = NetworkCase(
        name="a group at an imposed source",
        base_mva=100.0,
        frequency_hz=50.0,
        slack_bus=1,
        buses=(Bus(number=1, voltage_pu=1.0), Bus(number=2, voltage_pu=1.0)),
        branches=(Branch(from_bus=1, to_bus=2, resistance=0.0, reactance=0.1),),
        machines=(),
        sources=(Source(bus=1, reactance=0.05),),
    )
    settings = Plant(
        case=network,
        groups=(WtgGroup(bus=2, n_turbines=20.0),),
        turbine=TurbineParameters(conserves_energy=True),
        limits=ConverterLimitParameters(current_max_pu=10.0),
        protection=ProtectionParameters(frequency_min_pu=0.5, frequency_max_pu=1.5),
        simulation_dt=0.0025,
    )
    events = (
        FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=-0.5, duration_s=0.8),
        PhaseJump(time_s=6.0, bus=1, angle_deg=-40.0),
        FrequencyRamp(time_s=10.0, bus=1, rocof_hz_s=1.0, duration_s=1.0),
        PhaseJump(time_s=15.0, bus=1, angle_deg=70.0),
    )
    changes = [
        (1.0, 0.0, -0.01),
        (1.8, 0.0, 0.0),
        (6.0, math.radians(-40.0), 0.0),
        (10.0, 0.0, 0.02),
        (11.0, 0.0, 0.0),
        (15.0, math.radians(70.0), 0.0),
    ]
    k = (1.3, 0.65, 0.55)
    law = TrackingLaw(name="steep", k_min=k[0], k_nominal=k[1], k_max=k[2], damping_time_constant_s=0.8)
    what = Scenario(name="x", wind_speed=np.array([[11.0]]), events=events, duration_s=20.0, load_noise_bus=1)
    simulator = Simulator(settings, duration_s=20.0)
    simulator.start(0, what, (law,))
    times = 0.1 * np.arange(1, 201)
    expected = IndependentConverter(k, 11.0, (0.55, 0.1, 0.05)).run(changes, times)
    found = recorded(simulator, 20.0, *expected)
    assert len(found["coi"]) == 200
    for name, values in expected.items():
        tolerance = {"power": 1e-5, "heat": 1e-5, "energy_delivered": 2e-6, "energy_chopped": 2e-6}.get(name, 2e-7)
        assert np.abs(found[name][:, 0] - values).max() < tolerance, name
    assert expected["shift"].min() < -0.01 and expected["shift"].max() > 0.01 and expected["heat"].max() > 0.1
    assert simulator.wtg_values("pitch")[0] == 0.0
