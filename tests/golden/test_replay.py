"""Golden traces of other simulators, and the script that makes them, as far as it runs without ANDES."""

import dataclasses
import re

import numpy as np
import pytest

from tests.golden.case import GOLDEN, ROW_S, TRACES, read_case, read_data, read_trace
from tests.golden.make import RUNS, columns, devices, row_times
from tests.golden.replay import differences, replay, sampled
from tests.golden.shipped import EVENTS
from tests.physics.extended import NO_SHEDDING, plant, scenario
from wtg_gym import LoadStep, get_law
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.integration import PROGRAMS
from wtg_gym.physics.parameters import GridFormingParameters, SheddingStage
from wtg_gym.physics.plant import with_places
from wtg_gym.physics.protection import STAGES
from wtg_gym.physics.simulator import Simulator


def test_there_are_golden_traces_of_every_case_that_the_page_describes():
    rows = re.findall(r"^\| (`.*?) \|", (GOLDEN / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    named = {name for row in rows for name in re.findall("`(.*?)`", row)}
    assert {trace.parent.name for trace in TRACES} == named and len(TRACES) >= 25


@pytest.mark.parametrize("path", TRACES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_fine_step_follows_the_golden_trace_and_the_default_step_is_close_to_it(path):
    case = read_case(path.parent.name)
    times, trace = read_trace(path)
    assert set(trace) <= set(case.columns)
    events = case.events[path.stem]
    fine, default = (differences(case, trace, replay(case, events, times, dt)) for dt in (0.0025, ROW_S / 3))
    for quantity, tolerance in case.tolerance.items():
        assert fine[quantity] <= tolerance, (quantity, fine[quantity])
    # Faults take more than half the voltage away; of 39 buses the machines are ten times as large as the base.
    large = case.network.load_mw > 10.0 * case.network.base_mva
    voltage, power = (2e-4, 5e-3) if large else (5e-5 if path.stem == "faults" else 2e-5, 5e-4)
    if path.parent.name in EVENTS:
        power = 1e-2  # limits bind within a step
        found = replay(case, (), times[:2], ROW_S / 3)
        assert max(abs(found[name][0] - trace[name][0]) for name in trace if name[0] == "V") < 1e-10
    assert default["w"] < 5e-6 and default["Pe"] < power and default["V"] < voltage


OTHERS = {"classical-machines", "ideal-source-units"}
MADE = [path for path in TRACES if path.parent.name not in OTHERS]


@pytest.mark.parametrize("path", MADE, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_trace_made_anew_has_the_rows_the_columns_and_the_machines_of_the_one_kept(path):
    data, run = read_data(path.parent.name), RUNS[path.parent.name]
    events = data["events"][path.stem]
    times, trace = read_trace(path)
    assert columns(data, events) == ("t", *trace)
    assert row_times(events, run.duration_s).tolist() == times.tolist()
    system = devices(data, events, run)
    names = {(model, device["idx"]) for model, device in system if "idx" in device}
    assert set(data["gens"]) == {name for model, name in names if model in ("GENROU", "GENCLS", "REGF1", "REGF2")}
    assert {(device["model"], device["dev"]) for model, device in system if model in ("Toggle", "Alter")} <= names


def held_groups(name: str, power_mw: float, **more) -> tuple[Simulator, dict[str, float]]:
    """Play the network of a case with groups at bus 2 whose rotors hold their speed; return it and its differences.

    P_st is constant, so that an extended group is the grid-forming converter of the trace.
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
    events = (LoadStep(time_s=t, bus=bus, power_mw=p) for t, bus, p in ((5.0, 2, power_mw), (30.0, 3, 75.0)))
    run = scenario(*events, wind=[[wind], [wind]], duration_s=60.0, load_noise_bus=1)
    simulator = Simulator(settings, duration_s=60.0)
    turbine = simulator.plant.turbine.copy()
    turbine["rotor.inv_two_h"] = 0.0
    simulator.plant = with_places(simulator.plant._replace(turbine=turbine), simulator.layout, PROGRAMS)
    simulator.start(0, run, (law, law))

    def look(now: Simulator) -> np.ndarray:
        machines = [now.machine_values(name)[0] for name in ("speed", "power")]
        groups = now.wtg_values("speed")[0], now.wtg_values("power")[0] * now.plant.share
        return np.concatenate([*machines, *groups, np.abs(now.bus_voltages())])

    names = [f"{quantity}{key}" for own in (keys, ("2a", "2b")) for quantity in ("w", "Pe") for key in own]
    names += [f"V{number}" for number in case.network.bus_numbers]
    found = np.array(sampled(simulator, times, look))
    return simulator, differences(case, trace, dict(zip(names, found.T, strict=True)))


def test_a_group_whose_rotor_holds_its_speed_is_the_grid_forming_converter_of_another_simulator():
    _, largest = held_groups("grid-forming", 75.0)
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
    simulator, largest = held_groups("shedding", 150.0, shedding=shedding)
    acted = -1.0 - simulator.blocks[0, simulator.layout.first_rows(STAGES, "shed")[:3], 0]
    assert (acted / 320.0).tolist() == pytest.approx(instants, abs=1e-12)
    assert largest["w"] <= 3e-7 and largest["Pe"] <= 2e-5 and largest["V"] <= 1e-6, largest
