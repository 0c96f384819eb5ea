"""Models of machines that only some plants have: transfer functions, and their place in a run; secondary control."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.changes import write
from tests.physics.extended import largest_rate, recorded, scenario, with_machine
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.gradients import Tape, check_by_differences
from wtg_gym.physics import machine_models as models
from wtg_gym.physics import machine_parameters as controls
from wtg_gym.physics.grid import Branch, Bus, Grid, NetworkCase, get_grid, grid_text
from wtg_gym.physics.linearisation import moving_matrix
from wtg_gym.physics.machine import saturated, saturation_constants
from wtg_gym.physics.machine_parameters import GovernorParameters, HydroGovernorParameters, SynchronousMachineParameters
from wtg_gym.physics.parameters import ConverterLimitParameters, ProtectionParameters, WtgGroup
from wtg_gym.physics.plant import Plant, plant_tables
from wtg_gym.physics.scenario import Event, GovernorLoss, LoadStep, MachineOutage
from wtg_gym.physics.simulator import Simulator

S = 2j * np.pi * np.array([0.05, 0.4, 1.5, 6.0])

STABILISER = controls.SpeedStabiliserParameters(signal_limit_pu=0.05)
FILTER = controls.FilterStabiliserParameters(
    filter_a1_s=0.1, filter_a2_s2=0.005, filter_a3_s=0.08, filter_a4_s2=0.002, filter_a5_s=0.05, filter_a6_s2=0.001
)
SATURATION = {"saturation_voltage_1_pu": 1.5, "saturation_1": 0.06, "saturation_voltage_2_pu": 3.0, "saturation_2": 0.3}
EXCITER = controls.LeadLagExciterParameters(regulator_gain=40.0, lead_time_s=0.5, lag_time_s=1.5, **SATURATION)
FRACTIONS = {"fraction_1": 0.3, "fraction_2": 0.2, "fraction_3": 0.5}
BOILER = controls.BoilerGovernorParameters(lag_time_s=0.2, lead_time_s=0.5, **FRACTIONS)
#: Where a machine cannot start.
BEYOND = [
    ({"governor": dataclasses.replace(BOILER, gate_max_pu=0.2)}, "p.u. of valve, beyond its valve limits 0 … 0.2"),
    ({"governor": controls.GasGovernorParameters(load_limit_pu=0.3)}, "p.u. of valve, beyond its valve limits"),
    ({"exciter": dataclasses.replace(EXCITER, regulator_max_pu=1.0)}, "regulator, beyond its regulator limits"),
]
INV_DROOP = 20.0
HYDRO = HydroGovernorParameters()
CONSTANTS = models.hydro_constants(0, HYDRO)
GOVERNOR = GovernorParameters(droop_pu=0.05, gate_max_pu=1.0)
#: One control interval is one step of the integration.
DT, SECONDARY_S = 0.025, 30.0
MORE = LoadStep(time_s=1.0, bus=4, power_mw=60.0)
LEFT_OUT = [
    *({}, {"washout_gain_s": 0.0}, {"lead_time_1_s": 0.0, "lag_time_1_s": 0.0}),
    *({"filter_a4_s2": 0.0, "filter_a6_s2": 0.0}, {"filter_a3_s": 0.0, "filter_a4_s2": 0.0}),
    {"filter_a2_s2": 0.0, "filter_a3_s": 0.0, "filter_a4_s2": 0.0, "filter_a6_s2": 0.0},
    *({"filter_a1_s": 0.0, "filter_a2_s2": 0.0}, {name: 0.0 for name in vars(FILTER) if name.startswith("filter_")}),
]


def machine(bus: int, **changes) -> SynchronousMachineParameters:
    """Kundur's machine with saturation, without governor and stabiliser."""
    without = {"exciter": controls.ExciterParameters(), "stabiliser": None, "governor": None}
    usual = {"rating_mva": 200.0, "two_h_s": 8.0, "damping_pu": 0.0, "saturation_1_0": 0.1, "saturation_1_2": 0.4}
    given = {**without, **usual, "bus": bus, "dispatch_mw": 0.0, **changes}
    return dataclasses.replace(get_grid("kundur").case.machines[0], **given)


#: Every model, on two machines.
FIRST = machine(1, exciter=EXCITER, stabiliser=FILTER, governor=BOILER)
SECOND = machine(2, dispatch_mw=80.0, stabiliser=STABILISER, governor=controls.GasGovernorParameters())
OTHERS = (
    dataclasses.replace(FIRST, exciter=controls.SaturatingExciterParameters(regulator_gain=40), stabiliser=STABILISER),
    dataclasses.replace(SECOND, governor=controls.ReheatGovernorParameters(), saturation_1_0=0.0, saturation_1_2=0.0),
)


def network(*machines: SynchronousMachineParameters) -> NetworkCase:
    lines = ((1, 3, 0.005, 0.05), (2, 3, 0.005, 0.06), (1, 2, 0.01, 0.1))
    branches = tuple(Branch(from_bus=a, to_bus=b, resistance=r, reactance=x) for a, b, r, x in lines)
    load = Bus(number=3, load_mw=200.0, load_mvar=60.0)
    buses = Bus(number=1, voltage_pu=1.03), Bus(number=2, voltage_pu=1.01), load
    base = {"base_mva": 100.0, "frequency_hz": 50.0, "slack_bus": 1}
    return NetworkCase(name="two machines", buses=buses, branches=branches, machines=machines, **base)


def started(machines: Sequence[SynchronousMachineParameters], *events: Event, given=None, **more) -> Simulator:
    wide = ProtectionParameters(frequency_min_pu=0.9, frequency_max_pu=1.1)
    usual = {"groups": (), "simulation_dt": 0.01, "protection": wide, "limits": ConverterLimitParameters()}
    simulator = Simulator(Plant(case=network(*machines), **{**usual, **more}), duration_s=120.0)
    what = scenario(*events, wind=np.zeros((0, 1)), duration_s=120.0, load_noise_bus=3, **(given or {}))
    simulator.start(0, what, ())
    return simulator


def advanced(simulator: Simulator, seconds: float) -> Simulator:
    recorded(simulator, seconds)
    assert simulator.env_values("status")[0] == 0.0
    return simulator


def response(rates, start, at: float) -> np.ndarray:
    """The transfer function of a block at `S`, from differences around its equilibrium at an input."""
    x, n, step = np.array(start), len(start), 1e-4

    def both(state: np.ndarray, given: float) -> np.ndarray:
        result, output = rates(type(start)(*state), given)
        return np.array([*result, output])

    a = np.array([(both(x + d, at) - both(x - d, at)) / (2.0 * step) for d in step * np.eye(n)]).T
    b = (both(x, at + step) - both(x, at - step)) / (2.0 * step)
    # States of a block that is none stand still and have no effect.
    moves = a[:n].any(axis=1) | (b[:n] != 0.0)
    a, b = a[np.ix_([*moves, True], moves)], b[[*moves, True]]
    result = [a[-1] @ np.linalg.solve(s * np.eye(moves.sum()) - a[:-1], b[:-1]) + b[-1] for s in S]
    return np.array(result)


def test_the_parabola_of_saturation_goes_through_both_points_and_begins_between():
    curve = saturation_constants("x", (1.0, 0.1), (1.2, 0.4))
    assert [saturated(e, curve) for e in (1.0, 1.2, 0.5)] == pytest.approx([0.1, 0.48, 0.0])
    assert saturation_constants("x", (1.0, 0.0), (1.2, 0.4)).threshold == pytest.approx(1.0)
    with pytest.raises(ValueError, match=r"x: saturation must rise from S\(1 p.u.\) = 0.4 to S\(1.2 p.u.\) = 0.1"):
        saturation_constants("x", (1.0, 0.4), (1.2, 0.1))


@pytest.mark.parametrize("changes", LEFT_OUT)
def test_ieeest_has_its_transfer_function_with_any_part_left_out(changes):
    p = dataclasses.replace(FILTER, **{"gain": 7.0, "lead_time_2_s": 0.3, **changes})
    c = models.IEEEST.constants(0, p)
    result = response(lambda s, u: models.ieeest_rates(s, u, 1.0, c), models.IeeestState(*(0.0,) * 7), 0.0)
    wanted = (1.0 + p.filter_a5_s * S + p.filter_a6_s2 * S**2) / (1.0 + p.filter_a1_s * S + p.filter_a2_s2 * S**2)
    wanted = wanted / (1.0 + p.filter_a3_s * S + p.filter_a4_s2 * S**2)
    wanted = wanted * (1.0 + S * p.lead_time_1_s) / (1.0 + S * p.lag_time_1_s)
    wanted = wanted * (1.0 + S * p.lead_time_2_s) / (1.0 + S * p.lag_time_2_s)
    washout = S * p.washout_gain_s if p.washout_gain_s else 1.0
    assert result == pytest.approx(wanted * p.gain * washout / (1.0 + S * p.washout_time_s), rel=1e-6)


def test_ieeest_gives_no_signal_beyond_its_voltages():
    c = models.IEEEST.constants(0, dataclasses.replace(FILTER, voltage_min_pu=0.8, voltage_max_pu=1.2))
    start = models.IeeestState(*(0.0,) * 7)._replace(washout=-0.01)
    assert [models.ieeest_rates(start, 0.0, v, c)[1] != 0.0 for v in (0.7, 1.0, 1.3)] == [False, True, False]


def test_a_regulator_leaves_its_limit_as_soon_as_the_error_asks_for_it():
    c = models.IEEEX1.constants(0, EXCITER)
    held = models.ieeex1_start(2.0, 1.0, c)[0]._replace(regulator=EXCITER.regulator_max_pu, lead_lag=1.0)
    assert models.ieeex1_rates(held, 2.0, 1.0, c).regulator == 0.0
    assert models.ieeex1_rates(held, -2.0, 1.0, c).regulator == pytest.approx(
        (c.regulator_gain * (1.0 - c.lead_time_s * 4.0 / c.lag_time_s) - c.regulator_max_pu) / c.regulator_time_s
    )
    # What drives the exciter is never beyond the limit.
    beyond = held._replace(regulator=2.0 * c.regulator_max_pu)
    assert models.ieeex1_rates(beyond, 2.0, 1.0, c).excitation == models.ieeex1_rates(held, 2.0, 1.0, c).excitation


def test_a_hot_exhaust_holds_the_gas_turbine_at_its_load_limit():
    c = models.GAST.constants(0, controls.GasGovernorParameters(load_limit_pu=0.7))
    hot = models.gast_start(0.7, c)
    assert max(np.abs(models.gast_rates(hot, 0.9, 0.5, INV_DROOP, c)[0])) < 1e-12


@pytest.mark.parametrize("machines", [(FIRST, SECOND), OTHERS], ids=["first", "others"])
@pytest.mark.parametrize(("committed", "droop"), [(1.0, None), (0.8, 0.04)])
def test_runs_start_in_an_exact_equilibrium_and_settle(machines, committed, droop):
    given = {"committed": committed, "governor_droop": droop}
    simulator = started(machines, LoadStep(time_s=1.0, bus=3, power_mw=20.0), given=given)
    assert largest_rate(simulator) < 1e-9
    matrix, keep = moving_matrix(simulator._env_view(0), simulator.plant, simulator.layout, 1)
    names = [name for name, own in zip(simulator.layout.state_names, keep, strict=True) if own]
    # Copies of what controls set are no states; the second machine has SEXS.
    assert not {"sync0.field_voltage", "sync0.gate", "sync1.gate"} & set(names)
    assert np.linalg.eigvals(matrix).real.max() < 0.0
    advanced(simulator, 100.0)
    simulator.evaluate()
    # The droop of both governors together.
    ratings = np.array([m.rating_mva for m in machines]) / 100.0
    inv_droops = np.array([1.0 / (droop or m.governor.droop_pu) for m in machines if m.governor])
    damping = np.array([getattr(m.governor, "turbine_damping_pu", 0.0) for m in machines])
    before = started(machines, given=given).machine_values("power")[0].sum()
    more = simulator.machine_values("power")[0].sum() - before
    deviation = 1.0 - simulator.env_values("coi")[0]
    assert committed * ratings @ (inv_droops + damping) * deviation == pytest.approx(more, rel=2e-3)


def test_time_constants_of_zero_take_their_blocks_away():
    of_exciter = dict.fromkeys(("sensing_time_s", "regulator_time_s", "lead_time_s", "lag_time_s"), 0.0)
    of_governor = dict.fromkeys(("lag_time_s", "lead_time_s", "pass_time_3_s", "pass_time_4_s"), 0.0)
    exciter = controls.LeadLagExciterParameters(regulator_gain=40.0, **of_exciter)
    governor = controls.BoilerGovernorParameters(fraction_3=0.1, fraction_2=0.4, **of_governor)
    simulator = started((dataclasses.replace(FIRST, exciter=exciter, governor=governor), SECOND))
    assert largest_rate(simulator) < 1e-9
    with pytest.raises(ValueError, match="lead_time_s = 1 s needs lag_time_s above 0 s"):
        dataclasses.replace(governor, lead_time_s=1.0)


def test_a_lost_governor_keeps_its_torque():
    lost = started((FIRST, SECOND), GovernorLoss(time_s=0.5, bus=1), LoadStep(time_s=1.0, bus=3, power_mw=10.0))
    before = lost.machine_values("torque")[0, 0]
    assert advanced(lost, 60.0).machine_values("torque")[0, 0] == pytest.approx(before, abs=1e-12)


def test_secondary_control_keeps_the_references_within_the_limits_of_the_gates():
    hydro, gas = HydroGovernorParameters(gate_max_pu=0.66), controls.GasGovernorParameters(load_limit_pu=0.45)
    machines = (machine(1, governor=hydro, damping_pu=10), machine(2, governor=gas, damping_pu=10, dispatch_mw=80.0))
    step = LoadStep(time_s=1.0, bus=3, power_mw=60.0)
    simulator, references = started(machines, step, secondary_time_s=10.0), []
    for _ in range(60):
        advanced(simulator, 1.0)
        references.append(simulator.machine_values("gate_reference")[0])
    # The deviation lasts, but it is not added up beyond what a gate can give at rest.
    assert simulator.env_values("coi")[0] < 0.995
    assert np.max(references, axis=0).tolist() == [0.66, 0.45] == references[-1].tolist()


def test_a_share_of_the_dispatch_counts_a_gate_up_to_nominal_power_only():
    governors = GovernorParameters(gate_max_pu=0.8), GovernorParameters(), controls.BoilerGovernorParameters()
    machines = [machine(1, governor=g) for g in (*governors, controls.GasGovernorParameters(load_limit_pu=0.7), None)]
    plant = plant_tables(Plant(case=network(*machines), groups=(), shares_dispatch=True))
    assert plant.participation == pytest.approx(np.array([0.8, 1.0, 1.0, 0.7, 0.0]) / 3.5)


@pytest.mark.parametrize(("changes", "message"), BEYOND)
def test_a_start_beyond_limits_is_refused_with_its_reason(changes, message):
    # The one that cannot start is not the first of its kind.
    other = dataclasses.replace(SECOND, exciter=EXCITER, governor=changes.get("governor", BOILER))
    bad = dataclasses.replace(other, bus=1, dispatch_mw=0.0, **changes)
    good = dataclasses.replace(other, governor=BOILER)
    with pytest.raises(ValueError, match=f"machine at bus 1 would start at .* {message}"):
        started((bad, good))


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="machine at bus 1: a stabiliser needs an exciter"):
        machine(1, exciter=None, stabiliser=STABILISER)
    with pytest.raises(ValueError, match=r"numerator 1 .* has degree 2; its denominator .* has only 1"):
        dataclasses.replace(FILTER, filter_a4_s2=0.0)
    classical = network(FIRST, SECOND).classical().machines
    assert all(m.stabiliser is None and m.exciter is None for m in classical)


@pytest.mark.parametrize("machines", [(FIRST, SECOND), OTHERS], ids=["first", "others"])
def test_every_model_has_gradients(machines):
    groups = (WtgGroup(bus=3, n_turbines=10.0),)
    plant = Plant(case=network(*machines), groups=groups, protection=ProtectionParameters(frequency_max_pu=1.1))
    tape = Tape(dataclasses.replace(EnvSettings(version="v0", duration_s=10.0), plant=plant), 2, 1)
    steps = (LoadStep(time_s=1.0, bus=3, power_mw=20.0), LoadStep(time_s=2.0, bus=3, power_mw=-15.0))
    given = {"wind": np.full((1, 1), 9.0), "duration_s": 10.0, "load_noise_bus": 3}
    scenarios = [scenario(*events, **given) for events in (steps, steps[::-1][1:])]
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (60, 2, tape.batch.n_action))
    for result in check_by_differences(tape, scenarios, actions)[:1]:
        assert result.error.max() <= 1e-5, result.name


def test_a_grid_file_names_every_model(tmp_path):
    for machines in ((FIRST, SECOND), OTHERS):
        grid = Grid(case=network(*machines))
        path = write(tmp_path / "grid.json", grid_text(grid))
        assert get_grid(str(path)) == grid
    text = path.read_text(encoding="utf-8")
    assert '"model": "IEESGO"' in text and '"model": "STAB1"' in text
    with pytest.raises(ValueError, match="unknown model 'IEEEX1'; known here: TGOV1, HYGOV, IEEEG1, IEESGO, GAST"):
        get_grid(str(write(path, text.replace("IEESGO", "IEEEX1"))))


def orders(speed: Callable[[float], float], torque: float, seconds: float) -> np.ndarray:
    """The order of a hydro gate every 10 ms for a given speed, from the equilibrium at a torque."""
    start = models.hydro_start(torque, CONSTANTS)

    def rates(t: float, x: np.ndarray) -> tuple[float, ...]:
        return tuple(models.hydro_rates(models.HydroState(*x), speed(t), start.hydro_gate, INV_DROOP, CONSTANTS)[0])

    # Short steps: the speed may jump.
    how = {"t_eval": np.arange(0.0, seconds + 1e-9, 0.01), "max_step": 0.05, "rtol": 1e-9, "atol": 1e-11}
    return np.asarray(solve_ivp(rates, (0.0, seconds), tuple(start), method="Radau", **how).y[1])


def test_the_order_of_a_hydro_gate_keeps_within_its_rate_and_its_limits_and_leaves_them_at_once():
    order = orders(lambda _t: 0.95, 0.5, 60.0)
    assert (np.diff(order) / 0.01).max() == pytest.approx(HYDRO.gate_rate_limit_pu_s, rel=1e-3)
    assert order.max() == pytest.approx(HYDRO.gate_max_pu, abs=1e-5)
    # Non-windup: the order turns round when its wanted rate does, however long the limit has held it.
    order = orders(lambda t: 0.95 if t < 30.0 else 1.02, 0.8, 31.0)
    assert order[3000] == pytest.approx(HYDRO.gate_max_pu, abs=1e-5)
    assert 0.01 * np.flatnonzero(order[3000:] < HYDRO.gate_max_pu - 1e-3)[0] < 0.2
    assert models.hydro_limited(models.HydroState(0.0, 1.3, 0.9, 0.9), CONSTANTS).gate_order == HYDRO.gate_max_pu


def reference_and_speed(*events: Event, seconds: float, governor: GovernorParameters = GOVERNOR) -> np.ndarray:
    """Gate reference and speed of the generator, from the start on, after each step (2, n)."""
    times = {"secondary_time_s": SECONDARY_S, "interval_s": DT, "simulation_dt": DT}
    simulator = Simulator(Plant(case=with_machine(governor=governor), groups=(), **times), duration_s=seconds)
    simulator.start(0, scenario(*events, wind=np.zeros((0, 1)), duration_s=seconds), ())
    result = []
    for _ in range(round(seconds / DT) + 1):
        result.append([simulator.machine_values(name)[0, 0] for name in ("gate_reference", "speed")])
        simulator.advance()
    return np.array(result).T


def test_the_reference_is_the_integral_of_the_deviation_over_droop_and_time():
    reference, speed = reference_and_speed(MORE, seconds=20.0)
    moved = -DT / (SECONDARY_S * GOVERNOR.droop_pu) * np.cumsum(speed[1:] - 1.0)
    assert moved[-1] > 0.05
    assert reference[1:] - reference[0] == pytest.approx(moved, abs=1e-12)


def test_the_reference_stays_within_the_limits_of_the_gate():
    narrow = dataclasses.replace(GOVERNOR, gate_min_pu=0.36, gate_max_pu=0.48)
    for power_mw, limit in ((60.0, 0.48), (-60.0, 0.36)):
        step = LoadStep(time_s=1.0, bus=4, power_mw=power_mw)
        reference, speed = reference_and_speed(step, seconds=60.0, governor=narrow)
        # The deviation lasts, but it is not added up beyond the limit.
        assert (reference >= 0.36).all() and (reference <= 0.48).all()
        assert (reference[-400:] == limit).all() and (np.abs(speed[-400:] - 1.0) > 1e-3).all()


def test_a_lost_governor_or_a_machine_that_is_away_keeps_its_reference():
    for event in (GovernorLoss(time_s=5.0, bus=1), MachineOutage(time_s=5.0, bus=1)):
        reference, speed = reference_and_speed(MORE, event, seconds=10.0)
        last = round(5.0 / DT)
        assert reference[last] > reference[0] and (speed[last + 1 :] != 1.0).all()
        # The gate stays where a lost governor leaves it; the reference of a machine that trips, where it was.
        assert (reference[last + 1 :] == reference[last + 1]).all()
