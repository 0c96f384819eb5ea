"""An action of version v1 is held for 0.5 s: to the bit what five steps of 0.1 s with the same action are."""

from typing import Any

import numpy as np
import pytest

from tests.envs.rollouts import actions_of, calm, eventful
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.physics.scenario import LoadStep
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks.cost import COST, COST_TERMS

N_STEPS, N_HELD = 40, 5
#: The frequency passes its upper limit within a step.
BLACKOUT = calm(n_wtg=4, duration_s=20.0, events=(LoadStep(time_s=7.1, bus=3, power_mw=-150.0),), inertia_scale=0.3)


def state(env: GFMWTGVectorEnv) -> Any:
    """Return all that an environment carries on, but what the last interval cost: after an end that is nothing."""
    simulator = env.lanes.simulator
    return np.delete(simulator.blocks, simulator.layout.first_rows(COST, "cost"), axis=1)


@pytest.mark.parametrize("n_lanes", [1, 3])
@pytest.mark.parametrize(
    ("scenario", "settings"),
    [
        (get_suite("faults-v1").scenario(20_002, duration_s=20.0), {"observation_mode": "privileged"}),
        (eventful(n_wtg=4, duration_s=6.5), {"strategy": "mppt", "action_mode": "tau"}),
        (BLACKOUT, {}),
    ],
    ids=["drawn", "every event", "blackout"],
)
def test_a_step_is_five_intervals_with_its_action(scenario, settings, n_lanes):
    held, fine = (
        GFMWTGVectorEnv(n_lanes, duration_s=20.0, control_dt=dt, reward="cost", n_threads=1, **settings)
        for dt in (None, 0.1)
    )
    for env in (held, fine):
        env.reset(seed=0, options={"scenarios": [scenario] * n_lanes})
    n, within = 0, 0
    for action in actions_of(2, N_STEPS, 1, held.single_action_space.shape[0]).repeat(n_lanes, axis=1):
        observations, rewards, *ends, info = held.step(action)
        shares = []
        for _ in range(N_HELD):
            shares.append(fine.step(action))
            if (shares[-1][2] | shares[-1][3]).any():
                break
        n, within = n + len(shares), len(shares)
        assert observations.tobytes() == shares[-1][0].tobytes()
        assert [end.tolist() for end in ends] == [end.tolist() for end in shares[-1][2:4]]
        assert state(held).tobytes() == state(fine).tobytes()
        # A step costs what its intervals do, term by term, and violates a constraint if one of them does.
        for name in ("cost", *(f"cost_{term}" for term in COST_TERMS)):
            values = [each[4][name] for each in shares]
            assert info[name].tolist() == (np.max(values, axis=0) if name == "cost" else sum(values)).tolist()
        assert rewards.tolist() == sum(each[1] for each in shares).tolist()
        assert -rewards == pytest.approx(sum(info[f"cost_{term}"] for term in COST_TERMS), rel=1e-12)
        assert all(info[name].tolist() == shares[-1][4][name].tolist() for name in ("time_s", "frequency_hz"))
        if any(end.any() for end in ends):
            break
    assert ends[0].any() == (scenario is BLACKOUT) and (within < N_HELD or scenario is not BLACKOUT)
    assert held.lanes.n_steps().tolist() == [-(-n // N_HELD)] * n_lanes
