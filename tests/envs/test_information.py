"""Facts about what a step tells: observation, reward and info."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.envs.rollouts import (
    ACTION_MODES,
    VERSIONS,
    actions_of,
    episode,
    eventful,
    rising,
    sagging,
)
from wtg_gym.envs import CostWeights, GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.physics.scenario import Scenario

TERMS = [f"cost_{name}" for name in ("duty", "effort", "failure", "frequency", "overload", "rocof", "rotor")]
KEYS = {*TERMS, "time_s", "frequency_hz", "rocof_hz_s", "cost", "scenario_seed", "termination_reason"}


@pytest.mark.parametrize("scenario", [sagging(), rising(), eventful()], ids=lambda scenario: scenario.name)
@pytest.mark.parametrize("on_failure", ["terminate", "trip"])
def test_info_keeps_its_keys_and_types_and_its_cost_terms_are_never_negative_and_add_up_to_minus_the_reward(
    scenario: Scenario, on_failure: str
):
    env = GFMWTGEnv(strategy="mppt", scenario=scenario.to_dict(), on_failure=on_failure, version="v0")
    types = {key: type(value) for key, value in env.reset(seed=0)[1].items()}
    assert set(types) == KEYS
    for reward, *_, info in episode(env, [1.0, -1.0, -0.5, 1.0], seed=0):
        assert {key: type(value) for key, value in info.items()} == types
        terms = [info[key] for key in TERMS]
        assert min(terms) >= 0.0 and all(math.isfinite(term) for term in terms)
        assert -reward == pytest.approx(sum(terms), rel=1e-12, abs=1e-15)
        assert info["cost"] in (0.0, 1.0)


@pytest.mark.parametrize("term", [f"cost_{name}" for name in ("frequency", "rocof", "duty", "rotor", "effort")])
def test_every_weight_scales_its_own_term_alone(term: str):
    name = term.removeprefix("cost_")
    scenario = eventful(7.0).to_dict()
    default = getattr(CostWeights(), name)
    light, heavy = (
        GFMWTGEnv(scenario=scenario, weights={name: w, "cap": 1e6}, version="v0") for w in (default, 3.0 * default)
    )
    total = 0.0
    for (*_, info), (*_, other) in zip(episode(light, -1.0), episode(heavy, -1.0), strict=True):
        total += info[term]
        assert other[term] == pytest.approx(3.0 * info[term], rel=1e-12)
        assert all(other[key] == info[key] for key in KEYS - {term})
    assert total > 0.0 or name == "rotor"


@pytest.mark.parametrize("action_mode", ACTION_MODES)
@pytest.mark.parametrize("version", VERSIONS)
def test_observations_stay_in_their_space_and_no_entry_is_constant(version: str, action_mode: str):
    modes = {"action_mode": action_mode, "observation_mode": "privileged"}
    env = GFMWTGVectorEnv(5, version=version, duration_s=15.0, **modes)
    n_action = env.single_action_space.shape[0]
    seen = [env.reset(seed=0)[0]]
    for action in actions_of(2, 320, 5, n_action):
        seen.append(env.step(action)[0])
        assert env.observation_space.contains(seen[-1])
    values = np.stack(seen)
    assert values.dtype == np.float32 and np.isfinite(values).all()
    names = env.lanes.observation_names
    assert len(names) == len(set(names)) == values.shape[-1]
    assert all("[" in name or "last_action" in name for name in names)
    spread = np.ptp(values.reshape(-1, values.shape[-1]), axis=0)
    assert [name for name, width in zip(names, spread, strict=True) if width < 1e-4] == []


def test_observation_tells_what_its_names_say():
    scenario = eventful(events=(), load_noise_mw=np.zeros(0))
    env = GFMWTGEnv(scenario=scenario.to_dict(), observation_mode="privileged", version="v0")
    observation, _ = env.reset(seed=0)
    entry = dict(zip(env.observation_names, observation.tolist(), strict=True))
    assert [entry[f"wtg{j}.wind [5 m/s from 10 m/s]"] for j in range(2)] == pytest.approx([-0.2, -0.1])
    still = ("frequency_deviation", "rocof", "filter_state", "speed [0.5 Hz]")
    for name, value in entry.items():
        if any(word in name for word in still):
            assert abs(value) < 1e-6, name
