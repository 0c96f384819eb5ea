"""Gradients of the control step in which a protection disconnects a group, and of plants that shed load."""

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

from tests.gradients.test_gradients import NUM_ENVS, V1, actions_of, agrees, given, played
from wtg_gym.envs import EnvSettings
from wtg_gym.gradients import LAW_PARAMETERS, Tape, check_by_differences
from wtg_gym.physics.protection import STAGES
from wtg_gym.physics.scenario import GovernorLoss, GroupTrip, LoadStep, Scenario
from wtg_gym.tasks.cost import COST_TERMS

TERMS, OUTPUTS = ("frequency", "rocof", "duty", "effort"), ("frequency_pu", "rocof_hz_s", "rotor_0_speed_pu")
QUANTITIES = (*TERMS, *OUTPUTS, "observations")


def falling(n_wtg: int, first: float, n_steps: int, *events: Any) -> Scenario:
    """The first group's wind falls evenly to 3 m/s from control step 20 on; that of the others stays."""
    wind = np.full((n_wtg, 301), first)
    wind[0] = np.interp(np.arange(301), [20, 20 + n_steps], [first, 3.0])
    return Scenario(name="given", wind_speed=wind, load_noise_bus=3, events=events)


@functools.cache
def tape_of(name: str) -> Tape:
    # No cap is reached: it would mix the terms. That of v1 is high enough, and its machine code is shared.
    high: dict[str, Any] = {"version": "v0", "weights": {"cap": 5000.0}, "observation_mode": "privileged"}
    settings = V1 if name == "v1" else {**high, "plant": {"physics": "extended"}, "control_dt": 0.5}
    return Tape(EnvSettings(on_failure="trip", **settings), NUM_ENVS, 1)


def case_of(tape: Tape, scale: float) -> tuple[list[Scenario], np.ndarray, list[int]]:
    """Scenarios in which the first rotor of every environment falls below its least speed, so that its group trips.

    In two environments a governor is lost, or another group trips, in the last simulation step before. With them come
    actions until the last of these trips, and the control step of each.
    """
    scenarios = [
        falling(tape.batch.n_wtg, first, n_steps, LoadStep(time_s=1.0, bus=4, power_mw=power))
        for first, n_steps, power in ((9.0, 50, 20.0), (8.5, 60, 30.0), (9.0, 30, 20.0))
    ]
    actions = actions_of(tape, 200, scale)
    at = trips(tape, scenarios, actions)
    plant = tape.batch.simulator.settings
    last = [(step + 1) * plant.control_dt - plant.simulation_dt for step in at]
    buses = [machine.bus for machine in plant.case.machines if machine.governor is not None]
    further = ((), (GovernorLoss(time_s=last[1], bus=buses[0]),), (GroupTrip(time_s=last[2], group=1),))
    scenarios = [
        dataclasses.replace(own, events=(*own.events, *more)) for own, more in zip(scenarios, further, strict=True)
    ]
    assert trips(tape, scenarios, actions) == at
    return scenarios, actions[: max(at) + 1], at


def trips(tape: Tape, scenarios: list[Scenario], actions: np.ndarray) -> list[int]:
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


def pulled(tape: Tape, case, quantity: str, way: np.ndarray) -> np.ndarray:
    """The derivative of a quantity at each environment's trip along a way through the actions (num_envs,)."""
    carried, total = np.zeros((NUM_ENVS, tape.n_carried)), np.zeros(NUM_ENVS)
    _, actions, at = case
    for step in range(len(actions) - 1, -1, -1):
        here = (np.array(at) == step).astype(float)
        terms, outputs = np.zeros((NUM_ENVS, len(COST_TERMS))), np.zeros((NUM_ENVS, len(tape.output_names)))
        shown = np.zeros((NUM_ENVS, tape.batch.n_observation))
        if quantity in TERMS:
            terms[:, COST_TERMS.index(quantity)] = here
        elif quantity in OUTPUTS:
            outputs[:, tape.output_names.index(quantity)] = here
        else:
            shown = here[:, np.newaxis] * weights_of(tape)
        carried, of_actions, *_ = tape.pull(step, carried, terms, shown, outputs)
        total += np.einsum("la,la->l", of_actions, way[step])
    return total


# v1 charges a change of actions less: larger ones let its slope show.
@pytest.mark.parametrize(("name", "scale"), [("within a control step", 0.1), ("v1", 0.2)])
def test_each_quantity_of_the_step_of_a_trip_has_the_slope_of_central_differences(name, scale):
    tape, h = tape_of(name), 1e-5
    case = case_of(tape, scale)
    way = np.random.default_rng(3).normal(size=case[1].shape)
    # What is played last is on the tape.
    up, down, values = (measured(tape, case, way, sign * h) for sign in (1.0, -1.0, 0.0))
    slopes = (up - down) / (2.0 * h)
    for place, quantity in enumerate(QUANTITIES):
        rounding = 5e-14 * max(1.0, np.abs(values[place]).max()) / h
        assert pulled(tape, case, quantity, way) == pytest.approx(slopes[place], rel=1e-5, abs=rounding), quantity
    assert (np.abs(slopes).max(axis=1) > 1e-6).all()


def test_the_gradient_goes_through_shed_load_and_groups_that_their_rotor_trips():
    tape = tape_of("within a control step")
    wind = np.full((2, 301), 9.0)
    wind[0] = np.maximum(9.0 - 0.12 * np.arange(301), 3.0)
    step = LoadStep(time_s=1.0, bus=4, power_mw=20.0)
    scenarios = [
        given(2, LoadStep(time_s=1.0, bus=4, power_mw=380.0)),
        Scenario(name="calm", wind_speed=wind, load_noise_bus=3, events=(step,)),
        given(2, LoadStep(time_s=1.0, bus=4, power_mw=390.0)),
    ]
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
