"""Gradients of an episode's cost, trips within it too: the compiled adjoint's, checked by central differences."""

import dataclasses
import functools
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.physics.extended import plant
from wtg_gym.envs import EnvSettings
from wtg_gym.gradients import LAW_PARAMETERS, Gradient, Tape, check_by_differences
from wtg_gym.gradients.adjoint import N_TAPED, programs_of, pull
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.protection import STAGES, Status
from wtg_gym.tasks import V1 as TASK_V1
from wtg_gym.tasks.cost import COST_TERMS

NUM_ENVS = 3
#: Their machine code is that of the programs of docs/gradients.md, whose actions are held.
V1 = {"version": "v1", "control_dt": 0.1}
KUNDUR = {**V1, "grid": "kundur"}
#: Settings, the first seed, and the term that costs nothing. With faults, load is shed in an island of groups alone.
SILENT = [
    ({}, 1_000_000, "overload"),
    ({**V1, "suite": "faults"}, 1_000_047, "rotor"),
    ({**V1, "suite": "no-wind-sensor"}, 1_000_015, "rotor"),
]
STEP = sc.LoadStep(time_s=0.525, bus=4, power_mw=15.0)
OUTAGES = [
    [STEP, sc.GovernorLoss(time_s=2.35, bus=1)],
    [STEP, sc.MachineOutage(time_s=1.05, bus=3)],
    [STEP, sc.LineTrip(time_s=1.075, from_bus=4, to_bus=5, recloses_after_s=0.225)],
]
FAULT = sc.Fault(time_s=1.0, bus=4, clears_after_s=0.15, opens=(4, 5))
OUTAGES_V1 = [
    [FAULT, sc.ReactanceStep(time_s=2.0, from_bus=2, to_bus=4, factor=3.0)],
    [sc.LineTrip(time_s=1.0, from_bus=a, to_bus=b) for a, b in ((5, 6), (4, 7), (4, 9))],
    [sc.MachineOutage(time_s=1.0, bus=1)],
]
#: A group trips in strong wind, and others take over until load is lost too: their currents are limited meanwhile.
OVERLOAD = (sc.GroupTrip(time_s=1.0, group=0), sc.LoadStep(time_s=1.6, bus=4, power_mw=-70.0))
#: Episodes end within a control interval, which is longer than that of the protections; no last cost is cut.
OTHERS = {
    **{"plant": {"machine_model": "classical"}, "control_dt": 0.5, "weights": {"cap": 5000.0}},
    **{"action_mode": "tau", "observation_mode": "privileged", "strategy": "coordinated-piecewise"},
}
ZEROS = np.zeros((5, NUM_ENVS, 4))
BAD = [
    (lambda tape, scenarios: tape.gradient(scenarios, np.zeros((5, NUM_ENVS, 9))), "shape"),
    (lambda tape, scenarios: tape.gradient(scenarios, ZEROS, {"duty": np.nan}), "finite"),
    # One would have been played in all environments.
    (lambda tape, scenarios: tape.start(scenarios[:1]), "3 scenarios, one per environment"),
    *((lambda _, __, name=name: getattr(unused(), name)(), "start") for name in ("law", "outputs", "back")),
    (lambda tape, scenarios: unused().step(np.zeros((NUM_ENVS, 4))), "start"),
    (lambda tape, scenarios: tape.set_law(tape.law()), "first step"),
    (lambda tape, scenarios: tape.start(scenarios) is not tape.set_law(tape.law() * np.nan), "finite"),
    (lambda tape, scenarios: pulled(tape, 1), "no step 1: since start.. 1 have"),
    (lambda tape, scenarios: pulled(tape, 0, carried=0.0), "carried must have the shape"),
    (lambda tape, scenarios: pulled(tape, 0, observations=np.zeros(3)), "observations must have the shape"),
    (lambda tape, own: check_by_differences(tape, own, ZEROS, step=0.0), r"step .* 1e-9 … 0.1, got 0.0"),
    (lambda tape, own: check_by_differences(tape, own, ZEROS, direction=np.ones(3)), "direction must be"),
    (lambda tape, scenarios: check_by_differences(tape, scenarios, ZEROS, {"power": 1.0}), "unknown terms"),
    # More steps than were taken, the last of which would have counted nothing.
    (lambda tape, scenarios: tape.back(outputs=np.zeros((2, NUM_ENVS, 8))), r"\(1, 3, 8\), got \(2, 3, 8\)"),
]


@functools.cache
def tape_of(**settings) -> Tape:
    return Tape(EnvSettings(**{"version": "v0", **settings}), NUM_ENVS, 1)


def drawn(tape: Tape, first: int = 1_000_000) -> list[sc.Scenario]:
    return tape.batch.scenarios(list(range(first, first + NUM_ENVS)))


def actions_of(tape: Tape, n_steps: int, scale: float = 0.4) -> np.ndarray:
    shape = (n_steps, NUM_ENVS, tape.batch.n_action)
    return np.random.default_rng(1).uniform(-scale, scale, shape)


def played(tape: Tape, scenarios: list[sc.Scenario], actions: np.ndarray, law: np.ndarray | None = None) -> np.ndarray:
    """Terms of the cost of every environment (num_envs, n_terms), by the environment alone."""
    tape.start(scenarios)
    if law is not None:
        tape.set_law(law)
    return np.sum([tape.step(own)[1] for own in actions], axis=0)


def central(function: Callable[[float], np.ndarray], h: float = 1e-6) -> np.ndarray:
    return (function(h) - function(-h)) / (2.0 * h)


def along(found: Gradient, way: np.ndarray) -> np.ndarray:
    return np.einsum("kla,kla->l", found.actions, way)


def given(n_wtg: int, *events, wind: float = 9.0, bus: int = 3) -> sc.Scenario:
    return sc.Scenario(name="given", wind_speed=np.full((n_wtg, 1), wind), events=events, load_noise_bus=bus)


def agrees(tape: Tape, scenarios: list[sc.Scenario], actions: np.ndarray, tolerance: float = 1e-5) -> Gradient:
    """Check the gradient of the cost with respect to the actions, along some way; return it."""
    result = tape.gradient(scenarios, actions)
    way = np.random.default_rng(3).normal(size=actions.shape)
    expected = central(lambda h: played(tape, scenarios, actions + h * way)).sum(axis=1)
    assert np.abs(expected).max() > 1e-3
    assert along(result, way) == pytest.approx(expected, rel=tolerance, abs=tolerance * np.abs(expected).max())
    return result


@pytest.mark.parametrize("settings", [{}, {**V1, "suite": "faults"}, KUNDUR])
def test_a_step_is_replayed_to_the_last_bit(settings, monkeypatch):
    tape = tape_of(**settings)
    tape.start(drawn(tape))
    for own in actions_of(tape, 60):
        tape.step(own)
    simulator, after = tape.batch.simulator, list[np.ndarray]()
    monkeypatch.setattr("wtg_gym.gradients.tape.pull", lambda b, *more: [pull(b, *more), after.append(b.copy())])
    carried, terms = np.zeros((NUM_ENVS, tape.n_carried)), np.ones((NUM_ENVS, len(COST_TERMS)))
    for step in range(60):
        tape.pull(step, carried, terms)
    # An episode that is over stands still in the next step's blocks, and runs at the end of its own.
    active = int(simulator.layout.env("active"))
    expected = [*(tape.before(step) for step in range(1, 60)), simulator.blocks]
    for ours, theirs in zip(after, expected, strict=True):
        values = (blocks[:, :, :NUM_ENVS] for blocks in (ours, theirs))
        result, given = (np.delete(own, active, axis=1) for own in values)
        assert np.array_equal(result, given)


@pytest.mark.parametrize(("settings", "first", "silent"), SILENT)
def test_the_gradient_of_each_term_is_that_of_central_differences(settings, first, silent):
    tape = tape_of(**settings)
    scenarios, actions = drawn(tape, first), actions_of(tape, 200)
    way = np.random.default_rng(2).normal(size=actions.shape)
    measured = central(lambda h: played(tape, scenarios, actions + h * way))
    for index, term in enumerate(COST_TERMS[:-1]):
        expected = measured[:, index]
        assert expected.any() == (term != silent)
        result = along(tape.gradient(scenarios, actions, {term: 1.0}), way)
        assert result == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())
    assert along(tape.gradient(scenarios, actions), way) == pytest.approx(measured.sum(axis=1), rel=1e-5)


@pytest.mark.parametrize("settings", [{}, V1])
def test_the_gradient_with_respect_to_the_law_is_that_of_central_differences(settings):
    tape = tape_of(**settings)
    scenarios, actions = drawn(tape), actions_of(tape, 100)
    result = tape.gradient(scenarios, actions)
    tape.start(scenarios)
    law = tape.law()
    assert np.array_equal(law[0, 0, :3], [getattr(tape.batch.laws[0], k) for k in ("k_min", "k_nominal", "k_max")])
    for place in np.ndindex(law.shape[1:]):
        # k_nominal moves the start onto another branch of a law soon; of the others rounding would show.
        one = np.zeros_like(law)
        one[:, *place] = 1.0
        moved = functools.partial(lambda one, h: played(tape, scenarios, actions, law + h * one).sum(axis=1), one)
        expected = central(moved, 1e-6 if place[1] == 1 else 1e-5)
        assert result.law[:, *place] == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


def test_a_held_step_has_the_gradient_of_its_intervals():
    held, fine = (tape_of(version="v1", suite="faults", on_failure="terminate", **d) for d in ({}, {"control_dt": 0.1}))
    # The first two episodes end within a step: a rotor is too slow, and the frequency too high.
    falling, at = np.maximum(9.0 - 0.12 * np.arange(121), 3.0), sc.LoadStep(time_s=2.1, bus=3, power_mw=-150.0)
    scenarios = [
        sc.Scenario(name="falling", wind_speed=np.tile(falling, (4, 1))),
        dataclasses.replace(given(4, at), inertia_scale=0.3),
        *drawn(held, 1_000_047)[:1],
    ]
    actions = actions_of(held, 24)
    result, intervals = agrees(held, scenarios, actions), fine.gradient(scenarios, actions.repeat(5, axis=0))
    ended = held.batch.simulator.env_values("step") / 4
    assert held.batch.statuses().tolist()[2] == 0 and (ended % 5.0 > 0.0).tolist() == [True, True, False]
    assert result.terms == pytest.approx(intervals.terms, rel=1e-12)
    assert result.law == pytest.approx(intervals.law, rel=1e-9)
    assert result.actions == pytest.approx(intervals.actions.reshape(24, 5, *actions.shape[1:]).sum(axis=1), rel=1e-9)
    # What a step shows is what its last interval does, and that of an episode's end.
    shown = np.random.default_rng(4).normal(size=(24, NUM_ENVS, len(held.output_names)))
    parts = np.zeros((120, NUM_ENVS, shown.shape[2]))
    last = np.minimum(5 * np.arange(24)[:, np.newaxis] + 4, np.ceil(ended).astype(int) - 1)
    for step, env in np.ndindex(24, NUM_ENVS):
        if 5 * step <= last[step, env]:
            parts[last[step, env], env] = shown[step, env]
    held.play(scenarios, actions)
    for ours, theirs in zip(held.back(None, shown)[1:], fine.back(None, parts)[1:], strict=True):
        assert ours == pytest.approx(theirs, rel=1e-9)


@pytest.mark.parametrize(("settings", "events"), [({}, OUTAGES), (V1, OUTAGES_V1)])
def test_the_gradient_goes_through_events(settings, events):
    tape = tape_of(**settings)
    agrees(tape, [given(tape.batch.n_wtg, *own) for own in events], actions_of(tape, 60))


def test_the_gradient_goes_through_the_limits_of_the_pitch():
    tape = tape_of()
    time = np.arange(0.0, 31.0, 0.1)
    step = sc.LoadStep(time_s=1.0, bus=4, power_mw=60.0)
    winds = [np.tile(mean + 5.0 * np.sin(0.5 * time), (2, 1)) for mean in (9.5, 10.0, 10.5)]
    scenarios = [sc.Scenario(name="gusts", wind_speed=wind, events=(step,)) for wind in winds]
    agrees(tape, scenarios, actions_of(tape, 300, 0.3))
    row = tape.batch.simulator.layout.wtg("pitch_integral")
    turned = np.array([tape._rows(row, block) > 0.0 for block in map(tape.before, range(300))]).any(axis=(1, 2))
    # The controller acts, comes to rest at its limit, and acts again.
    assert np.count_nonzero(np.diff(turned.astype(int))) >= 3


def test_the_gradient_goes_through_the_limits_of_currents_and_powers():
    tape = tape_of(**V1)
    step = sc.LoadStep(time_s=1.0, bus=2, power_mw=60.0, reactive_mvar=60.0)
    scenarios = [given(4, *OVERLOAD, wind=11.5), given(4, step, wind=11.5), given(4, *OVERLOAD, wind=11.5)]
    actions = actions_of(tape, 80, 0.2)
    agrees(tape, scenarios, actions)
    tape.start(scenarios)
    limited, over_power = np.zeros(NUM_ENVS, dtype=int), np.zeros(NUM_ENVS)
    for own in actions:
        tape.step(own)
        limited += (tape.batch.simulator.wtg_values("limiting_reactance") > 0.0).any(axis=1)
        over_power = np.minimum(over_power, tape.batch.simulator.wtg_values("over_power").min(axis=1))
    assert (limited[[0, 2]] > 2).all() and over_power[1] < -1e-4


@pytest.mark.parametrize("settings", [{}, OTHERS], ids=["usual", "others"])
def test_an_episode_that_ends_early_has_the_gradient_of_what_it_paid(settings):
    tape = Tape(EnvSettings(version="v0", **settings), NUM_ENVS, 1)
    scenarios = [given(2, sc.LoadStep(time_s=1.0, bus=4, power_mw=power)) for power in (600.0, -300.0, 20.0)]
    actions = actions_of(tape, 60, 0.2)
    result = agrees(tape, scenarios, actions)
    played(tape, scenarios, actions)
    ended = tape.batch.simulator.env_values("step") / tape.batch.simulator.plant.network.facts.n_substeps
    statuses = tape.batch.statuses()
    assert (statuses[:2] != Status.RUNNING).all() and (ended[:2] < 50).all()
    assert statuses[2] == Status.RUNNING and (not settings or (ended[:2] % 1.0 > 0.0).all())
    # The cost of the failure is constant, and steps after it have no effect.
    assert result.terms[0, COST_TERMS.index("failure")] > 0.0
    failure = tape.gradient(scenarios, actions, {"failure": 1.0})
    assert not failure.actions.any() and not failure.law.any()
    last = math.ceil(ended[0]) - 1
    assert result.actions[last, 0].any() and not result.actions[last + 1 :, 0].any()


#: At rest at nominal frequency, on the middle corner of the law, for a second.
AT_REST = [given(2, sc.LoadStep(time_s=1.0, bus=4, power_mw=power)) for power in (10.0, 20.0, 30.0)]


def test_a_plant_at_rest_has_the_slopes_of_the_law_whose_lower_part_goes_on_straight():
    tape = tape_of()
    actions = np.zeros((40, NUM_ENVS, 4))
    way = np.random.default_rng(3).normal(size=actions.shape) * (np.arange(40) < 10)[:, np.newaxis, np.newaxis]
    result = along(tape.gradient(AT_REST, actions), way)
    tape.start(AT_REST)
    straight = tape.law()
    straight[:, :, 2] = 2.0 * straight[:, :, 1] - straight[:, :, 0]
    base = played(tape, AT_REST, actions)
    # The frequency never rises above its nominal value.
    assert np.array_equal(played(tape, AT_REST, actions, straight), base)
    expected = central(lambda h: played(tape, AT_REST, actions + h * way, straight), 1e-5).sum(axis=1)
    assert result == pytest.approx(expected, rel=1e-5)
    # With its corner, the law has another slope on each side.
    checked = check_by_differences(tape, AT_REST, actions, direction=way)[0]
    assert (np.abs(checked.above - checked.below) > 0.01 * np.abs(checked.central)).all()


def test_the_check_shows_a_wrong_gradient(monkeypatch):
    tape = tape_of()
    right = tape.gradient
    monkeypatch.setattr(tape, "gradient", lambda *own: (found := right(*own))._replace(actions=1.01 * found.actions))
    checked = check_by_differences(tape, drawn(tape), actions_of(tape, 20))
    assert checked[0].error == pytest.approx(np.full(NUM_ENVS, 0.01 / 1.01), rel=1e-2)
    assert (checked[1].error < 1e-5).all()


@functools.cache
def unused() -> Tape:
    return Tape(tape_of().batch.settings, NUM_ENVS, 1)


def pulled(tape: Tape, step: int, **other):
    given = {"carried": np.zeros((NUM_ENVS, tape.n_carried)), "terms": np.zeros((NUM_ENVS, len(COST_TERMS)))}
    return tape.pull(step, **given | other)


@pytest.mark.parametrize(("call", "reason"), BAD)
def test_bad_input_is_refused(call, reason):
    tape = tape_of()
    scenarios = drawn(tape)
    tape.gradient(scenarios, np.zeros((1, NUM_ENVS, 4)))
    with pytest.raises(ValueError, match=reason):
        call(tape, scenarios)


def test_a_plant_with_a_hydro_governor_and_a_rotor_table_has_gradients_too():
    given = dataclasses.replace(EnvSettings(version="v0", duration_s=10.0), plant=plant(table=True))
    tape = Tape(given, 2, 1)
    scenarios = [tape.batch.suite.scenario(seed, duration_s=10.0) for seed in (10_000, 10_001)]
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 2, tape.batch.n_action))
    for result in check_by_differences(tape, scenarios, actions):
        assert result.error.max() <= 1e-5, result.name


TERMS, OUTPUTS = ("frequency", "rocof", "duty", "effort"), ("frequency_pu", "rocof_hz_s", "rotor_0_speed_pu")
QUANTITIES = (*TERMS, *OUTPUTS, "observations")


def falling(n_wtg: int, first: float, n_steps: int, *events: Any) -> sc.Scenario:
    """The first group's wind falls evenly to 3 m/s from control step 20 on; that of the others stays."""
    wind = np.full((n_wtg, 301), first)
    wind[0] = np.interp(np.arange(301), [20, 20 + n_steps], [first, 3.0])
    return sc.Scenario(name="given", wind_speed=wind, load_noise_bus=3, events=events)


@functools.cache
def tripping(name: str) -> Tape:
    # No cap is reached: it would mix the terms. That of v1 is high enough, and its machine code is shared.
    high: dict[str, Any] = {"version": "v0", "weights": {"cap": 5000.0}, "observation_mode": "privileged"}
    settings = V1 if name == "v1" else {**high, "plant": {"physics": "extended"}, "control_dt": 0.5}
    return Tape(EnvSettings(on_failure="trip", **settings), NUM_ENVS, 1)


def case_of(tape: Tape, scale: float) -> tuple[list[sc.Scenario], np.ndarray, list[int]]:
    """Scenarios in which the first rotor of every environment falls below its least speed, so that its group trips.

    In two environments a governor is lost, or another group trips, in the last simulation step before. With them come
    actions until the last of these trips, and the control step of each.
    """
    scenarios = [
        falling(tape.batch.n_wtg, first, n_steps, sc.LoadStep(time_s=1.0, bus=4, power_mw=power))
        for first, n_steps, power in ((9.0, 50, 20.0), (8.5, 60, 30.0), (9.0, 30, 20.0))
    ]
    actions = actions_of(tape, 200, scale)
    at = trips(tape, scenarios, actions)
    plant = tape.batch.simulator.settings
    last = [(step + 1) * plant.interval_s - plant.simulation_dt for step in at]
    buses = [machine.bus for machine in plant.case.machines if machine.governor is not None]
    further = ((), (sc.GovernorLoss(time_s=last[1], bus=buses[0]),), (sc.GroupTrip(time_s=last[2], group=1),))
    scenarios = [dataclasses.replace(s, events=(*s.events, *more)) for s, more in zip(scenarios, further, strict=True)]
    assert trips(tape, scenarios, actions) == at
    return scenarios, actions[: max(at) + 1], at


def trips(tape: Tape, scenarios: list[sc.Scenario], actions: np.ndarray) -> list[int]:
    """Return the control step in which each environment's first group trips."""
    tape.start(scenarios)
    gone = []
    for own in actions:
        tape.step(own)
        gone.append(tape.batch.simulator.wtg_values("connected")[:, 0] < 0.5)
    assert gone[-1].all()
    return np.argmax(gone, axis=0).tolist()


def measured(tape: Tape, case, way: np.ndarray, h: float) -> np.ndarray:
    """Every quantity at each environment's step of the trip, with the actions moved by h (n_quantities, num_envs)."""
    (scenarios, actions, at), weights = case, weights_of(tape)
    result = np.empty((len(QUANTITIES), NUM_ENVS))
    tape.start(scenarios)
    for step, own in enumerate(actions):
        _, terms = tape.step(own + h * way[step])
        outputs, simulator = tape.outputs(), tape.batch.simulator
        # As the simulator holds them, before they are rounded to 32 bits.
        shown = weights @ simulator.scratches[0].reshape(-1, simulator.width)[tape.batch.task_data.observed, :NUM_ENVS]
        values = [*(terms[:, COST_TERMS.index(term)] for term in TERMS)]
        values += [*(outputs[:, tape.output_names.index(name)] for name in OUTPUTS), shown]
        for env in np.flatnonzero(np.array(at) == step):
            result[:, env] = np.array(values)[:, env]
    return result


def weights_of(tape: Tape) -> np.ndarray:
    return np.random.default_rng(6).normal(size=tape.batch.n_observation)


def slope_of(tape: Tape, case, quantity: str, way: np.ndarray) -> np.ndarray:
    """The derivative of a quantity at each environment's trip along a way through the actions (num_envs,)."""
    carried, total = np.zeros((NUM_ENVS, tape.n_carried)), np.zeros(NUM_ENVS)
    _, actions, at = case
    for step in range(len(actions) - 1, -1, -1):
        here = (np.array(at) == step).astype(float)
        terms, outputs = (np.outer(here, np.array(names) == quantity) for names in (COST_TERMS, tape.output_names))
        shown = np.outer(here, weights_of(tape) * (quantity == "observations"))
        carried, of_actions, *_ = tape.pull(step, carried, terms, shown, outputs)
        total += np.einsum("la,la->l", of_actions, way[step])
    return total


# v1 charges a change of actions less: larger ones let its slope show.
@pytest.mark.parametrize(("name", "scale"), [("within a control step", 0.1), ("v1", 0.2)])
def test_each_quantity_of_the_step_of_a_trip_has_the_slope_of_central_differences(name, scale):
    tape, h = tripping(name), 1e-5
    case = case_of(tape, scale)
    way = np.random.default_rng(3).normal(size=case[1].shape)
    # What is played last is on the tape.
    up, down, values = (measured(tape, case, way, sign * h) for sign in (1.0, -1.0, 0.0))
    slopes = (up - down) / (2.0 * h)
    for place, quantity in enumerate(QUANTITIES):
        rounding = 5e-14 * max(1.0, np.abs(values[place]).max()) / h
        assert slope_of(tape, case, quantity, way) == pytest.approx(slopes[place], rel=1e-5, abs=rounding), quantity
    assert (np.abs(slopes).max(axis=1) > 1e-6).all()


def test_the_gradient_goes_through_shed_load_and_groups_that_their_rotor_trips():
    tape = tripping("within a control step")
    small, large, larger = (sc.LoadStep(time_s=1.0, bus=4, power_mw=power) for power in (20.0, 380.0, 390.0))
    scenarios = [given(2, large), falling(2, 9.0, 50, small), given(2, larger)]
    actions = actions_of(tape, 200, 0.2)
    agrees(tape, scenarios, actions)
    played(tape, scenarios, actions)
    simulator = tape.batch.simulator
    shed = tape._rows(simulator.layout.first_rows(STAGES, "shed")) < 0.0
    assert shed.any(axis=1)[[0, 2]].all() and (simulator.wtg_values("connected") == 0.0).any()


def test_parameters_of_v1_act_through_limits_and_sensors():
    # The tape of docs/gradients.md, of one environment. A scenario of v1 has a governor droop of its own.
    names = ("machines.1.two_h_s", "control.droop_gain_pu")
    tape = Tape(EnvSettings(), 1, 1, names)
    values = tape.parameter_values()
    checked = check_by_differences(tape, tape.batch.scenarios([1_000_001]), np.zeros((120, 1, tape.batch.n_action)))
    assert [each.name for each in checked] == ["actions", *LAW_PARAMETERS, *names]
    assert tape.parameter_values() == values
    for each in checked[-2:]:
        assert np.abs(each.gradient).min() > 1e-4
        assert each.gradient == pytest.approx(each.central, rel=1e-5), each.name


def test_other_processes_find_the_machine_code_of_this_one():
    digests = [program.digest(back=True) for program in programs_of(TASK_V1)[:N_TAPED]]
    code = (
        "from wtg_gym.gradients.adjoint import N_TAPED, programs_of; from wtg_gym.tasks import V1;"
        "print(*(program.digest(back=True) for program in programs_of(V1)[:N_TAPED]))"
    )
    for seed in "12":
        env = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2]), "PYTHONHASHSEED": seed}
        run = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
        assert run.stdout.split() == digests
