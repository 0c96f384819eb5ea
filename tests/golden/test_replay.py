"""Golden traces of other simulators, and the script that makes them, as far as it runs without ANDES.

Limits of power and torque, and the chopper, against a second implementation: with numpy and scipy alone.
"""

import dataclasses
import itertools
import math
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests.golden.case import EVENTS, GOLDEN, ROW_S, TRACES, read_case, read_data, read_trace
from tests.golden.make import RUNS, columns, devices, row_times
from tests.golden.replay import differences, replay, sampled
from tests.physics.extended import NO_SHEDDING, numbers, plant, recorded, scenario
from wtg_gym import FrequencyRamp, LoadStep, PhaseJump, Plant, Scenario, TrackingLaw, get_law
from wtg_gym.physics import parameters
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.grid import Branch, Bus, NetworkCase, Source
from wtg_gym.physics.integration import PROGRAMS
from wtg_gym.physics.plant import with_places
from wtg_gym.physics.protection import STAGES
from wtg_gym.physics.simulator import Simulator

OTHERS = {"classical-machines", "ideal-source-units"}
MADE = [path for path in TRACES if path.parent.name not in OTHERS]


def test_there_are_golden_traces_of_every_case_that_the_page_describes():
    rows = re.findall(r"^- (`.*?`): ", (GOLDEN / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
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
        result = replay(case, (), times[:2], ROW_S / 3)
        assert max(abs(result[name][0] - trace[name][0]) for name in trace if name[0] == "V") < 1e-10
    assert default["w"] < 5e-6 and default["Pe"] < power and default["V"] < voltage


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


def held_groups(name: str, power_mw: float, **more) -> Simulator:
    """Play the network of a case with groups at bus 2 whose rotors hold their speed, and compare it with the trace.

    P_st is constant, so that an extended group is the grid-forming converter of the trace.
    """
    case = read_case(name)
    times, trace = read_trace(GOLDEN / name / "a.csv")
    units = dict(zip(case.keys, case.network.machines, strict=True))
    keys = [key for key in units if key[0] != "2"]
    network, unit = dataclasses.replace(case.network, machines=tuple(units[key] for key in keys)), units["2a"]
    swing = {"inertia_constant_s": 0.5 * unit.two_h_s, "droop_gain_pu": unit.damping_pu}
    control = parameters.GridFormingParameters(reactance_pu=unit.x_d_transient, **swing)
    times_s = {"interval_s": ROW_S, "simulation_dt": ROW_S / 20.0}
    settings = plant(limits=False, voltage=False, case=network, control=control, **times_s, **more)
    law = get_law("mppt", settings.turbine)
    power = case.power["2a"].real * case.network.base_mva / unit.rating_mva
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
    result = np.array(sampled(simulator, times, look))
    largest = differences(case, trace, dict(zip(names, result.T, strict=True)))
    assert largest["w"] <= 3e-7 and largest["Pe"] <= 2e-5 and largest["V"] <= 1e-6, largest
    return simulator


def test_a_group_whose_rotor_holds_its_speed_is_the_grid_forming_converter_of_another_simulator():
    held_groups("grid-forming", 75.0)


def test_shedding_does_what_it_does_in_another_simulator_at_the_same_instants():
    levels = (49.85, 49.8, 49.75)
    # So that the stages act at instants of the trace.
    delays, shares, instants = (0.29375, 0.325, 0.390625), (0.05, 0.08, 0.08), (5.5, 5.625, 5.8125)
    stages = tuple(
        parameters.SheddingStage(frequency_pu=level / 50.0, share=share, delay_s=delay)
        for level, share, delay in zip(levels, shares, delays, strict=True)
    )
    shedding = (*stages, *NO_SHEDDING[3:])
    simulator = held_groups("shedding", 150.0, shedding=shedding)
    acted = -1.0 - numbers(simulator, STAGES, "shed")[:3]
    assert (acted / 320.0).tolist() == pytest.approx(instants, abs=1e-12)


class IndependentConverter:
    """A group of turbines with power and torque limits and a chopper, at a voltage whose frequency is imposed.

    On the base of the group but for `reactances`: of the converter, of the line and of the source, in p.u. of one base,
    with 1 p.u. of voltage at both ends of the line. Blades at rest, constant voltage behind the reactance.
    """

    OMEGA_N, H, DROOP, TAU = 2.0 * np.pi * 50.0, 5.0, 62.5, 0.8
    H_ROTOR, TIP_M_S, WIND_POWER = 6.5, 1.27 * 63.0, 0.5 * 1.23 * np.pi * 63.0**2 / 5e6
    P_MAX, T_MAX, P_MIN, K_P, K_I, COOLING_S = 1.1, 1.1, 0.0, 0.01, 0.1, 60.0

    def __init__(self, k: tuple[float, float, float], wind: float, reactances: tuple[float, float, float]) -> None:
        self.k, self.wind = k, wind
        own, line, source = reactances
        rotor = brentq(lambda w: self.captured(w) - k[1] * w**3, 7.0 * wind / self.TIP_M_S, 14.0 * wind / self.TIP_M_S)
        power = k[1] * rotor**3
        far, near = 1.0, np.exp(1j * np.arcsin(power * line))
        current = (near - far) / (1j * line)
        emf, stiff = near + 1j * own * current, far - 1j * source * current
        self.most = abs(emf) * abs(stiff) / sum(reactances)
        # Angle of the voltage, ω, filter, rotor speed, both limiters, energies delivered and burnt, heat, source.
        self.start = np.array([np.angle(emf), 1.0, 0.0, rotor, 0.0, 0.0, 0.0, 0.0, 0.0, np.angle(stiff), 1.0])

    def captured(self, rotor: float) -> float:
        inverse = self.wind / (self.TIP_M_S * rotor) - 0.035
        return float(self.WIND_POWER * self.wind**3 * 0.5 * (100.0 * inverse - 5.0) * np.exp(-17.3 * inverse))

    def seen(self, x: np.ndarray) -> tuple[float, float, float]:
        """Return power, the most that is held, and the shift of the frequency."""
        power, most = self.most * np.sin(x[0] - x[9]), min(self.P_MAX, self.T_MAX * x[3])
        over, under = self.K_P * (most - power) + x[4], self.K_P * (self.P_MIN - power) + x[5]
        return power, most, min(over, 0.0) + max(under, 0.0)

    def rates(self, x: np.ndarray, ramp: float) -> np.ndarray:
        power, most, shift = self.seen(x)
        deviation, rotor, drawn = x[1] - 1.0, x[3], max(power, self.P_MIN)
        tracked = min(np.interp(x[1] + shift, (0.992, 1.0, 1.008), self.k) * rotor**3, most)
        over, under = self.K_I * (most - power), self.K_I * (self.P_MIN - power)
        swing = (tracked - power + self.DROOP * (x[2] - deviation)) / (2.0 * self.H)
        accelerated = (self.captured(rotor) - drawn) / (2.0 * self.H_ROTOR * rotor)
        moving = [self.OMEGA_N * (deviation + shift), swing, (deviation - x[2]) / self.TAU, accelerated]
        limiters = [0.0 if x[4] >= 0.0 and over > 0.0 else over, 0.0 if x[5] <= 0.0 and under < 0.0 else under]
        energies = [power, drawn - power, drawn - power - x[8] / self.COOLING_S]
        return np.array([*moving, *limiters, *energies, self.OMEGA_N * (x[10] - 1.0), ramp])

    def run(self, changes: list[tuple[float, float, float]], times: np.ndarray) -> dict[str, np.ndarray]:
        """Return numbers at times [s]; a change is an instant [s], a jump [rad] and the ramp from then on [p.u./s]."""
        state, ramp, rows, fine = self.start.copy(), 0.0, [], {"max_step": 0.01, "rtol": 1e-9, "atol": 1e-11}
        edges = [0.0, *(t for t, _, _ in changes), float(times[-1])]
        for place, (begin, end) in enumerate(itertools.pairwise(edges)):
            if place:
                state[9] += changes[place - 1][1]
                ramp = changes[place - 1][2]
            wanted = times[(times > begin) & (times <= end)]
            at = np.unique(np.append(wanted, end))
            done = solve_ivp(lambda _t, x, r=ramp: self.rates(x, r), (begin, end), state, t_eval=at, **fine)
            rows += [[*x, *self.seen(x)] for t, x in zip(done.t, done.y.T, strict=True) if t in wanted]
            state = done.y[:, -1].copy()
        result = np.array(rows)
        names = ("speed", "filter", "rotor_speed", "over_power", "under_power", "energy_delivered", "energy_chopped")
        numbers = dict(zip((*names, "heat"), result.T[1:9], strict=True))
        return numbers | {"power": result[:, 11], "shift": result[:, 13]}


def test_limits_of_power_and_torque_and_the_chopper_agree_with_a_second_implementation():
    buses = Bus(number=1, voltage_pu=1.0), Bus(number=2, voltage_pu=1.0)
    lines, sources = (Branch(from_bus=1, to_bus=2, resistance=0.0, reactance=0.1),), (Source(bus=1, reactance=0.05),)
    base = {"name": "a group at an imposed source", "base_mva": 100.0, "frequency_hz": 50.0, "slack_bus": 1}
    network = NetworkCase(buses=buses, branches=lines, machines=(), sources=sources, **base)
    settings = Plant(
        case=network,
        groups=(parameters.WtgGroup(bus=2, n_turbines=20.0),),
        turbine=parameters.TurbineParameters(conserves_energy=True),
        limits=parameters.ConverterLimitParameters(current_max_pu=10.0),
        protection=parameters.ProtectionParameters(frequency_min_pu=0.5, frequency_max_pu=1.5),
        simulation_dt=0.0025,
    )
    events = (
        FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=-0.5, duration_s=0.8),
        PhaseJump(time_s=6.0, bus=1, angle_deg=-40.0),
        FrequencyRamp(time_s=10.0, bus=1, rocof_hz_s=1.0, duration_s=1.0),
        PhaseJump(time_s=15.0, bus=1, angle_deg=70.0),
    )
    jumps = (math.radians(-40.0), math.radians(70.0))
    changes = [(1.0, 0.0, -0.01), (1.8, 0.0, 0.0), (6.0, jumps[0], 0.0)]
    changes += [(10.0, 0.0, 0.02), (11.0, 0.0, 0.0), (15.0, jumps[1], 0.0)]
    k = (1.3, 0.65, 0.55)
    law = TrackingLaw(name="steep", k_min=k[0], k_nominal=k[1], k_max=k[2], damping_time_constant_s=0.8)
    what = Scenario(name="x", wind_speed=np.array([[11.0]]), events=events, duration_s=20.0, load_noise_bus=1)
    simulator = Simulator(settings, duration_s=20.0)
    simulator.start(0, what, (law,))
    times = 0.1 * np.arange(1, 201)
    expected = IndependentConverter(k, 11.0, (0.55, 0.1, 0.05)).run(changes, times)
    result = recorded(simulator, 20.0, *expected)
    assert len(result["coi"]) == 200
    for name, values in expected.items():
        tolerance = {"power": 1e-5, "heat": 1e-5, "energy_delivered": 2e-6, "energy_chopped": 2e-6}.get(name, 2e-7)
        assert np.abs(result[name][:, 0] - values).max() < tolerance, name
    assert expected["shift"].min() < -0.01 and expected["shift"].max() > 0.01 and expected["heat"].max() > 0.1
    assert simulator.wtg_values("pitch")[0] == 0.0
