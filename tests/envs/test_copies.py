"""Facts about copies: pickles, deep copies and snapshots go on bit for bit."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import MODES, actions_of, calm, eventful, n_resets, single_steps, vector_steps
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.physics.scenario import LoadStep

#: For the four groups of version v1; v0 takes the first four columns.
BEFORE, AFTER, OTHER = (actions_of(seed, n, 17, 8) for seed, n in ((20, 13), (21, 60), (22, 25)))
DELAYED = {"version": "v1", "sensors": {"delay_s": (0.3, 0.9)}}
SETTINGS: list[dict[str, Any]] = [
    {"version": "v0", "suite": "gust"},
    {**DELAYED, "suite": "faults", "observation_mode": "privileged"},
]


def copies(env: Any) -> list[Any]:
    return [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]


def steps_of(env: Any, actions: np.ndarray, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **reset: Any) -> list[Any]:
    """Return the steps of a single environment in a list of one, or of every lane of a batch."""
    if isinstance(env, GFMWTGEnv):
        return [single_steps(env, actions[:, 0, : env.action_space.shape[0]], mode, **reset)]
    return vector_steps(env, actions[:, : env.num_envs, : env.single_action_space.shape[0]], **reset)


@pytest.mark.parametrize("mode", [None, *MODES])
@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_copies_of_a_running_environment_go_on_alike_through_later_resets(settings, mode):
    given = {"duration_s": 2.0, **settings}
    env: Any = GFMWTGEnv(**given) if mode is None else GFMWTGVectorEnv(17, autoreset_mode=mode, **given)
    steps_of(env, BEFORE, seed=3)
    twins = copies(env)
    one = steps_of(env, AFTER)
    assert min(n_resets(steps) for steps in one) >= 2
    for twin in twins:
        assert one == steps_of(twin, AFTER)
        assert mode is None or twin.lanes.simulator.blocks.ctypes.data % 64 == 0, "blocks begin at a cache line"


MANY_EVENTS = calm(events=tuple(LoadStep(time_s=0.1 * n, bus=3, power_mw=2.0) for n in range(1, 31))).to_dict()


@pytest.mark.parametrize("n_lanes", [None, 17])
def test_snapshot_branches_as_often_as_asked_whatever_is_played_between(n_lanes):
    # With a fixed scenario a branch may cross its end: nothing is drawn.
    given = {"scenario": eventful().to_dict(), "version": "v0"}
    env, twin = (GFMWTGEnv(**given) if n_lanes is None else GFMWTGVectorEnv(n_lanes, **given) for _ in range(2))
    for each in (env, twin):
        steps_of(each, BEFORE, seed=3)
    start, branches = pickle.loads(pickle.dumps(env.snapshot())), []
    for actions in (AFTER, OTHER, AFTER, OTHER):
        env.restore(start)
        branches.append(steps_of(env, actions))
        env.reset(options={"scenario": MANY_EVENTS} if n_lanes is None else {"scenarios": [MANY_EVENTS] * n_lanes})
    assert branches[0] == branches[2] and branches[1] == branches[3] and branches[0][0][:25] != branches[1][0]
    assert branches[0] == steps_of(twin, AFTER)
    twin.restore(start)
    assert branches[0] == steps_of(twin, AFTER)


def test_snapshot_leaves_the_stream_of_scenarios_alone_and_keeps_what_is_on_its_way_to_the_controllers():
    env, twin = (GFMWTGEnv(**DELAYED, control_dt=0.1, duration_s=4.0, suite="faults") for _ in range(2))
    for each in (env, twin):
        steps_of(each, BEFORE, seed=3)
    start = env.snapshot()
    expected = steps_of(env, AFTER[:27])
    env.reset()
    env.restore(start)
    assert steps_of(env, AFTER[:27]) == expected == steps_of(twin, AFTER[:27])
    twin.reset()
    assert env.reset()[1]["scenario_seed"] == twin.reset()[1]["scenario_seed"]


def test_batch_snapshot_keeps_lanes_that_wait_for_their_reset():
    env = GFMWTGVectorEnv(3, duration_s=4.0, version="v0")
    start = {"scenarios": [eventful(duration_s=1.0), calm(), calm()]}
    vector_steps(env, BEFORE[:10, :3, :4], seed=3, start=start)
    snapshot = env.snapshot()
    for _ in range(2):
        _, rewards, *_, infos = env.step(np.ones((3, 4)))
        assert rewards[0] == 0.0 and infos["time_s"].tolist() == pytest.approx([0.0, 1.1, 1.1])
        env.restore(snapshot)
