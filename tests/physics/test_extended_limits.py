"""What acts in extended plants beyond a limit: converters, governors, shedding and the under-speed trip."""

import numpy as np
import pytest

from tests.physics import extended
from wtg_gym.physics import grid
from wtg_gym.physics.network import assemble_admittance
from wtg_gym.physics.parameters import ConverterLimitParameters, VoltageControlParameters, WtgGroup
from wtg_gym.physics.plant import Plant, layout_of, plant_tables, with_places
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import LoadStep
from wtg_gym.physics.step import FREE_CURRENTS, LIMITS
from wtg_gym.physics.units import PAIRS, UNITS
from wtg_gym.physics.wtg_unit import EXTENSIONS
from wtg_gym.systems.programs import in_one_table
from wtg_gym.systems.routines import Routine


@pytest.mark.parametrize(
    ("mvar", "above_pu", "stays_s"),
    [(-150.0, 1.1, 29.0), (-190.0, 1.15, 20.0), (-230.0, 1.2, 2.0), (-330.0, 1.25, 0.2)],
)
def test_a_group_stays_through_the_over_voltages_it_must_and_no_longer(mvar, above_pu, stays_s):
    # A capacitor far too large, where no machine and hardly any group controls its voltage.
    capacitor = LoadStep(time_s=1.0, bus=2, power_mw=0.0, reactive_mvar=mvar)
    case, slow = grid.get_grid("ieee14").case.classical(), VoltageControlParameters(integral_gain=0.01)
    found = extended.recorded(
        extended.started(extended.plant(control_dt=0.1, voltage=slow, case=case), extended.scenario(capacitor)),
        30.0,
        *("terminal_voltage", "connected", "largest_voltage"),
    )
    voltage, there = found["terminal_voltage"][:, 0], found["connected"][:, 0] > 0.5
    assert 0.1 * there.sum() - 1.0 == pytest.approx(stays_s)
    assert above_pu < voltage[there][10:].min() and voltage[there].max() < above_pu + 0.05
    assert found["largest_voltage"][-1, 0] == pytest.approx(voltage.max(), rel=1e-3)


@pytest.mark.parametrize("table", [False, True])
@pytest.mark.parametrize("disturbance", ["fault", "load"])
def test_limits_are_held_and_left_without_wind_up(table, disturbance):
    # The hydro governor is slow: under more load the groups lose synchronism.
    load = extended.pulse(2, 160.0, until_s=5.0) if table else extended.pulse(2, 200.0, until_s=11.0)
    events = extended.fault() if disturbance == "fault" else load
    settings = extended.plant(table=table, control_dt=0.025, shedding=extended.NO_SHEDDING)
    simulator = extended.started(settings, extended.scenario(*events, duration_s=180.0), duration_s=180.0)
    start = simulator.state()
    names = ("current", "limiting_reactance", "over_power", "under_power", "internal_voltage", "power")
    found = extended.recorded(simulator, 180.0, *names)
    assert simulator.lane_values("status")[0] == Status.RUNNING
    assert (found["limiting_reactance"] > 0.0).any()
    assert found["current"].max() <= extended.CURRENT_MAX * (1.0 + 1e-9)
    control = settings.voltage_control
    assert found["internal_voltage"].max() <= control.internal_voltage_max_pu
    assert found["internal_voltage"].min() >= control.internal_voltage_min_pu
    for name in ("over_power", "under_power"):
        assert np.abs(found[name]).max() < 0.03
        assert (found[name][-1] == 0.0).all()
    # Left at once: no sample later than 0.1 s after the disturbance is limited.
    last = 0.025 * (np.flatnonzero(found["limiting_reactance"].max(axis=1) > 0.0).max() + 1)
    assert last < events[-1].time_s + 0.1
    assert extended.distance(simulator, start) < 5e-5


def test_the_reactive_limit_takes_over_and_gives_back():
    simulator = extended.started(
        extended.plant(control_dt=0.025), extended.scenario(*extended.pulse(4, reactive_mvar=60.0, until_s=16.0))
    )
    before = simulator.wtg_values("reactive")[0]
    found = extended.recorded(simulator, 60.0, "reactive", "terminal_voltage")["reactive"]
    assert before == pytest.approx([0.33, 0.33], abs=1e-9)
    assert found.max() > 0.36
    held = found[40 + 20 : 600]
    assert held.max() < 0.3305
    assert found[-1] == pytest.approx(before, abs=1e-5)


CURRENTS = in_one_table(CURRENTS=(*FREE_CURRENTS, *LIMITS))
_FIND_CURRENTS = Routine(CURRENTS[0])


@pytest.mark.parametrize(
    "groups",
    [
        tuple(WtgGroup(bus=bus, n_turbines=5.0) for bus in (2, 4, 9, 14)),
        tuple(WtgGroup(bus=14, n_turbines=20.0) for _ in range(4)),
    ],
    ids=["four buses", "a weak bus"],
)
def test_limited_currents_solve_their_equations(groups):
    built = plant_tables(Plant(groups=groups, limits=ConverterLimitParameters()))
    layout, rng = layout_of(built), np.random.default_rng(0)
    built = with_places(built, layout, CURRENTS)
    network = built.network
    unit_y, at, m = np.diag(network.unit_y), network.unit_bus, len(groups)
    n, largest = len(at), extended.CURRENT_MAX * built.share
    n_limited = []
    for _ in range(40):
        bus_y = network.shunts + built.buses["load.re"] - 1j * built.buses["load.im"]
        bus_y[rng.integers(14)] += rng.uniform(0.0, 5.0) - 1j * rng.uniform(0.0, 20.0)
        np.add.at(bus_y, at, network.unit_y)
        full = assemble_admittance(network.branch_ends, network.branch_y, bus_y)
        admittance = unit_y - unit_y @ np.linalg.inv(full)[np.ix_(at, at)] @ unit_y
        angles = np.concatenate([rng.uniform(-0.5, 0.5, n - m), rng.uniform(0.0, 2.8) * rng.uniform(-1.0, 1.0, m)])
        voltage = rng.uniform(0.8, 1.3, n) * np.exp(1j * angles)
        scratch = np.zeros((layout.n_scratch, 1))
        for kind, part, values in ((UNITS, "voltage", voltage), (PAIRS, "admittance", admittance.ravel())):
            first = layout.first_rows(kind, part)
            scratch[first, 0], scratch[first + 1, 0] = values.real, values.imag
        _FIND_CURRENTS((np.zeros((layout.n_rows, 1)), scratch), network.tables)
        first = layout.first_rows(UNITS, "current")
        current = scratch[first, 0] + 1j * scratch[first + 1, 0]
        reactance = scratch[layout.first_rows(EXTENSIONS, "reactance"), 0]
        # I = Y (V - j X I), with X above zero where the current is at its limit, and zero where it is below.
        behind = np.append(np.zeros(n - m), reactance)
        assert current == pytest.approx(admittance @ (voltage - 1j * behind * current), abs=1e-9)
        share = np.abs(current)[n - m :] / largest
        assert (reactance >= 0.0).all() and (share <= 1.0 + 1e-10).all()
        assert share[reactance > 0.0] == pytest.approx(1.0, abs=1e-10)
        n_limited.append(int((reactance > 0.0).sum()))
    assert max(n_limited) == m and min(n_limited) == 0
