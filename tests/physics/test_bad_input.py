"""What physics, scenarios and suites refuse: one row for each rule. Ranges, sources; files of measured wind."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.physics.extended import LAW, classical, plant, scenario, started, with_machine
from tests.physics.test_grid_files import STRANGER
from wtg_gym import Plant, TrackingLaw, simulate
from wtg_gym.physics import machine_parameters
from wtg_gym.physics import parameters as p
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.grid import Branch, Bus, NetworkCase, get_grid, read_grid
from wtg_gym.physics.rotor_table import RotorTable, read_rotor_table
from wtg_gym.physics.sensors import Sensors
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import group_laws, read_law
from wtg_gym.ranges import Checked
from wtg_gym.scenarios import ScenarioDistribution, Suite, draws, get_suite, read_wind_csv
from wtg_gym.scenarios.draws import SensorDistribution

NAN = math.nan
IEEE14 = get_grid("ieee14").case
TURBINES = (p.TurbineParameters(),) * 2
PEAKLESS = p.TurbineParameters(power_coefficient=p.PowerCoefficientParameters(c6=1.0))
STAGES = tuple(p.SheddingStage(frequency_pu=0.98, share=share) for share in (0.6, 0.5))
LAWS = [
    ("k_min = 1\nk_nominal = 1\n", r"exactly one of k_max \[p.u.\] and deloading_max \[%\], got neither"),
    ("k_min = 1\nk_nominal = 1\nk_max = 9\n", "k_max .* = 9 p.u. is outside the allowed range 0.001 … 3 p.u."),
    ("k_min = 1\nk_nominal = 1\nk_max = 1\ntau_s = -1\n", "must be 0.05 … 100000 s, 0 s .* infinite .*, got -1 s"),
    ("deloading_min = 0\ndeloading_nominal = 0.05\ndeloading_max = 10\n", "is in percent: write 5 for 5 %"),
]
TABLES = [("0.020093", "hole", "the rotor table .*mine.toml: .*'hole'"), ("0.020093 ", "", "mine.toml: a rotor table")]


def of(kind, **values):
    return lambda: kind(**values)


def case(**changes):
    base = {"name": "two buses", "base_mva": 100.0, "frequency_hz": 50.0, "slack_bus": 1}
    usual = {"machines": (classical(bus=1),), "buses": (Bus(number=1, voltage_pu=1.0), Bus(number=2, load_mw=10.0))}
    usual["branches"] = (Branch(from_bus=1, to_bus=2, resistance=0.01, reactance=0.1),)
    return of(NetworkCase, **base, **{**usual, **changes})


def table(**changes):
    rows = tuple((0.1 * i, 0.08 * i, 0.05 * i, 0.02 * i) for i in range(1, 5))
    usual = {"tip_speed_ratio": (2.0, 4.0, 6.0, 8.0), "pitch_deg": (0.0, 5.0, 10.0, 15.0), "power_coefficient": rows}
    return of(RotorTable, **{**usual, **changes})


def given(**changes):
    return of(sc.Scenario, **{"name": "x", "wind_speed": np.full((2, 11), 9.0), **changes})


def event(**changes):
    """A scenario as JSON has it, with one event."""
    step = {"kind": "load_step", "time_s": 1.0, "bus": 2, "power_mw": 5.0}
    return lambda: sc.Scenario.from_dict({"name": "x", "wind_speed": [[9.0]], "events": [{**step, **changes}]})


FAULT, NO_LINE = {"time_s": 1.0, "bus": 4, "clears_after_s": 0.1}, ((1,), (1, 2, 3), 5, "24", (2.5, 4), (True, 2))
FEW, MANY = (Plant(groups=(p.WtgGroup(bus=2, n_turbines=n),) * 2) for n in (0.01, 40.0))
FIRST = "WTG group 1 of 2 at bus 2"
RECORDS = [
    (of(p.GridFormingParameters, inertia_constant_s=-5.0), r"= -5 s is outside the allowed range 0.001 … 10000 s"),
    (of(p.GridFormingParameters, frequency_min_pu=1.004), r"< frequency_setpoint_pu < .* hold, got 1.004, 1, 1.008"),
    (of(p.ConverterLimitParameters, power_max_pu=1.3), r"= 1.3 p.u. exceeds current_max_pu = 1.2 p.u."),
    *((lambda n=n: p.default_groups(n), "in 1 … 100") for n in (0, 2.0, True, "2", 101)),
    (lambda: power_coefficient(np.array([7.0, np.inf])), r"tip-speed ratio must be positive, got inf"),
    (lambda: available_power_pu(-5.0), r"wind speed must be 0 m/s or more, got -5 m/s"),
    (lambda: tracking_point(1.0), r"deloading = 1 is outside the allowed range 0 … 0.9"),
    (lambda: tracking_point(0.05, PEAKLESS), r"C_p curve has no maximum at a tip-speed ratio .* range 4 … 12"),
    (table(pitch_deg=(0.0, 5.0, 5.0, 15.0)), "pitch angles of a rotor table must be finite and rise"),
    (table(pitch_deg=(1.0, 5.0, 10.0, 15.0)), "must reach from 0 deg or below to above 0 deg"),
    (table(power_coefficient=((0.1,) * 4,) * 3 + ((0.1, 0.1, NAN, 0.1),)), "no number at a tip-speed ratio of 8"),
    (lambda: read_rotor_table(Path("nowhere.txt")), "nowhere.txt"),
    (of(Sensors, seed=2**31, wind_bias=(0.0, 0.0)), "seed must be a whole number in 0 … 2147483647, got 2147483648"),
    (of(Sensors, seed=1, wind_bias=(0.1, 0.6)), "wind_bias = 0.6.*-0.5 … 0.5"),
    (case(buses=(Bus(number=1), Bus(number=1))), "unique"),
    (case(buses=(Bus(number=1), Bus(number=2), Bus(number=3))), "not connected"),
    (case(branches=(Branch(from_bus=1, to_bus=9, resistance=0.0, reactance=0.1),)), r"unknown bus 9; .* \[1, 2\]"),
    (case(branches=(Branch(from_bus=1, to_bus=2, resistance=0.0, reactance=0.0),)), "1-2 has no impedance"),
    (lambda: IEEE14.branch_index(1, 14), "no branch 1-14 in .*; branches: 1-2, 1-5"),
    (given(wind_speed=np.array([[9.0, -1.0], [9.0, 9.0]])), "group 1 at t = 0.1 s is -1 m/s.* 3 … 25 m/s"),
    (given(load_noise_mw=np.array([1.0, 0.0])), "must start at 0 MW, got 1 MW"),
    (given(events=sc.LoadTrip(time_s=1.0, bus=3)), "events must be tuple.*, got LoadTrip"),
    (lambda: sc.Scenario.from_dict({"name": "x", "wind_speed": [[9.0]], "windd": 1}), r"unknown scenario keys"),
    (of(sc.Fault, **FAULT, reactance_pu=0.0), "reactance_pu = 0 p.u. is outside"),
    (of(sc.Fault, time_s=1.0, bus=4, clears_after_s=0.0), "clears_after_s = 0 s is outside"),
    *((of(sc.Fault, **FAULT, opens=opens), "opens must be the two buses of a line, got") for opens in NO_LINE),
    (of(sc.ReactanceStep, time_s=1.0, from_bus=1, to_bus=2, factor=0.0), "factor = 0 is outside"),
    (of(sc.PhaseJump, time_s=1.0, bus=1, angle_deg=181.0), "angle_deg = 181 deg is outside"),
    (given(committed=0.0), "committed = 0 is outside"),
    (event(kind="quake"), "needs a kind out of load_step"),
    (event(time_s=-1.0), "time_s = -1 s is outside"),
    (event(kind="machine_outage"), r"unknown machine_outage keys \['power_mw'\]; known .* keys: time_s, bus"),
    *((of(sc.GroupTrip, time_s=1.0, group=group), "group must be a whole number") for group in (-1, 1.0, True)),
    *((lambda after_s=after_s: line(1.0, 1, 2, after_s), "recloses_after_s") for after_s in (-0.5, 0.0, NAN, "soon")),
    (given(wind_speed=11.0), r"got shape \(\); for constant wind write \[\[11.0\], \[9.0\]\]"),
    (of(sc.LoadStep, power=30.0), "unknown arguments of LoadStep .'power'.; .* did you mean 'power_mw'?"),
    (lambda: Plant().replaced(droop_gain_pu=20.0), 'a setting of control: plant={"control": {"droop_gain_pu": …}}'),
    (of(TrackingLaw, tau_s=0.8), "unknown arguments of TrackingLaw .'tau_s'.; .*, damping_time_constant_s"),
    (lambda: group_laws(["mppt"] * 3, TURBINES), "one for each of the 2 groups, got 3"),
    (lambda: simulate("load-increase", "mppt"), "scenario must be a Scenario, got str"),
    (of(Plant, simulation_dt=0.03), "interval_s = 0.1 s is not a whole number of simulation steps of 0.03 s"),
    *((of(Plant, secondary_time_s=time_s), "secondary_time_s") for time_s in (0.5, -30.0, 4000.0, NAN, "30")),
    (of(Plant, groups=(p.WtgGroup(bus=99),)), r"unknown bus 99; .* has buses \[1, 2"),
    (of(Plant, control=p.GridFormingParameters(frequency_setpoint_pu=0.998)), "frequency_setpoint_pu must be 1 p.u."),
    (of(Plant, shedding=STAGES), "the shedding stages disconnect 110 % of the load"),
    *((lambda n=n: Simulator(Plant(), num_envs=n), "num_envs must be a whole number") for n in (0, 1.5, True)),
    (lambda: Simulator(Plant(), duration_s=NAN), "duration_s = nan s is outside the allowed range 0 … 86400 s"),
    (lambda: Simulator(FEW), f"{FIRST} needs an internal voltage of .* p.u. to hold 1.045 p.u. .* at most 2 p.u."),
]


def fit(*events, **more):
    """A scenario that the usual plant prepares together with a good one."""
    what = scenario(), scenario(*events, **more)
    return lambda: Simulator(Plant(), duration_s=120.0).prepare(what, group_laws(LAW, TURBINES))


def line(time_s: float, from_bus: int, to_bus: int, recloses_after_s: float | None = None) -> sc.LineTrip:
    return sc.LineTrip(time_s=time_s, from_bus=from_bus, to_bus=to_bus, recloses_after_s=recloses_after_s)


#: Lines that part the buses 1, 2, 3, 6 and 8, each of which has a unit, from one another.
PARTING = ((1, 2), (1, 5), (2, 3), (2, 4), (2, 5), (3, 4), (5, 6), (6, 11), (6, 12), (6, 13), (7, 8))
FIVE = tuple(line(1.0, *ends) for ends in PARTING)

UNFIT = [
    (fit(sc.LoadStep(time_s=1.003, bus=2, power_mw=1.0)), "event time = 1.003 s is not a whole number"),
    (fit(line(1.0, 7, 8, 0.5)), "would split the network"),
    (fit(line(1.0, 1, 2), line(1.0, 1, 5)), "would split the network"),
    (fit(*(sc.LoadTrip(time_s=t, bus=9) for t in (1.0, 2.0))), r"disconnects a load twice; .*\[9, 9\]"),
    (fit(sc.LoadTrip(time_s=1.0, bus=7)), r"no load at bus 7; buses with one: \[2, 3, 4"),
    (fit(line(1.0, 1, 2), line(2.0, 1, 2)), "opens the line 1-2 twice"),
    (fit(line(0.5, 1, 2, 0.525), line(1.0, 1, 2, 0.525)), "opens the line 1-2 twice"),
    (fit(sc.GroupTrip(time_s=1.0, group=2)), "unknown WTG group 2; the plant has 2, counted from 0"),
    (fit(*(sc.GroupTrip(time_s=t, group=1) for t in (1.0, 2.0))), "disconnects WTG group 2 of 2 at bus 2 twice"),
    (fit(sc.GovernorLoss(time_s=1.0, bus=3)), r"no machine with a governor at bus 3; buses with one: \[1\]"),
    (fit(sc.MachineOutage(time_s=1.0, bus=2)), r"no synchronous machine at bus 2; buses with one: \[1, 3, 6, 8\]"),
    (fit(*(sc.MachineOutage(time_s=t, bus=3) for t in (2.0, 1.0))), "the synchronous machine at bus 3 twice"),
    (fit(sc.Fault(time_s=1.0, bus=99, clears_after_s=0.1)), r"unknown bus 99; .* has buses \[1, 2"),
    (fit(sc.Fault(time_s=1.0, bus=4, clears_after_s=0.1, opens=(1, 9))), "no branch 1-9 in .*; branches: 1-2"),
    (fit(sc.Fault(time_s=1.0, bus=4, clears_after_s=0.101)), "clears_after_s = 0.101 s is not a whole number"),
    (fit(sc.ReactanceStep(time_s=1.0, from_bus=1, to_bus=4, factor=2.0)), "no branch 1-4 in .*; branches: 1-2"),
    (fit(sc.PhaseJump(time_s=1.0, bus=1, angle_deg=5.0)), r"no imposed source at bus 1; buses with one: \[\]"),
    (fit(sc.FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=1.0, duration_s=1.0)), "no imposed source at bus 1;"),
    (lambda: started(plant(), scenario(*FIVE)), "its line trips leave 5 islands with a unit; allowed: at most 4"),
    (fit(duration_s=300.0), "lasts 300 s, longer than the 120 s held here"),
    (fit(wind=np.full((3, 1), 9.0)), "has wind for 3 WTG groups, the plant has 2 groups"),
    (fit(wind=np.full((2, 1), 25.0), load_level=0.3), "scenario 'x' cannot start"),
]

GREEDY = TrackingLaw(name="greedy", k_min=3.0, k_nominal=3.0, k_max=3.0)
WINDY = scenario(wind=[[11.4], [11.4]], load_level=1.5)
EVEN, SLOW = scenario(wind=[[8.0], [8.0]]), scenario(wind=[[8.0], [4.5]])
LOW_VOLTAGE = p.ProtectionParameters(internal_voltage_max_pu=1.45)
FAST_ROTOR = plant(protection=p.ProtectionParameters(rotor_speed_min_pu=0.5))
WEAK = plant(limits=p.ConverterLimitParameters(power_max_pu=0.5))
LOW_GATE = with_machine(governor=machine_parameters.HydroGovernorParameters(gate_max_pu=0.1))
STARTS = [
    (lambda: started(Plant(), EVEN, GREEDY), f"{FIRST} has no equilibrium at a wind of 8 m/s with k = 3 p.u."),
    (lambda: started(MANY, scenario(), "mppt"), "would start at -.* p.u. of gate, beyond its gate limits 0 … 1.2 p.u."),
    (lambda: started(plant(table=True, case=LOW_GATE), scenario()), "p.u. of hydro gate, beyond its hydro gate limits"),
    (lambda: started(WEAK, scenario()), f"{FIRST} would start with 0.9.* p.u. of power, beyond .* 0 … 0.5 p.u."),
    (lambda: started(Plant(protection=LOW_VOLTAGE), WINDY), f"{FIRST} needs .* at most 1.45"),
    (
        lambda: simulate(SLOW, LAW, FAST_ROTOR),
        "WTG group 2 of 2 at bus 2 would start at 0.4.* p.u. in a wind of 4.5 m/s, below the under-speed trip at 0.5 p",
    ),
]

STANDARD, SHARED = get_suite("standard"), get_suite("standard-v1").distributions[0]
WIND, SPLITS = draws.Wind(), "train 1000000 … 2147483647, validation 10000 … 10099, test 20000"


def drawn(*records: draws.Record, **settings) -> ScenarioDistribution:
    return ScenarioDistribution(name="mine", records=records, **settings)


SUITES = [
    (lambda: draws.Wind(mean_m_s=(2.0, 9.0)), "mean_m_s = 2 m/s.*4 … 20 m/s"),
    (lambda: draws.LoadEvents(size_mw=(75.0, 15.0)), r"size_mw.*low <= high.*\(75, 15\) MW"),
    (lambda: draws.OperatingPoint(load_level=1.0), "load_level must be a pair"),
    (lambda: draws.Wind(gust_probability=0.7, ramp_probability=0.7), "1.4.*at most 1"),
    (lambda: draws.LoadEvents(number=(0.5, 2)), "number must be two whole numbers"),
    (lambda: draws.LoadEvents(trip_buses=(7,)), r"trip_buses must be.*\(7,\)"),
    (lambda: draws.LoadEvents(buses=[[5, 1.0]]), r"LoadEvents.buses must be tuple.* decrease .*\[MW\]\)"),
    (lambda: draws.LoadEvents(buses=[(5, 1.0, -2.0)]), "load change at bus 5 = -2 MW"),
    (lambda: draws.LoadNoise(standard_deviation_mw="loud"), "standard_deviation_mw must be a number.*'loud'"),
    (lambda: draws.Faults(probability=0.1), "Faults.lines must not be empty"),
    (lambda: draws.MachineOutages(probability=0.1), "MachineOutages.buses must not be empty"),
    (lambda: draws.Faults(probability=0.1, lines=((1, 2),), clearing_s=(0.05, 0.2)), "clearing_s = 0.05 s.*0.1 … 1 s"),
    (lambda: drawn(draws.LineTrips(lines=((7, 8),)), WIND), r"LineTrips.lines must be.*\(7, 8\)"),
    (lambda: drawn(draws.LoadNoise(), WIND), "records must be a Wind, .* LoadNoise, in this order"),
    (lambda: drawn(WIND, WIND), "at most one each of .*, got Wind, Wind"),
    (lambda: drawn(draws.LoadEvents()), "records must be a Wind"),
    (lambda: drawn(WIND, grid="ieee15"), "unknown grid 'ieee15'"),
    (lambda: drawn(WIND, draws.Faults(probability=0.0, lines=((8, 7),))), r"Faults.lines must be.*\(8, 7\)"),
    (lambda: drawn(WIND, draws.LoadNoise(bus=99)), "LoadNoise.bus: there is no bus 99"),
    (lambda: drawn(WIND, draws.MachineOutages(probability=0.1, buses=(5,))), "there is no machine at bus 5"),
    (lambda: drawn(WIND, draws.Islandings(line_sets=[[(5, 6), (9, 10)]])), r"two parts .*.* \(\(5, 6\), \(9, 10\)\)"),
    (lambda: drawn(WIND).changed({draws.Faults: {}}), "unknown records .*; known records: Wind"),
    (lambda: drawn(draws.LineTrips(), WIND, draws.Islandings(line_sets=(((7, 8),),))), "Islandings exclude LineTrips"),
    (lambda: STANDARD.distributions[0].draw(-1), "a seed must be a whole number in 0 … [0-9]*, got -1"),
    (lambda: STANDARD.distributions[0].draw(1, 0), "n_wtg must be a whole number in 1 … 100, got 0"),
    (lambda: STANDARD.distributions[0].draw(1, 2, [1.0]), r"one value per WTG group \(2\), got 1"),
    (lambda: SHARED.check_turbines([5.0, 5.0]), "10 turbines of 5 MW, give .* % of a load .* penetration of 40 … 78 %"),
    (lambda: SHARED.draw_many(range(20), 3, [90.0] * 3), "winds of 8.5 … 11 m/s hardly ever give"),
    (of(SensorDistribution, delay_s=(0.1, 0.25)), "whole numbers of 0.1 s"),
    (of(SensorDistribution, wind_bias=math.nan), "wind_bias = nan.*0 … 0.2"),
    (of(SensorDistribution, wind_sensor="no"), "wind_sensor must be bool"),
    (
        of(SensorDistribution, delay=0.1),
        "unknown arguments .*; known arguments of SensorDistribution: .*, wind_sensor; did you mean 'delay_s'",
    ),
    *((lambda seed=seed: STANDARD.scenario(seed), SPLITS) for seed in (9_999, 10_100, 2**31, 20_000.0, True)),
    (lambda: get_suite("paper").scenario(0, duration_s=-1.0), "duration_s = -1 s"),
    (lambda: dataclasses.replace(STANDARD, validation=range(20_100, 20_300)), "overlap"),
    (lambda: Suite(name="empty", description="", duration_s=60.0), "either distributions or cases"),
    (lambda: dataclasses.replace(STANDARD, drawn_from={"": STANDARD.distributions, "more": ()}), "every stratum"),
    (lambda: dataclasses.replace(STANDARD, drawn_from={"": STANDARD.distributions, "a": (SHARED,)}), "every stratum"),
]

HEADER = "time_s,wind_1_m_s,wind_2_m_s\n"
GOOD = HEADER + "".join(f"{0.5 * i:g},{8 + 0.1 * i:g},{9 - 0.1 * i:g}\n" for i in range(9))
WINDS: list[tuple[str | bytes, str]] = [
    (GOOD.replace("2,8.4,8.6\n", ""), "line 6.*1.5 to 2.5 s"),
    (GOOD.replace("\n2,", "\n1,"), "line 6.*does not increase"),
    (GOOD.replace("2,8.4,8.6", "2,,8.6"), "line 6.*wind_1_m_s.*empty.*3 … 25 m/s"),
    (GOOD.replace("8.4", "nan"), "line 6.*wind_1_m_s.*'nan'"),
    (GOOD.replace("8.6", "31"), "line 6.*wind_2_m_s.*'31'.*3 … 25 m/s"),
    (GOOD.replace("2,8.4,8.6", "2,8,4,8,6"), "line 6.*5 cells.*3"),
    (GOOD.removeprefix(HEADER), "line 1.*time_s,wind_1_m_s"),
    (HEADER + "0,8,9\n", "1 data row.*at least 2"),
    ("", "line 1.*empty"),
    (GOOD.encode().replace(b"8.4", b"8\xb74"), "line 6.*0xb7.*UTF-8"),
    (GOOD, "line 10: .*4 s.*at least 60 s"),
]
VALUES = [*RECORDS, *UNFIT, *SUITES, *((call, f"scenario 'x' cannot start: .*{said}") for call, said in STARTS)]


@pytest.mark.parametrize(("call", "message"), VALUES)
def test_bad_values_are_refused_with_value_unit_and_range_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refused:
        call()
    assert "\n" not in str(refused.value)


GRIDS = [
    ({"slack_bus": 7}, "slack bus 7"),
    ({"groups": [{"bus": 13}]}, "unknown bus 13"),
    ({"machines": [{**STRANGER["machines"][0], "two_h_s": -1.0}]}, "at bus 101: .*two_h_s"),
    ({"colour": "red"}, "unknown NetworkCase"),
    ({"branches": [{"from_bus": 12}]}, "Branch .*12.* misses to_bus"),
]


def read_wind(path: Path) -> object:
    return read_wind_csv(path, duration_s=60.0 if path.read_bytes() == GOOD.encode() else None)


FILES = [
    *((read_law, text, message) for text, message in LAWS),
    *((read_rotor_table, p.ROTOR_TABLE.read_text().replace(find, other), message) for find, other, message in TABLES),
    *((read_wind, text, rf"mine\.toml.*{message}") for text, message in WINDS),
    *((read_grid, json.dumps({**STRANGER, **change}), rf"mine\.toml.*{message}") for change, message in GRIDS),
]


@pytest.mark.parametrize(("read", "text", "message"), FILES, ids=[message[:30] for *_, message in FILES])
def test_bad_files_are_refused_with_their_name(tmp_path, read, text, message):
    path = tmp_path / "mine.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=message) as refused:
        read(path)
    assert "\n" not in str(refused.value)


MACHINE = IEEE14.machines[0]
TYPES = [kind for kind in (*vars(p).values(), *vars(machine_parameters).values()) if isinstance(kind, type)]
WITH_DEFAULTS = {kind for kind in TYPES if issubclass(kind, Checked)} - {Checked, type(MACHINE)}
CHECKED = [kind() for kind in TYPES if kind in WITH_DEFAULTS]
CHECKED += [MACHINE, MACHINE.governor, MACHINE.exciter, *IEEE14.buses[:1], *IEEE14.branches[:1]]


def test_every_parameter_has_unit_source_and_description_and_every_number_a_range():
    sources = [field.metadata["source"] for record in CHECKED for field in dataclasses.fields(record)]
    assert len(sources) > 100 and set(sources) == set(p.SOURCES)
    for record in CHECKED:
        for field in dataclasses.fields(record):
            assert field.metadata["unit"] and field.metadata["doc"], (record, field.name)
            if field.type in (float, float | None):
                low, high = field.metadata["low"], field.metadata["high"]
                assert math.isfinite(low) and math.isfinite(high) and low < high, (record, field.name)
                with pytest.raises(ValueError, match=rf"{type(record).__name__}.{field.name} = inf"):
                    dataclasses.replace(record, **{field.name: math.inf})


def test_a_law_file_whose_k_rises_with_the_frequency_warns(tmp_path, caplog):
    path = tmp_path / "x.toml"
    for k_max, warns in ((0.5, 0), (1.024, 1)):
        path.write_text(f"k_min = 0.62\nk_nominal = 0.62\nk_max = {k_max}\ntau_s = 1.0\n")
        read_law(path)
        assert caplog.text.count("k rises with the frequency (k_min = 0.62 p.u.") == warns


def test_harmless_variants_of_a_wind_file_read_the_same(tmp_path):
    path = tmp_path / "site.csv"
    others = ("\ufeff" + GOOD, GOOD.replace("\n", "\r\n"), GOOD + "\n\n", GOOD.replace(",", " , "))
    for text in (GOOD, *others, GOOD.rstrip("\n").replace("wind_1_m_s", "north row")):
        path.write_bytes(text.encode())
        wind, dt_s = read_wind_csv(path)
        assert dt_s == 0.5 and wind.shape == (2, 9)
        assert wind[0].tolist() == [8 + 0.1 * i for i in range(9)] and wind[1, 8] == 8.2
    assert read_wind_csv(path, duration_s=2.0)[0].shape == (2, 5)
    # One that starts late and has rounded times is uniform.
    path.write_text("time_s,w\n" + "".join(f"{100 + i / 30:.3f},8\n" for i in range(31)))
    wind, dt_s = read_wind_csv(path, duration_s=1.0)
    assert dt_s == pytest.approx(1 / 30, rel=1e-6) and wind.shape == (1, 31)
