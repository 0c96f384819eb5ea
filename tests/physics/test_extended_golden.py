"""Facts about extended WTG groups beside another simulator's converters and loads: golden traces of ANDES."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tests.golden.case import GOLDEN, ROW_S, read_case, read_trace
from tests.golden.replay import differences, sampled
from tests.physics.extended import NO_SHEDDING, plant, scenario
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.integration import PROGRAMS
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, SheddingStage
from wtg_gym.physics.plant import with_places
from wtg_gym.physics.protection import STAGES
from wtg_gym.physics.scenario import LoadStep
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import get_law


def against_golden_trace(name: str, events: Sequence[LoadStep], **more: Any) -> tuple[Simulator, dict[str, float]]:
    """Run the network of a golden case with WTG groups at bus 2 whose rotors hold their speed: P_st is constant.

    Returns:
        the simulator, and the largest difference to the trace by quantity.
    """
    case = read_case(name)
    times, trace = read_trace(GOLDEN / name / "a.csv")
    units = dict(zip(case.keys, case.network.machines, strict=True))
    keys = [key for key in units if key[0] != "2"]
    settings = plant(
        limits=False,
        voltage=False,
        case=dataclasses.replace(case.network, machines=tuple(units[key] for key in keys)),
        control=GridFormingParameters(
            inertia_constant_s=0.5 * units["2a"].two_h_s,
            droop_gain_pu=units["2a"].damping_pu,
            reactance_pu=units["2a"].x_d_transient,
        ),
        control_dt=ROW_S,
        simulation_dt=ROW_S / 20.0,
        **more,
    )
    law = get_law("mppt", settings.turbine)
    power = case.power["2a"].real * case.network.base_mva / units["2a"].rating_mva
    wind = (power / tracking_point(0.0, settings.turbine).power_coefficient) ** (1.0 / 3.0)
    wind /= settings.turbine.wind_power_pu_per_cubic_wind ** (1.0 / 3.0)
    run = scenario(*events, wind=[[wind], [wind]], duration_s=60.0, load_noise_bus=1)
    simulator = Simulator(settings, duration_s=60.0)
    turbine = simulator.plant.turbine.copy()
    turbine["rotor.inv_two_h"] = 0.0
    simulator.plant = with_places(simulator.plant._replace(turbine=turbine), simulator.layout, PROGRAMS)
    simulator.start(0, run, (law, law))

    def look(now: Simulator) -> Floats:
        machines = [now.machine_values(name)[0] for name in ("speed", "power")]
        groups = now.wtg_values("speed")[0], now.wtg_values("power")[0] * now.plant.share
        return np.concatenate([*machines, *groups, np.abs(now.bus_voltages())])

    names = [f"{quantity}{key}" for own in (keys, ("2a", "2b")) for quantity in ("w", "Pe") for key in own]
    names += [f"V{number}" for number in case.network.bus_numbers]
    found = np.array(sampled(simulator, times, look))
    return simulator, differences(case, trace, dict(zip(names, found.T, strict=True)))


def step_up(power_mw: float) -> tuple[LoadStep, ...]:
    return LoadStep(time_s=5.0, bus=2, power_mw=power_mw), LoadStep(time_s=30.0, bus=3, power_mw=75.0)


def test_a_group_whose_rotor_holds_its_speed_is_the_grid_forming_converter_of_another_simulator():
    _, largest = against_golden_trace("grid-forming", step_up(75.0))
    assert largest["w"] <= 3e-7 and largest["Pe"] <= 2e-5 and largest["V"] <= 1e-6, largest


def test_shedding_does_what_it_does_in_another_simulator_at_the_same_instants():
    levels = (49.85, 49.8, 49.75)
    # So that the stages act at instants of the trace.
    delays, shares, instants = (0.29375, 0.325, 0.390625), (0.05, 0.08, 0.08), (5.5, 5.625, 5.8125)
    stages = tuple(
        SheddingStage(frequency_pu=level / 50.0, share=share, delay_s=delay)
        for level, share, delay in zip(levels, shares, delays, strict=True)
    )
    shedding = (*stages, *NO_SHEDDING[3:])
    simulator, largest = against_golden_trace("shedding", step_up(150.0), shedding=shedding)
    acted = -1.0 - simulator.blocks[0, simulator.layout.first_rows(STAGES, "shed")[:3], 0]
    assert (acted / 320.0).tolist() == pytest.approx(instants, abs=1e-12)
    assert largest["w"] <= 3e-7 and largest["Pe"] <= 2e-5 and largest["V"] <= 1e-6, largest
