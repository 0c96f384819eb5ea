"""Facts about plants with converter limits, voltage control, an energy-keeping rotor, shedding and hydro governors.

Two plants are compiled: the paper's curve, and a table with a hydro governor. Options are numbers within them.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import root

from tests.golden_cases import GOLDEN
from wtg_gym.analysis.case_file import read_parameters
from wtg_gym.analysis.trace_file import Trace, read_trace
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.dynamics import unit_currents
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats, Layout
from wtg_gym.physics.linearisation import moving_states, state_matrix
from wtg_gym.physics.network import assemble_admittance
from wtg_gym.physics.nrel5mw import nrel_5mw
from wtg_gym.physics.parameters import (
    ConverterLimitParameters,
    GovernorParameters,
    GridFormingParameters,
    HydroGovernorParameters,
    ProtectionParameters,
    SheddingStage,
    TurbineParameters,
    VoltageControlParameters,
    WtgGroup,
    default_groups,
    european_shedding,
)
from wtg_gym.physics.plant import PlantSettings, build_plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.reduction import combine_load_noise, refresh_network
from wtg_gym.physics.scenario import LoadStep, Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import get_law, mppt
from wtg_gym.scenarios import get_suite

#: Limits, voltage control, rotor that keeps its energy: all but none of them.
OPTIONS = [options for options in itertools.product((False, True), repeat=3) if any(options)]
#: As many stages as Europe's, so that the plant is compiled once; without an effect.
NO_SHEDDING = tuple(dataclasses.replace(stage, share=0.0) for stage in european_shedding())
LAW = "coordinated-piecewise"
WIND = np.array([[11.4], [8.0]])
CURRENT_MAX = ConverterLimitParameters().current_max_pu


def plant(
    *,
    table: bool = False,
    limits: bool | ConverterLimitParameters = True,
    voltage: bool | VoltageControlParameters = True,
    energy: bool = True,
    dead_band: float = 0.0,
    **more: Any,
) -> PlantSettings:
    """One of the two plants, with its options."""
    case = modified_ieee14()
    kind = HydroGovernorParameters if table else GovernorParameters
    generator = dataclasses.replace(case.machines[0], governor=kind(dead_band_pu=dead_band))
    given = {
        "case": dataclasses.replace(case, machines=(generator, *case.machines[1:])),
        "turbine": nrel_5mw(conserves_energy=energy) if table else TurbineParameters(conserves_energy=energy),
        "limits": ConverterLimitParameters() if limits is True else limits or None,
        "voltage_control": VoltageControlParameters() if voltage is True else voltage or None,
        "shedding": european_shedding(),
    }
    return PlantSettings(**{**given, **more})


def scenario(*events: LoadStep, wind: Any = WIND, **more: Any) -> Scenario:
    return Scenario(name="x", wind_speed=np.asarray(wind, dtype=float), events=events, **more)


def started(settings: PlantSettings, what: Scenario, law: str = LAW, duration_s: float = 60.0) -> Simulator:
    simulator = Simulator(settings, duration_s=duration_s)
    simulator.start(0, what, (get_law(law, settings.turbine),) * len(settings.groups))
    return simulator


def recorded(
    simulator: Simulator, seconds: float, *names: str, act: Callable[[int], Any] | None = None
) -> dict[str, Floats]:
    """Numbers of the groups at the end of every control interval, until the run ends, and the frequency "coi"."""
    found: dict[str, list[Any]] = {name: [] for name in ("coi", *names)}
    for interval in range(round(seconds / simulator.settings.control_dt)):
        if act is not None:
            simulator.blocks[0, simulator.layout.wtg("k_offset")] = act(interval)
        simulator.advance()
        found["coi"].append(simulator.lane_values("coi")[0])
        for name in names:
            found[name].append(simulator.wtg_values(name)[0])
        if simulator.lane_values("active")[0] < 0.5:
            break
    return {name: np.array(values) for name, values in found.items()}


def largest_rate(simulator: Simulator) -> float:
    names = simulator.layout.state_names
    keep = [i for i, name in enumerate(names) if "energy" not in name and name != "reference_angle"]
    return float(np.abs(simulator.rates()[keep]).max())


def distance(simulator: Simulator, state: Floats) -> float:
    """Largest deviation from a state, without energies and angles."""
    names = simulator.layout.state_names
    keep = [i for i, name in enumerate(names) if "energy" not in name and "angle" not in name]
    return float(np.abs(simulator.state() - state)[keep].max())


def fault(time_s: float = 1.0, duration_s: float = 0.15, bus: int = 2) -> tuple[LoadStep, LoadStep]:
    """A short circuit nearby: its reactance takes 2000 Mvar at nominal voltage."""
    return (
        LoadStep(time_s=time_s, bus=bus, power_mw=0.0, reactive_mvar=2000.0),
        LoadStep(time_s=time_s + duration_s, bus=bus, power_mw=0.0, reactive_mvar=-2000.0),
    )


def pulse(bus: int, power_mw: float = 0.0, reactive_mvar: float = 0.0, until_s: float = 21.0) -> tuple[LoadStep, ...]:
    """A load that is switched on at 1 s and off again."""
    return (
        LoadStep(time_s=1.0, bus=bus, power_mw=power_mw, reactive_mvar=reactive_mvar),
        LoadStep(time_s=until_s, bus=bus, power_mw=-power_mw, reactive_mvar=-reactive_mvar),
    )


# --- Equilibria


@pytest.mark.parametrize("table", [False, True])
def test_no_state_moves_at_the_start_with_any_options(table: bool) -> None:
    for limits, voltage, energy in OPTIONS:
        settings = plant(table=table, limits=limits, voltage=voltage, energy=energy, dead_band=2e-4)
        simulator = Simulator(settings)
        laws = (get_law(LAW, settings.turbine),) * 2
        for winds in ((6.0, 13.0), (8.0, 8.0), (11.4, 8.0), (12.0, 5.0), (16.0, 16.0), (24.0, 9.0)):
            for level in (0.7, 1.0, 1.2):
                simulator.start(0, scenario(wind=np.array([winds]).T, load_level=level), laws)
                assert largest_rate(simulator) <= 1e-8, (limits, voltage, energy, winds, level)


@pytest.mark.parametrize(("level", "sign"), [(1.2, 1.0), (0.5, -1.0)])
def test_a_bus_lets_go_of_its_voltage_where_the_groups_reactive_power_does_not_suffice(
    level: float, sign: float
) -> None:
    found = {}
    for limit in (1.0, 0.04, 0.0):
        control = VoltageControlParameters(reactive_max_pu=limit, internal_voltage_max_pu=1.6)
        simulator = started(plant(limits=False, voltage=control), scenario(load_level=level))
        assert largest_rate(simulator) <= 1e-8
        found[limit] = (
            sign * simulator.wtg_values("reactive")[0],
            sign * (np.abs(simulator.bus_voltages()[1]) - 1.045),
        )
    (ample, held), *scarce = found.values()
    assert (ample > 0.04).all() and (ample < 1.0).all() and held == pytest.approx(0.0, abs=1e-12)
    for limit, (reactive, deviation) in zip((0.04, 0.0), scarce, strict=True):
        assert reactive == pytest.approx(limit, abs=1e-11)
        assert deviation < -1e-4


# --- Balances


def network_balance(simulator: Simulator) -> tuple[float, float]:
    """Power of the units, and what loads and branches take, from the bus voltages [p.u.]."""
    settings, blocks, rows = simulator.settings, simulator.blocks[0], simulator.layout.rows
    last, following = simulator.lane_values("last_change")[0], simulator.lane_values("next_change")[0]
    acted = -1.0 - blocks[rows.shedding : rows.shedding + simulator.layout.n_stages]
    share = np.array([stage.share for stage in settings.shedding])
    served = 1.0 - share[(acted >= 0.0) & (acted <= last)].sum()
    load = served * simulator.data.load_y[0]
    opened = set()
    for event in simulator.data.events[0]:
        if last >= event["start"]:
            span = event["end"] - event["start"]
            level = 1.0 if last >= event["end"] else (0.5 * (last + following) - event["start"]) / span
            if event["branch"] >= 0:
                opened.add(int(event["branch"]))
            else:
                load[event["bus"]] += served * level * event["admittance"]
    interval = round(simulator.lane_values("step")[0] / simulator.plant.n_substeps) - 1
    load[simulator.data.noise_bus[0]] += simulator.data.noise[0, interval] * simulator.lane_values("noise_per_mw")[0]
    voltage = simulator.bus_voltages()
    taken = (np.abs(voltage) ** 2 * np.conj(load + simulator.plant.buses["shunt"])).sum()
    for index, branch in enumerate(simulator.plant.branches):
        if index not in opened:
            start, end = voltage[branch["start"]], voltage[branch["end"]]
            taken += start * np.conj(branch["y_ff"] * start + branch["y_ft"] * end)
            taken += end * np.conj(branch["y_tf"] * start + branch["y_tt"] * end)
    given = simulator.machine_values("power")[0].sum() + simulator.wtg_values("power")[0] @ simulator.plant.share
    return float(given), float(taken.real)


def rough(seed: int) -> Scenario:
    """A scenario of a suite with a large load step more, and every third time a fault."""
    rng = np.random.default_rng(seed)
    drawn = get_suite(("standard", "weak-grid", "gust", "low-wind")[seed % 4]).scenario(20_000 + seed)
    step = LoadStep(
        time_s=5.0 + round(float(rng.uniform(0.0, 10.0)), 1),
        bus=int(rng.integers(2, 15)),
        power_mw=float(rng.uniform(-150.0, 250.0)),
        reactive_mvar=float(rng.uniform(-50.0, 50.0)),
    )
    return dataclasses.replace(drawn, events=(*drawn.events, step, *(fault(20.0, bus=4) if seed % 3 == 0 else ())))


@pytest.mark.parametrize(("table", "energy"), [(False, False), (False, True), (True, False), (True, True)])
def test_rotor_converter_and_network_keep_their_balances_in_rough_runs(table: bool, energy: bool) -> None:
    settings = plant(table=table, energy=energy, dead_band=2e-4)
    inertia = settings.turbine.inertia_constant_s
    chopped = 0.0
    for seed in range(8):
        simulator = started(settings, rough(seed))
        before = simulator.wtg_values("rotor_speed")[0]
        for _ in range(300):
            simulator.advance()
            if simulator.lane_values("active")[0] < 0.5:
                break
            given, taken = network_balance(simulator)
            assert given == pytest.approx(taken, abs=1e-11)
            assert simulator.wtg_values("current").max() <= CURRENT_MAX * (1.0 + 1e-9)
        after = simulator.wtg_values("rotor_speed")[0]
        drawn = simulator.wtg_values("energy_delivered")[0] + simulator.wtg_values("energy_chopped")[0]
        kept = simulator.wtg_values("energy_captured")[0] - drawn
        chopped = max(chopped, simulator.wtg_values("energy_chopped").max())
        # A Runge-Kutta method keeps sums of rates exactly, so the paper's momentum; the energy H ω² is set from them.
        if energy:
            assert kept == pytest.approx(inertia * (after**2 - before**2), abs=1e-12)
        else:
            assert kept == pytest.approx(2.0 * inertia * (after - before), abs=1e-12)
    assert chopped > 0.001


@pytest.mark.parametrize("table", [False, True])
def test_the_rotor_keeps_its_energy_to_rounding_in_a_hundred_rough_runs(table: bool) -> None:
    settings = plant(table=table, dead_band=2e-4)
    inertia = settings.turbine.inertia_constant_s
    moved = 0.0
    for seed in range(100):
        simulator = started(settings, rough(seed))
        before = simulator.wtg_values("rotor_speed")[0]
        recorded(simulator, 30.0)
        gained = inertia * (simulator.wtg_values("rotor_speed")[0] ** 2 - before**2)
        drawn = simulator.wtg_values("energy_delivered")[0] + simulator.wtg_values("energy_chopped")[0]
        assert simulator.wtg_values("energy_captured")[0] - drawn == pytest.approx(gained, abs=1e-11), seed
        moved = max(moved, np.abs(gained).max())
    assert moved > 1.0


def test_keeping_the_energy_leaves_the_method_its_order() -> None:
    wind = 8.0 + 3.0 * np.sin(np.arange(301) * 0.2 * 0.5)
    gusty = scenario(wind=np.stack([wind, wind]), wind_dt_s=0.2)
    found = []
    for dt in (0.04, 0.02, 0.01, 0.0025):
        settings = plant(limits=False, voltage=False, simulation_dt=dt, control_dt=0.2, shedding=NO_SHEDDING)
        simulator = started(settings, gusty, law="coordinated-linear")
        recorded(simulator, 40.0)
        found.append(simulator.wtg_values("rotor_speed")[0])
    errors = [np.abs(rotor - found[-1]).max() for rotor in found[:-1]]
    assert errors[0] > 1e-11
    assert errors[1] < errors[0] / 8.0
    assert errors[2] < max(errors[1] / 8.0, 3e-13)


def test_the_chopper_burns_what_the_grid_presses_in() -> None:
    simulator = started(plant(control_dt=0.025, shedding=NO_SHEDDING), scenario(*pulse(2, 250.0)))
    found = recorded(simulator, 30.0, "power", "energy_chopped")
    pressed = np.maximum(-found["power"], 0.0)
    burnt = found["energy_chopped"][-1]
    assert burnt.max() > 0.02
    assert burnt == pytest.approx(0.025 * pressed.sum(axis=0), rel=0.02, abs=1e-12)


# --- Limits


def test_the_current_stays_within_its_limit_whatever_agents_do() -> None:
    limited = 0
    for seed, (size, hold) in enumerate(((0.3, 1), (0.3, 5), (0.5, 2), (1.0, 1), (1.0, 5))):
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(600, 2))
        simulator = started(plant(control_dt=0.1), scenario(wind=[[11.4], [11.0]]))
        found = recorded(
            simulator,
            30.0,
            "current",
            "limiting_reactance",
            act=lambda i, s=signs, a=size, h=hold: a * s[i // h],  # type: ignore[misc]
        )
        assert found["current"].max() <= CURRENT_MAX * (1.0 + 1e-9)
        limited += int((found["limiting_reactance"] > 0.0).sum())
        # Within the limit nothing is limited, and the current is at the limit where it is.
        assert found["current"][found["limiting_reactance"] > 0.0] == pytest.approx(CURRENT_MAX, rel=1e-9)
    assert limited > 50


@pytest.mark.parametrize("table", [False, True])
@pytest.mark.parametrize("disturbance", ["fault", "load"])
def test_limits_are_held_and_left_without_wind_up(table: bool, disturbance: str) -> None:
    # The hydro governor is slow: under more load the groups lose synchronism.
    load = pulse(2, 160.0, until_s=5.0) if table else pulse(2, 250.0, until_s=11.0)
    events = fault() if disturbance == "fault" else load
    settings = plant(table=table, control_dt=0.025, shedding=NO_SHEDDING)
    simulator = started(settings, scenario(*events, duration_s=180.0), duration_s=180.0)
    start = simulator.state()
    names = ("current", "limiting_reactance", "over_power", "under_power", "internal_voltage", "power")
    found = recorded(simulator, 180.0, *names)
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert (found["limiting_reactance"] > 0.0).any()
    assert found["current"].max() <= CURRENT_MAX * (1.0 + 1e-9)
    control = settings.voltage_control
    assert control is not None
    assert found["internal_voltage"].max() <= control.internal_voltage_max_pu
    assert found["internal_voltage"].min() >= control.internal_voltage_min_pu
    for name in ("over_power", "under_power"):
        assert np.abs(found[name]).max() < 0.03
        assert (found[name][-1] == 0.0).all()
    # Left at once: no sample later than 0.1 s after the disturbance is limited.
    last = 0.025 * (np.flatnonzero(found["limiting_reactance"].max(axis=1) > 0.0).max() + 1)
    assert last < events[-1].time_s + 0.1
    assert distance(simulator, start) < 5e-5


def test_the_power_is_held_again_within_two_seconds_of_a_load_step() -> None:
    for power_mw in (100.0, 150.0, 200.0):
        simulator = started(plant(control_dt=0.025), scenario(LoadStep(time_s=1.0, bus=2, power_mw=power_mw)))
        found = recorded(simulator, 30.0, "power", "over_power")
        above = 0.025 * (np.flatnonzero(found["power"].max(axis=1) > 1.1) + 1)
        assert found["power"].max() > 1.13
        assert 1.0 <= above.min() <= 1.1 and above.max() < 3.0
        assert found["over_power"].min() < 0.0 and (found["over_power"][-1] == 0.0).all()


def test_the_reactive_limit_takes_over_and_gives_back() -> None:
    simulator = started(plant(control_dt=0.025), scenario(*pulse(4, reactive_mvar=60.0, until_s=16.0)))
    before = simulator.wtg_values("reactive")[0]
    found = recorded(simulator, 60.0, "reactive", "terminal_voltage")["reactive"]
    assert before == pytest.approx([0.33, 0.33], abs=1e-9)
    assert found.max() > 0.36
    held = found[40 + 20 : 600]
    assert held.max() < 0.3305
    assert found[-1] == pytest.approx(before, abs=1e-5)


def test_the_voltage_behind_the_reactance_keeps_within_its_limits_and_leaves_them_at_once() -> None:
    control = VoltageControlParameters(reactive_max_pu=2.0, internal_voltage_max_pu=1.33)
    simulator = started(plant(control_dt=0.025, voltage=control), scenario(*pulse(2, reactive_mvar=60.0, until_s=16.0)))
    found = recorded(simulator, 30.0, "internal_voltage")["internal_voltage"][:, 0]
    assert found.max() == 1.33
    assert (found[200:639] == 1.33).all()
    assert found[641] < 1.33 - 1e-3


@pytest.mark.parametrize("table", [False, True])
def test_within_the_dead_band_the_governor_does_not_move(table: bool) -> None:
    gate = "hydro_gate" if table else "gate"
    moved, deviation = {}, {}
    for dead_band in (0.0, 1e-3):
        step = LoadStep(time_s=1.0, bus=3, power_mw=2.0)
        simulator = started(plant(table=table, dead_band=dead_band), scenario(step))
        before = simulator.machine_values(gate)[0, 0]
        recorded(simulator, 20.0)
        moved[dead_band] = abs(simulator.machine_values(gate)[0, 0] - before)
        deviation[dead_band] = 1.0 - simulator.lane_values("coi_min")[0]
    assert moved[0.0] > 1e-4
    assert 1e-5 < deviation[1e-3] < 1e-3
    assert moved[1e-3] < 1e-12


def test_shedding_stages_act_in_their_order_at_their_time_with_their_share() -> None:
    stages = european_shedding()
    step = LoadStep(time_s=1.0, bus=3, power_mw=150.0)
    simulator = started(plant(control_dt=0.025), scenario(step, governor_droop=0.2))
    rows = simulator.layout.rows
    below, acted = {}, {}
    for instant in range(1, 1200):
        simulator.advance()
        coi = simulator.lane_values("coi")[0]
        for k, stage in enumerate(stages):
            if coi >= stage.frequency_pu:
                below.pop(k, None)
            below.setdefault(k, instant) if coi < stage.frequency_pu else None
            if simulator.blocks[0, rows.shedding + k] < 0.0:
                acted.setdefault(k, (instant, instant - below.get(k, instant)))
        given, taken = network_balance(simulator)
        assert given == pytest.approx(taken, abs=1e-11)
    assert list(acted) == [0, 1, 2]
    assert [instant for instant, _ in acted.values()] == sorted(instant for instant, _ in acted.values())
    # Eight steps of 25 ms after the last one without a low frequency.
    assert [steps for _, steps in acted.values()] == [7, 7, 7]
    assert simulator.lane_values("coi_min")[0] < stages[2].frequency_pu
    assert simulator.lane_values("coi")[0] > stages[1].frequency_pu


def test_a_short_dip_sheds_nothing() -> None:
    slow = tuple(dataclasses.replace(stage, delay_s=5.0) for stage in european_shedding())
    step = LoadStep(time_s=1.0, bus=3, power_mw=150.0)
    brief = dataclasses.replace(step, time_s=5.0, power_mw=-150.0)
    simulator = started(plant(shedding=slow), scenario(step, brief, governor_droop=0.2))
    recorded(simulator, 20.0)
    assert simulator.lane_values("coi_min")[0] < slow[0].frequency_pu
    first = simulator.layout.rows.shedding
    assert (simulator.blocks[0, first : first + 6] >= 0.0).all()


@pytest.mark.parametrize("trips", [False, True])
def test_a_rotor_that_is_too_slow_ends_the_run_or_trips_its_group(trips: bool) -> None:
    slowest = ProtectionParameters(rotor_speed_min_pu=0.65)
    step = LoadStep(time_s=1.0, bus=2, power_mw=75.0)
    simulator = started(plant(protection=slowest, trips_groups=trips), scenario(step, wind=[[8.0], [8.0]]), law="mppt")
    found = recorded(simulator, 60.0, "rotor_speed", "current")
    if not trips:
        assert simulator.lane_values("status")[0] == Status.UNDER_SPEED
        assert found["rotor_speed"][-2].min() >= 0.65 > found["rotor_speed"][-1].min()
    else:
        connected = simulator.wtg_values("connected")[0]
        assert connected.min() == 0.0
        assert (simulator.wtg_values("rotor_speed")[0][connected == 0.0] < 0.65).all()
        for name in ("power", "current", "reactive", "limiting_reactance"):
            assert (simulator.wtg_values(name)[0][connected == 0.0] == 0.0).all()


# --- Another simulator


def against_golden_trace(
    name: str, events: Sequence[LoadStep], **more: Any
) -> tuple[Simulator, dict[str, float], Trace]:
    """Run the network of a golden case with WTG groups at bus 2 whose rotors hold their speed: P_st is constant.

    Returns:
        the simulator, the largest difference to the trace by quantity, and the trace.
    """
    case = read_parameters(GOLDEN / name / "params.json")
    trace, _ = read_trace(GOLDEN / name / "a.csv", case)
    units = dict(zip(case.machine_keys, case.network.machines, strict=True))
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
        control_dt=1.0 / 16.0,
        simulation_dt=1.0 / 320.0,
        **more,
    )
    law = mppt(settings.turbine)
    power = case.power["2a"].real * case.network.base_mva / units["2a"].rating_mva
    wind = (power / tracking_point(0.0, settings.turbine).power_coefficient) ** (1.0 / 3.0)
    wind /= settings.turbine.wind_power_pu_per_cubic_wind ** (1.0 / 3.0)
    run = scenario(*events, wind=[[wind], [wind]], duration_s=60.0, load_noise_bus=1)
    simulator = Simulator(settings, duration_s=60.0)
    simulator.plant.constants["turbine"]["rotor.inv_two_h"] = 0.0
    simulator.start(0, run, (law, law))
    largest = {"w": 0.0, "Pe": 0.0, "V": 0.0}
    row = 0
    for interval in range(961):
        while row < trace.time_s.size and trace.time_s[row] == interval / 16.0:
            simulator.evaluate()
            found = {f"V{n}": abs(v) for n, v in zip(case.network.bus_numbers, simulator.bus_voltages(), strict=True)}
            speeds, powers = simulator.machine_values("speed")[0], simulator.machine_values("power")[0]
            found |= {f"w{key}": value for key, value in zip(keys, speeds, strict=True)}
            found |= {f"Pe{key}": value for key, value in zip(keys, powers, strict=True)}
            for key, speed, given in zip(
                ("2a", "2b"), simulator.wtg_values("speed")[0], simulator.wtg_values("power")[0], strict=True
            ):
                found |= {f"w{key}": speed, f"Pe{key}": given * simulator.plant.share[0]}
            for name, value in found.items():
                quantity = name.rstrip("0123456789ab")
                largest[quantity] = max(largest[quantity], abs(value - trace.columns[name][row]))
            row += 1
        if interval < 960:
            simulator.advance()
    assert row == trace.time_s.size
    return simulator, largest, trace


def step_up(power_mw: float) -> tuple[LoadStep, ...]:
    return LoadStep(time_s=5.0, bus=2, power_mw=power_mw), LoadStep(time_s=30.0, bus=3, power_mw=75.0)


def test_a_group_whose_rotor_holds_its_speed_is_the_grid_forming_converter_of_another_simulator() -> None:
    _, largest, _ = against_golden_trace("grid-forming", step_up(75.0))
    assert largest["w"] <= 3e-7 and largest["Pe"] <= 2e-5 and largest["V"] <= 1e-6, largest


def test_shedding_acts_when_another_simulators_speeds_say_so_and_does_what_it_does_there() -> None:
    levels = (49.85, 49.8, 49.75)
    # So that the stages act at instants of the trace.
    delays, shares, instants = (0.29375, 0.325, 0.390625), (0.05, 0.08, 0.08), (5.5, 5.625, 5.8125)
    stages = tuple(
        SheddingStage(frequency_pu=level / 50.0, share=share, delay_s=delay)
        for level, share, delay in zip(levels, shares, delays, strict=True)
    )
    simulator, largest, trace = against_golden_trace("shedding", step_up(150.0), shedding=(*stages, *NO_SHEDDING[3:]))
    first = simulator.layout.rows.shedding
    acted = -1.0 - simulator.blocks[0, first : first + 3]
    assert (acted / 320.0).tolist() == pytest.approx(instants, abs=1e-12)
    assert largest["w"] <= 3e-7 and largest["Pe"] <= 2e-5 and largest["V"] <= 1e-6, largest
    # The instants from the other simulator's own speeds: one delay earlier they meet the level, by a polynomial through
    # its rows before the first of them.
    case = read_parameters(GOLDEN / "shedding" / "params.json")
    weights = np.array([m.two_h_s * m.rating_mva for m in case.network.machines])
    rows = (trace.time_s > 5.0) & (trace.time_s < instants[0])
    speeds = weights @ np.array([trace.columns[f"w{key}"][rows] for key in case.machine_keys]) / weights.sum()
    coi = BarycentricInterpolator(np.r_[5.0, trace.time_s[rows]], np.r_[1.0, speeds])
    for level, delay, instant in zip(levels, delays, instants, strict=True):
        assert coi(instant - delay) >= level / 50.0 > coi(instant - delay + 1.0 / 320.0)


# --- The algebraic equations of the current limit


def limited_currents(admittance: Any, voltage: Any, largest: Floats) -> tuple[Floats, Any]:
    """Limiting reactances and currents of all units, by Newton's method on the set of groups that are limited."""
    n, m = len(voltage), len(largest)
    groups = np.arange(n - m, n)

    def currents(reactance: Floats) -> Any:
        behind = np.zeros(n, dtype=complex)
        behind[groups] = 1j * reactance
        return np.linalg.solve(np.eye(n) + admittance * behind, admittance @ voltage)

    limited: set[int] = set()
    reactance = np.zeros(m)
    for _ in range(20):
        chosen = sorted(limited)
        solved = np.zeros(m)
        if chosen:

            def excess(x: Floats, chosen: list[int] = chosen) -> Floats:
                tried = np.zeros(m)
                tried[chosen] = x
                return np.asarray((np.abs(currents(tried)[groups[chosen]]) / largest[chosen]) ** 2 - 1.0)

            first = np.where(reactance[chosen] > 0.0, reactance[chosen], 0.05)
            solved[chosen] = root(excess, first, options={"xtol": 1e-15}).x
        reactance = solved
        size = np.abs(currents(reactance)[groups]) / largest
        too_many = {k for k in limited if reactance[k] < 0.0}
        missing = {k for k in range(m) if k not in limited and size[k] > 1.0 + 1e-12}
        if not too_many and not missing:
            return reactance, currents(reactance)
        limited = (limited - too_many) | missing
    raise AssertionError("no solution")


GRIDS = {
    "two groups at bus 2": default_groups(2),
    "five groups at bus 2": default_groups(5),
    "five groups at five buses": tuple(WtgGroup(bus=bus, n_turbines=4.0) for bus in (2, 4, 9, 13, 14)),
    "two groups at a weak bus": default_groups(2, 14),
    "five large groups at a weak bus": tuple(WtgGroup(bus=14, n_turbines=16.0) for _ in range(5)),
}


@pytest.mark.parametrize("groups", GRIDS.values(), ids=GRIDS)
def test_limited_currents_solve_their_equations(groups: tuple[WtgGroup, ...]) -> None:
    settings = PlantSettings(groups=groups, limits=ConverterLimitParameters())
    built = build_plant(settings)
    c, layout, rng = built.constants[0], Layout.of(built), np.random.default_rng(0)
    unit_y, at, m = np.diag(c["unit_y"]), c["unit_bus"], len(groups)
    n, first, largest = len(at), layout.rows, CURRENT_MAX * c["share"]
    n_limited = []
    for _ in range(40):
        bus_y = (built.buses["shunt"] + np.conj(built.buses["load"])).astype(complex)
        bus_y[rng.integers(14)] += rng.uniform(0.0, 5.0) - 1j * rng.uniform(0.0, 20.0)
        np.add.at(bus_y, at, c["unit_y"])
        full = assemble_admittance(built.branches, np.zeros(len(built.branches), dtype=bool), bus_y)
        admittance = unit_y - unit_y @ np.linalg.inv(full)[np.ix_(at, at)] @ unit_y
        angles = np.concatenate([rng.uniform(-0.5, 0.5, n - m), rng.uniform(0.0, 2.8) * rng.uniform(-1.0, 1.0, m)])
        voltage = rng.uniform(0.8, 1.3, n) * np.exp(1j * angles)
        block = np.zeros(layout.n_rows)
        block[first.voltage : first.voltage + 2 * n] = voltage.view(float)
        block[first.admittance : first.admittance + 2 * n * n] = np.ascontiguousarray(admittance).view(float).ravel()
        unit_currents(block, c, (0,))
        found = block[first.current : first.current + 2 * n].view(complex)
        reactance, expected = limited_currents(admittance, voltage, largest)
        assert np.abs(found - expected)[n - m :] / largest == pytest.approx(np.zeros(m), abs=1e-10)
        assert found == pytest.approx(expected, abs=1e-9)
        assert block[layout.wtg("limiting_reactance")] == pytest.approx(reactance, rel=1e-8, abs=1e-9)
        n_limited.append(int((reactance > 0.0).sum()))
    assert max(n_limited) == m and min(n_limited) == 0


def test_a_lane_beside_limited_ones_gets_the_bits_that_it_gets_alone() -> None:
    settings = plant()
    runs = [scenario(), scenario(*fault()), rough(0), scenario(LoadStep(time_s=1.0, bus=2, power_mw=120.0)), rough(3)]
    laws = (get_law(LAW),) * 2
    batch = Simulator(settings, n_lanes=len(runs))
    for lane, what in enumerate(runs):
        batch.start(lane, what, laws)
    limited = np.zeros(len(runs), dtype=bool)
    for _ in range(250):
        batch.advance()
        limited |= (batch.wtg_values("limiting_reactance") > 0.0).any(axis=1)
    assert limited.any() and not limited.all()
    for lane, what in enumerate(runs):
        alone = started(settings, what)
        recorded(alone, 25.0)
        assert (alone.state() == batch.state(lane)).all()


# --- Integration


def reference_run(settings: PlantSettings, what: Scenario, seconds: float, method: str) -> tuple[Floats, Floats]:
    """States and currents every 0.1 s by scipy, which starts anew wherever the network changes."""
    simulator = started(settings, what)
    dt, block, layout = settings.simulation_dt, simulator.blocks[0], simulator.layout
    state, step, last = simulator.state(), 0, round(seconds / settings.simulation_dt)
    states, currents = [], []

    def rates(_t: float, x: Floats) -> Floats:
        simulator.set_state(x)
        simulator.evaluate()
        return simulator.rates()

    while step < last:
        following = int(min(block[layout.lane("next_change")], last))
        if following > step:
            times = dt * np.arange(step + 4, following + 1, 4)
            done = solve_ivp(
                rates, (step * dt, following * dt), state, method=method, t_eval=times, rtol=1e-9, atol=1e-11
            )
            state, step = done.y[:, -1], following
            for values in done.y.T:
                rates(0.0, values)
                states.append(values)
                currents.append(simulator.wtg_values("current")[0])
        block[layout.lane("step")] = step
        refresh_network(block, 0, 0, simulator.plant, simulator.data, 1)
        combine_load_noise(block, simulator.plant.constants[0], np.zeros(1), simulator.lanes)
    return np.array(states), np.array(currents)


def deviations(settings: PlantSettings, what: Scenario, expected: tuple[Floats, Floats]) -> tuple[float, float, float]:
    """Largest deviation of speeds [p.u.], angles [rad] and currents [p.u.] over a run."""
    simulator = started(settings, what)
    speed, angle, current = 0.0, 0.0, 0.0
    names = simulator.layout.state_names
    speeds = [i for i, name in enumerate(names) if name.endswith(".speed")]
    angles = [i for i, name in enumerate(names) if name.endswith(".angle")]
    for state, currents in zip(*expected, strict=True):
        simulator.advance()
        off = np.abs(simulator.state() - state)
        speed, angle = max(speed, off[speeds].max()), max(angle, off[angles].max())
        current = max(current, float(np.abs(simulator.wtg_values("current")[0] - currents).max()))
    return float(speed), float(angle), current


@pytest.mark.parametrize("method", ["DOP853", "Radau"])
@pytest.mark.parametrize("events", [fault(duration_s=0.2), pulse(2, 250.0, until_s=11.0)], ids=["fault", "load"])
def test_the_default_step_follows_tight_integration_while_limits_bind(
    events: tuple[LoadStep, ...], method: str
) -> None:
    what = scenario(*events)
    expected = reference_run(plant(shedding=NO_SHEDDING), what, 20.0, method)
    assert (expected[1] > CURRENT_MAX * (1.0 - 1e-9)).any()
    speed, angle, current = deviations(plant(shedding=NO_SHEDDING), what, expected)
    assert speed < 5e-6
    assert angle < 5e-4
    assert current < 1e-3


def test_a_step_in_which_a_limit_switches_is_of_low_order() -> None:
    # The kink lies within a step: the error there falls with the step, not with its fourth power.
    what = scenario(*pulse(2, 250.0, until_s=11.0))
    expected = reference_run(plant(shedding=NO_SHEDDING), what, 20.0, "DOP853")
    errors = [
        deviations(plant(shedding=NO_SHEDDING, simulation_dt=dt), what, expected)[0] for dt in (0.025, 0.005, 0.0025)
    ]
    assert errors[0] < 5e-6
    assert errors[0] / 5.0**4 < errors[1] < errors[0]
    assert errors[2] < errors[0] / 5.0


# --- Small deviations


@pytest.mark.parametrize("table", [False, True])
def test_extended_plants_are_stable_at_their_equilibria(table: bool) -> None:
    for limits, voltage, energy in OPTIONS:
        settings = plant(table=table, limits=limits, voltage=voltage, energy=energy)
        for wind in (8.0, 11.0, 16.0):
            simulator = started(settings, scenario(wind=[[wind], [8.0]]))
            rows, layout = simulator.blocks[0], simulator.layout
            for side in (-1.0, 1.0):
                matrix = state_matrix(rows, simulator.plant, layout, side)
                keep = moving_states(matrix, rows, layout)
                assert np.linalg.eigvals(matrix[np.ix_(keep, keep)]).real.max() < -0.03


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"voltage": VoltageControlParameters(integral_gain=1000.0)},
            r"eigenvalue -98\d.* 1/s \(mainly wtg[01].internal_voltage\) .* at most 0.0025\d s",
        ),
        ({"voltage": VoltageControlParameters(takeover_gain=100.0)}, r"mainly wtg[01].internal_voltage\)"),
        # It switches at 0.5 p.u. a step once the power exceeds its limit.
        ({"limits": ConverterLimitParameters(power_gain=1.0)}, r"mainly wtg[01].angle\)"),
    ],
)
def test_controls_that_are_too_fast_for_the_step_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=r"simulation_dt = 0.025 s is too long for this plant.*" + message):
        Simulator(plant(**options))


# --- Bad input


def stages(*shares: float) -> tuple[SheddingStage, ...]:
    return tuple(SheddingStage(frequency_pu=0.98, share=share) for share in shares)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"limits": {"power_max_pu": 1.3}}, r"power_max_pu = 1.3 p.u. exceeds current_max_pu = 1.2"),
        ({"limits": {"current_max_pu": 0.0}}, r"current_max_pu = 0 p.u. is outside"),
        ({"limits": {"power_min_pu": 0.1}}, r"power_min_pu = 0.1 p.u. is outside"),
        ({"limits": {"power_gain": float("nan")}}, r"power_gain = nan p.u./p.u. is outside"),
        ({"limits": {"power_integral_gain": -1.0}}, r"power_integral_gain = -1 .* is outside"),
        ({"voltage_control": {"integral_gain": 0.0}}, r"integral_gain = 0 .* is outside"),
        ({"voltage_control": {"reactive_max_pu": -0.1}}, r"reactive_max_pu = -0.1 p.u. is outside"),
        ({"voltage_control": {"internal_voltage_min_pu": 1.1}}, r"internal_voltage_min_pu = 1.1 p.u. is outside"),
        ({"voltage_control": {"internal_voltage_max_pu": 0.9}}, r"internal_voltage_max_pu = 0.9 p.u. is outside"),
        ({"shedding": stages(0.6, 0.5)}, r"the shedding stages disconnect 110 % of the load"),
        ({"shedding": {"share": -0.1}}, r"share .*= -0.1 is outside"),
        ({"shedding": {"frequency_pu": 1.1}}, r"frequency_pu .*= 1.1 p.u. is outside"),
        ({"shedding": {"delay_s": float("inf")}}, r"delay_s .*= inf s is outside"),
        ({"protection": {"rotor_speed_min_pu": 1.5}}, r"rotor_speed_min_pu = 1.5 p.u. is outside"),
    ],
)
def test_contradicting_settings_are_refused_in_one_line(settings: dict[str, Any], message: str) -> None:
    kinds: dict[str, Any] = {
        "limits": ConverterLimitParameters,
        "voltage_control": VoltageControlParameters,
        "protection": ProtectionParameters,
        "shedding": lambda **values: (SheddingStage(**values),),
    }
    with pytest.raises(ValueError, match=message) as refused:
        PlantSettings(
            **{name: kinds[name](**value) if isinstance(value, dict) else value for name, value in settings.items()}
        )
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"limits": ConverterLimitParameters(power_max_pu=0.5, current_max_pu=3.0)},
            r"cannot start: WTG group 0 at bus 2 .*converter's limits: power 0 … 0.5 p.u.",
        ),
        (
            {"limits": ConverterLimitParameters(power_max_pu=0.8, current_max_pu=0.8)},
            r"cannot start: WTG group 0 at bus 2 .*current at most 0.8 p.u.",
        ),
        (
            {"voltage": VoltageControlParameters(internal_voltage_max_pu=1.1)},
            r"cannot start: .*1.32 p.u. behind X_g, beyond the limits 0.5 … 1.1 p.u.",
        ),
    ],
)
def test_a_start_beyond_a_limit_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        started(plant(**options), scenario())
