"""Facts about what a step tells: observation, reward and info."""

import numpy as np
import pytest

from tests.envs.rollouts import ACTION_MODES, VERSIONS, actions_of, episode, eventful
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.tasks.cost import CostWeights

TERMS = [f"cost_{name}" for name in ("duty", "effort", "failure", "frequency", "overload", "rocof", "rotor")]
KEYS = {*TERMS, "time_s", "frequency_hz", "rocof_hz_s", "cost", "scenario_seed", "termination_reason"}


@pytest.mark.parametrize("term", [f"cost_{name}" for name in ("frequency", "rocof", "duty", "rotor", "effort")])
def test_every_weight_scales_its_own_term_alone(term):
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
def test_observations_stay_in_their_space_and_no_entry_is_constant(version, action_mode):
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
