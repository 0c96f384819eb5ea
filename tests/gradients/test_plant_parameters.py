"""Gradients with respect to a plant's parameters, of costs and of outputs: checked by rebuilt plants."""

import dataclasses
import functools

import numpy as np
import pytest

from wtg_gym import GovernorLoss, LoadStep, MachineOutage, Plant, Scenario
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.gradients.plant_parameters import known_parameters, with_parameters
from wtg_gym.gradients.tape import Tape
from wtg_gym.tasks.cost import COST_TERMS

N_STEPS, NUM_ENVS = 120, 3
SETTINGS = EnvSettings(version="v0")
#: At 0 the dead band is a corner.
PLANT = with_parameters(SETTINGS.resolved_plant, {"machines.1.governor.dead_band_pu": 2e-4})
KNOWN = known_parameters(PLANT)
#: The condensers at buses 6 and 8 have nothing that the one at bus 3 has not.
COMPARED = [name for name in KNOWN if not name.startswith(("machines.6.", "machines.8.")) or name.endswith("two_h_s")]
BAD = [
    (lambda: Tape(SETTINGS, 1, 1, ("control.reactance_pu",)), r"known: machines\.1\.two_h_s, .*control\.droop"),
    (lambda: tape().set_parameters({"machines.2.two_h_s": 0.02}), "the tape has no parameters"),
    (lambda: tape().set_parameters({"control.inertia_constant_s": -1.0}), "inertia_constant_s"),
    (lambda: Tape(SETTINGS, 1, 1).set_parameters({"control.droop_gain_pu": 1.0}), "it has: none"),
]


@functools.cache
def tape() -> Tape:
    return Tape(dataclasses.replace(SETTINGS, plant=PLANT), NUM_ENVS, 1, tuple(KNOWN))


@functools.cache
def given() -> tuple[list[Scenario], np.ndarray, np.ndarray]:
    """Scenarios (a pitch controller acts in the last), actions, and weights of the outputs."""
    rng = np.random.default_rng(1)
    actions = rng.uniform(-0.4, 0.4, (N_STEPS, NUM_ENVS, 4))
    time = np.arange(0.0, 31.0, 0.1)
    wind = (np.full((2, 1), 8.0), np.full((2, 1), 9.0), np.tile(11.5 + 1.5 * np.sin(time), (2, 1)))
    steps = [LoadStep(time_s=1.0, bus=4, power_mw=own) for own in (20.0, -30.0, 15.0)]
    scenarios = [Scenario(name="given", wind_speed=w, events=(step,)) for w, step in zip(wind, steps, strict=True)]
    return scenarios, actions, rng.normal(size=(N_STEPS, NUM_ENVS, 8))


def weighed(plant: Plant, scenarios: list[Scenario], actions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Cost and weighed outputs of each episode (num_envs,), in a plant built anew, by the environment alone."""
    batch = EnvBatch(dataclasses.replace(SETTINGS, plant=plant), NUM_ENVS, 1)
    batch.start(list(range(NUM_ENVS)), scenarios)
    total = np.zeros(NUM_ENVS)
    for own, weight in zip(actions, weights, strict=True):
        batch.step(own)
        shown = [batch.simulator.env_values("coi"), batch.task_values("rocof")]
        total += weight[:, 0] * shown[0] + weight[:, 1] * shown[1]
        total += (weight[:, 2:4] * batch.simulator.wtg_values("rotor_speed")).sum(axis=1)
        total += (weight[:, 4:] * batch.simulator.machine_values("speed")).sum(axis=1)
    return total + batch.cost_sums().sum(axis=1)


@functools.cache
def found() -> np.ndarray:
    scenarios, actions, weights = given()
    played = tape().play(scenarios, actions)
    total = weighed(PLANT, scenarios, actions, weights)
    assert np.einsum("slt->l", played.terms) + np.einsum("slo,slo->l", weights, played.outputs) == pytest.approx(total)
    return tape().back(np.ones(len(COST_TERMS)), weights)[2]


@pytest.mark.parametrize("name", COMPARED)
def test_the_gradient_with_respect_to_a_parameter_is_that_of_rebuilt_plants(name):
    scenarios, actions, weights = given()
    value = KNOWN[name]
    h = 5e-4 * (value or 1.0)
    places = (-2.0, -1.0, 1.0, 2.0) if value else (0.0, 1.0, 2.0, 3.0)
    # Both formulas are exact for polynomials of the third degree.
    factors = np.array((1.0, -8.0, 8.0, -1.0) if value else (-11.0, 18.0, -9.0, 2.0)) / ((12.0 if value else 6.0) * h)
    ends = [weighed(with_parameters(PLANT, {name: value + place * h}), scenarios, actions, weights) for place in places]
    expected = factors @ ends
    by_tape = found()[:, list(KNOWN).index(name)]
    assert by_tape == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max() + 1e-10)


def test_parameters_matter():
    """The test above compares no zeros, but where there is nothing to see."""
    without = {name for name, column in zip(KNOWN, found().T, strict=True) if not column.any()}
    # The generator's x'_q is its x_q, its rotor is never faster than the pitch allows, and no blade moves at its limit.
    assert without <= {"machines.1.t_q0_transient_s", "pitch.speed_weight", "pitch.rate_limit_deg_s"}


def test_a_scenarios_droop_is_the_droop_in_force_until_a_governor_is_lost():
    scenarios, actions, weights = given()
    losses = ((), (GovernorLoss(time_s=2.35, bus=1),), (GovernorLoss(time_s=0.0, bus=1),))
    base = [
        dataclasses.replace(scenario, governor_droop=0.04, inertia_scale=0.7, events=(*scenario.events, *loss))
        for scenario, loss in zip(scenarios, losses, strict=True)
    ]
    moved = [[dataclasses.replace(own, governor_droop=0.04 + h) for own in base] for h in (1e-6, -1e-6)]
    ends = [weighed(PLANT, own, actions, weights) for own in moved]
    expected = (ends[0] - ends[1]) / 2e-6
    result = column("machines.1.governor.droop_pu", base, weights)
    assert np.abs(expected[:2]).min() > 0.1
    assert result == pytest.approx(expected, rel=1e-5, abs=1e-7)
    assert result[2] == 0.0


def column(name: str, scenarios: list[Scenario], weights: np.ndarray) -> np.ndarray:
    """Gradient of cost and weighed outputs with respect to a parameter (num_envs,)."""
    tape().play(scenarios, given()[1])
    return tape().back(np.ones(len(COST_TERMS)), weights)[2][:, list(KNOWN).index(name)]


def test_inertia_is_scaled_by_scenarios_and_gone_with_its_machine():
    scenarios, actions, weights = given()
    name = "machines.3.two_h_s"
    lost = (*scenarios[0].events, MachineOutage(time_s=3.05, bus=3))
    early = (*scenarios[0].events, LoadStep(time_s=4.0, bus=4, power_mw=600.0))
    changes = ({"inertia_scale": 0.6}, {"events": lost}, {"events": early})
    scenarios = [dataclasses.replace(scenarios[0], **own) for own in changes]
    # After its end an episode shows what it showed last, which is not differentiated.
    tape().play(scenarios, actions)
    ended = int(tape().batch.simulator.env_values("step")[2] // 4)
    assert ended < N_STEPS - 20
    weights = weights.copy()
    weights[ended:, 2] = 0.0
    plants = [with_parameters(PLANT, {name: KNOWN[name] + h}) for h in (1e-3, -1e-3)]
    ends = [weighed(plant, scenarios, actions, weights) for plant in plants]
    assert column(name, scenarios, weights) == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=1e-5)


def test_other_values_are_those_of_a_rebuilt_plant():
    scenarios, actions, weights = given()
    values = {"control.inertia_constant_s": 3.5, "machines.1.governor.droop_pu": 0.03}
    rebuilt = Tape(dataclasses.replace(SETTINGS, plant=with_parameters(PLANT, values)), NUM_ENVS, 1, tuple(KNOWN))
    tape().set_parameters(values)
    assert tape().parameter_values() == {**KNOWN, **values}
    with pytest.raises(ValueError, match="start"):
        tape().step(actions[0])
    for own in (tape(), rebuilt):
        own.play(scenarios, actions)
    assert np.array_equal(tape().back(None, weights)[2], rebuilt.back(None, weights)[2])
    tape().set_parameters({name: KNOWN[name] for name in values})


@pytest.mark.parametrize(("call", "reason"), BAD)
def test_bad_input_is_refused(call, reason):
    with pytest.raises(ValueError, match=reason):
        call()
