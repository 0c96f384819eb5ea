"""The battery of docs/howto: equilibrium, equal bits in a batch, limits, gradient, copies."""

from __future__ import annotations

import copy
import dataclasses
import importlib.util
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.physics.extended import largest_rate, scenario
from wtg_gym import GFMWTGEnv, LoadStep, Plant, Scenario
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.gradients import Tape, check_by_differences
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.trajectory import record
from wtg_gym.tasks.cost import COST_TERMS

STEP = scenario(LoadStep(time_s=1.0, bus=9, power_mw=60.0), duration_s=20.0)
WITHOUT = EnvSettings(version="v0", duration_s=20.0)
BAD = [
    (lambda b: {"systems": {"setle": (b.settle,)}}, "unknown places .*'setle'.*; did you mean 'settle'"),
    (lambda b: {"systems": {"plan": (b.settle,)}}, "batteries have no systems for settle, voltages, move, rates"),
    (lambda b: {"impedances": (0j,)}, "impedances of batteries must be finite and not 0 p.u."),
    (lambda b: {"reactive_weights": (0.1, 0.2)}, "1 batteries need 1 reactive_weights, got 2"),
    (lambda b: {"constants": {}}, r"batteries have the constants \['battery'\], got \[\]"),
    (lambda b: {"shown": "sen"}, "'sen' is no record in scratch of batteries; did you mean 'seen'"),
]


@pytest.fixture(scope="module")
def battery():
    """The module that the page asks its reader to save."""
    path = Path(__file__).parents[2] / "docs/howto/battery.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def settings(battery, **options) -> EnvSettings:
    return dataclasses.replace(WITHOUT, plant={"devices": (battery.batteries(9, 14, **options),)})


def played(settings: EnvSettings, num_envs: int = 1, n_steps: int = 60, step: Scenario = STEP) -> EnvBatch:
    batch = EnvBatch(settings, num_envs)
    batch.start(list(range(num_envs)), [step] * num_envs)
    for _ in range(n_steps):
        batch.step(np.zeros((num_envs, batch.n_action)))
    return batch


def test_it_starts_in_equilibrium_holds_up_the_frequency_and_its_wear_is_charged(battery):
    assert largest_rate(played(settings(battery), n_steps=0).simulator) < 1e-9
    own, without = played(settings(battery)), played(WITHOUT)
    with_them, alone = (batch.simulator.env_values("coi_min")[0] for batch in (own, without))
    assert 1.0 > with_them > alone + 1e-4
    places = [own.observation_names.index(f"batteries{j}.energy_left") for j in range(2)]
    energy = own.observations[0, places]
    assert (energy < 0.5).all() and (energy > 0.4).all()
    effort = COST_TERMS.index("effort")
    assert own.cost_sums()[0, effort] > 0.0 == without.cost_sums()[0, effort]
    again = played(settings(battery), n_steps=0)
    states = record(again.simulator, lambda _: again.step(np.zeros((1, again.n_action))))["states"]
    assert states["batteries0.energy"][0] == 0.5
    last = [states[f"batteries{j}.energy"][-1] for j in range(2)]
    assert last == pytest.approx(again.observations[0, places].tolist(), rel=1e-6)


@pytest.mark.parametrize("version", ["v0", "v1"])
def test_an_environment_takes_it_beside_the_suites_groups(battery, version):
    env = GFMWTGEnv(version=version, plant={"devices": (battery.batteries(9, 14),)}, duration_s=20.0)
    usual = GFMWTGEnv(version=version, duration_s=20.0)
    last = [f"batteries{j}.{name}" for j in range(2) for name in ("power", "energy_left")]
    assert env.observation_names == [*usual.observation_names, *last]
    observation, _ = env.reset(seed=0)
    assert observation[-4:] == pytest.approx([0.0, 0.5, 0.0, 0.5], abs=1e-9)
    for _ in range({"v0": 100, "v1": 20}[version]):
        observation, *_ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    assert env.observation_space.contains(observation) and observation[-3] != 0.5


def test_many_envs_and_copies_from_another_process_have_the_bits_of_one(battery):
    one, many = played(settings(battery)), played(settings(battery), 17)
    copies = pickle.loads(pickle.dumps(many)), copy.deepcopy(many)
    for _ in range(10):
        for batch in (one, many, *copies):
            batch.step(np.zeros((batch.num_envs, batch.n_action)))
    for batch in (many, *copies):
        assert (batch.observations == one.observations).all() and (batch.rewards == one.rewards[0]).all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("options", "limit"), [({"droop": 5e-4}, 1.0), ({"energy_time_s": 3.0}, 0.0)])
def test_its_power_rests_at_its_rating_and_at_nothing_when_empty_or_full_at_any_step(battery, options, limit, sign):
    usual = settings(battery, **options)
    fine = dataclasses.replace(usual, plant={**usual.plant, "simulation_dt": 0.005})
    step = scenario(LoadStep(time_s=1.0, bus=9, power_mw=60.0 * sign), duration_s=20.0)
    (power, energy, *_), exact = (played(each, n_steps=190, step=step).observations[0, -4:] for each in (usual, fine))
    assert (power, energy) == pytest.approx(tuple(exact[:2]), abs=1e-3)
    assert power == pytest.approx(sign * limit, abs=0.01)
    assert energy == pytest.approx(0.5 - 0.5 * sign, abs=0.02) if limit == 0.0 else sign * (0.5 - energy) > 0.01


def test_its_gradient_is_that_of_differences(battery):
    tape = Tape(settings(battery), 2, 1)
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 2, tape.batch.n_action))
    (of_actions, *_) = check_by_differences(tape, [STEP, STEP], actions)
    assert of_actions.gradient == pytest.approx(of_actions.central, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(("changes", "reason"), BAD)
def test_bad_units_are_refused(battery, changes, reason):
    with pytest.raises(ValueError, match=reason):
        dataclasses.replace(battery.batteries(9), **changes(battery))


def test_plants_that_cannot_be_are_refused(battery):
    with pytest.raises(ValueError, match="batteries cannot see costs: there are none here, as in `simulate`"):
        Simulator(Plant(devices=(battery.batteries(9, 14),)), duration_s=1.0)
    one, other = battery.batteries(9), battery.batteries(14)
    with pytest.raises(ValueError, match="units of a kind 'batteries' already"):
        EnvBatch(dataclasses.replace(WITHOUT, plant=Plant(devices=(one, other))))
    with pytest.raises(ValueError, match=r"unknown conditions \['wears'\]"):
        EnvBatch(dataclasses.replace(WITHOUT, plant=Plant(devices=(dataclasses.replace(one, has=("wears",)),))))
