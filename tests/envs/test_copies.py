"""Facts about copies: pickles, deep copies and snapshots go on bit for bit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import MODES, actions_of, calm, eventful, n_resets, sagging, single_steps, vector_steps
from wtg_gym import ENV_IDS
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.physics.scenario import LoadStep

BEFORE = actions_of(20, 13, 33)
AFTER = actions_of(21, 60, 33)
#: For the four groups of version v1.
BEFORE_V1, AFTER_V1 = actions_of(20, 13, 33, 8), actions_of(21, 60, 33, 8)
OTHER = actions_of(22, 25, 33)

COPIES = pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deepcopy", "pickle"]
)
Copy = Callable[[Any], Any]


@COPIES
@pytest.mark.parametrize("settings", [{}, {"observation_mode": "privileged"}, {"suite": "gust"}])
def test_copy_of_a_running_environment_goes_on_alike_through_later_resets(copied: Copy, settings: dict):
    env = GFMWTGEnv(**{"version": "v0", "duration_s": 2.0, **settings})
    single_steps(env, BEFORE[:, 0], AutoresetMode.NEXT_STEP, seed=3)
    twin = copied(env)
    one = single_steps(env, AFTER[:, 0], AutoresetMode.NEXT_STEP)
    assert one == single_steps(twin, AFTER[:, 0], AutoresetMode.NEXT_STEP)
    assert n_resets(one) == 3


@COPIES
@pytest.mark.parametrize("settings", [{}, {"suite": "faults", "observation_mode": "privileged"}])
def test_copies_of_version_v1_go_on_alike_with_what_is_on_its_way_to_the_controllers(copied: Copy, settings: dict):
    given = {"version": "v1", "duration_s": 2.0, "sensors": {"delay_s": (0.3, 0.9)}, **settings}
    env, batch = GFMWTGEnv(**given), GFMWTGVectorEnv(17, **given)
    single_steps(env, BEFORE_V1[:, 0], AutoresetMode.NEXT_STEP, seed=3)
    vector_steps(batch, BEFORE_V1[:, :17], seed=3)
    twin, other = copied(env), copied(batch)
    one = single_steps(env, AFTER_V1[:, 0], AutoresetMode.NEXT_STEP)
    assert one == single_steps(twin, AFTER_V1[:, 0], AutoresetMode.NEXT_STEP) and n_resets(one) == 3
    assert vector_steps(batch, AFTER_V1[:, :17]) == vector_steps(other, AFTER_V1[:, :17])


@COPIES
def test_copy_before_the_first_reset_and_after_the_end_behaves_as_its_original(copied: Copy):
    env = GFMWTGEnv(duration_s=1.0, version="v0")
    with pytest.raises(RuntimeError):
        copied(env).step(np.zeros(4))
    single_steps(env, BEFORE[:10, 0], AutoresetMode.DISABLED, seed=1)
    twin = copied(env)
    assert single_steps(env, AFTER[:, 0], AutoresetMode.DISABLED) == single_steps(
        twin, AFTER[:, 0], AutoresetMode.DISABLED
    )


@COPIES
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("n_lanes", [1, 17])
def test_copy_of_a_running_batch_goes_on_alike_through_later_resets(n_lanes: int, mode: AutoresetMode, copied: Copy):
    env = GFMWTGVectorEnv(n_lanes, duration_s=2.0, autoreset_mode=mode, version="v0")
    vector_steps(env, BEFORE[:, :n_lanes], seed=3)
    twin = copied(env)
    one = vector_steps(env, AFTER[:, :n_lanes])
    assert one == vector_steps(twin, AFTER[:, :n_lanes])
    assert all(n_resets(steps) >= 2 for steps in one)


@COPIES
def test_copy_of_a_batch_on_several_threads_goes_on_alike(copied: Copy):
    actions = actions_of(23, 15, 160)
    env = GFMWTGVectorEnv(160, duration_s=1.0, n_threads=2, version="v0")
    vector_steps(env, actions, seed=3)
    twin = copied(env)
    assert vector_steps(env, actions) == vector_steps(twin, actions)
    env.close(), twin.close()


@COPIES
@pytest.mark.parametrize("env_id", ENV_IDS)
def test_wrapped_environment_can_be_copied(copied: Copy, env_id: str):
    env = gym.make(env_id, duration_s=2.0)
    env.reset(seed=1)
    action = np.full(env.action_space.shape, 0.5, dtype=np.float32)
    env.step(0.0 * action)
    twin = copied(env)
    for _ in range(19):
        (a, x, *ends, _), (b, y, *other, _) = env.step(action), twin.step(action)
        assert a.tobytes() == b.tobytes() and x == y and ends == other
    assert env.reset()[0].tobytes() == twin.reset()[0].tobytes()


def test_snapshot_branches_as_often_as_asked_and_each_branch_equals_going_on_without_it():
    env, twin = (GFMWTGEnv(scenario=eventful().to_dict(), version="v0") for _ in range(2))
    for each in (env, twin):
        single_steps(each, BEFORE[:, 0], AutoresetMode.NEXT_STEP, seed=3)
    start, branches = env.snapshot(), []
    for actions in (AFTER[:27, 0], OTHER[:, 0], AFTER[:27, 0], OTHER[:, 0]):
        env.restore(start)
        branches.append(single_steps(env, actions, AutoresetMode.NEXT_STEP))
    assert branches[0] == branches[2] and branches[1] == branches[3] and branches[0][:25] != branches[1]
    assert branches[0] == single_steps(twin, AFTER[:27, 0], AutoresetMode.NEXT_STEP)


def many_events() -> dict:
    events = tuple(LoadStep(time_s=0.1 * n, bus=3, power_mw=2.0) for n in range(1, 31))
    return calm(events=events).to_dict()


@pytest.mark.parametrize("between", [{"seed": 8}, {"options": {"scenario": many_events()}}], ids=["drawn", "events"])
def test_snapshot_survives_a_reset_in_between(between: dict):
    env = GFMWTGEnv(duration_s=4.0, version="v0")
    single_steps(env, BEFORE[:, 0], AutoresetMode.NEXT_STEP, seed=3)
    start = env.snapshot()
    expected = single_steps(env, AFTER[:27, 0], AutoresetMode.NEXT_STEP)
    assert expected[-1][3], "the branch goes to the end of the episode"
    env.reset(**between)
    single_steps(env, OTHER[:, 0], AutoresetMode.NEXT_STEP)
    env.restore(start)
    assert single_steps(env, AFTER[:27, 0], AutoresetMode.NEXT_STEP) == expected
    with pytest.raises(RuntimeError):
        env.step(np.zeros(4))
    env.restore(start)
    assert single_steps(env, AFTER[:27, 0], AutoresetMode.NEXT_STEP) == expected


def test_snapshot_of_v1_keeps_what_is_on_its_way_to_the_controllers():
    env = GFMWTGEnv(version="v1", suite="faults", duration_s=4.0, sensors={"delay_s": (0.9, 0.9)})
    single_steps(env, BEFORE_V1[:, 0], AutoresetMode.NEXT_STEP, seed=3)
    start = env.snapshot()
    expected = single_steps(env, AFTER_V1[:27, 0], AutoresetMode.NEXT_STEP)
    env.reset(seed=8)
    env.restore(start)
    assert single_steps(env, AFTER_V1[:27, 0], AutoresetMode.NEXT_STEP) == expected
    batch = GFMWTGVectorEnv(3, version="v1", suite="faults", duration_s=4.0, sensors={"delay_s": (0.9, 0.9)})
    vector_steps(batch, BEFORE_V1[:, :3], seed=3)
    kept = batch.snapshot()
    branch = vector_steps(batch, AFTER_V1[:27, :3])
    batch.restore(kept)
    assert vector_steps(batch, AFTER_V1[:27, :3]) == branch


def test_snapshot_taken_with_many_events_survives_an_episode_with_few():
    env = GFMWTGEnv(duration_s=4.0, version="v0")
    env.reset(options={"scenario": many_events()})
    start = env.snapshot()
    expected = single_steps(env, AFTER[:40, 0], AutoresetMode.NEXT_STEP)
    env.reset(seed=1)
    env.restore(start)
    assert single_steps(env, AFTER[:40, 0], AutoresetMode.NEXT_STEP) == expected


def test_snapshot_can_be_restored_into_another_environment_and_after_pickling():
    env, other = (GFMWTGEnv(duration_s=4.0, version="v0") for _ in range(2))
    single_steps(env, BEFORE[:, 0], AutoresetMode.NEXT_STEP, seed=3)
    start = pickle.loads(pickle.dumps(env.snapshot()))
    other.restore(start)
    expected = single_steps(env, AFTER[:27, 0], AutoresetMode.NEXT_STEP)
    assert single_steps(other, AFTER[:27, 0], AutoresetMode.NEXT_STEP) == expected


def test_snapshot_leaves_the_stream_of_scenarios_alone():
    env, twin = (GFMWTGEnv(duration_s=2.0, version="v0") for _ in range(2))
    env.reset(seed=3), twin.reset(seed=3)
    env.restore(env.snapshot())
    assert env.reset()[1]["scenario_seed"] == twin.reset()[1]["scenario_seed"]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("n_lanes", [5, 17])
def test_batch_snapshot_branches_bit_for_bit(n_lanes: int, mode: AutoresetMode):
    env = GFMWTGVectorEnv(n_lanes, scenario=eventful().to_dict(), autoreset_mode=mode, version="v0")
    vector_steps(env, BEFORE[:, :n_lanes], seed=3)
    start = env.snapshot()
    # With a fixed scenario the branch may cross its end: nothing is drawn.
    expected = vector_steps(env, AFTER[:, :n_lanes])
    env.restore(start)
    vector_steps(env, OTHER[:, :n_lanes])
    env.reset(options={"scenarios": [many_events()] * n_lanes})
    env.restore(start)
    assert vector_steps(env, AFTER[:, :n_lanes]) == expected


def test_batch_snapshot_keeps_lanes_that_wait_for_their_reset():
    env = GFMWTGVectorEnv(3, strategy="mppt", duration_s=60.0, version="v0")
    short = eventful(duration_s=1.0)
    vector_steps(env, BEFORE[:10, :3], seed=3, start={"scenarios": [short, sagging(), sagging()]})
    start = env.snapshot()
    _, rewards, *_, infos = env.step(np.ones((3, 4)))
    assert rewards[0] == 0.0 and infos["time_s"][0] == 0.0
    env.restore(start)
    _, rewards, *_, infos = env.step(np.ones((3, 4)))
    assert rewards[0] == 0.0 and infos["time_s"][0] == 0.0 and infos["time_s"][1] == pytest.approx(1.1)


TWO_BUSES = {"groups": [{"bus": 2, "n_turbines": 10.0}, {"bus": 3, "n_turbines": 10.0}]}


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (TWO_BUSES, "groups"),
        ({"machine_model": "classical"}, "machine_model"),
        ({"weights": {"duty": 0.0}, "on_failure": "trip"}, "weights, on_failure"),
        ({"strategy": "mppt"}, "strategy"),
        ({"duration_s": 5.0}, "duration_s"),
        ({"version": "v1"}, "strategy, groups, weights, plant, physics, version"),
        ({"suite": "gust", "split": "test"}, None),
    ],
    ids=str,
)
def test_snapshot_is_taken_only_by_an_environment_whose_episodes_go_on_alike(settings: dict, named: str | None):
    env, other = GFMWTGEnv(duration_s=4.0, version="v0"), GFMWTGEnv(**{"version": "v0", "duration_s": 4.0, **settings})
    single_steps(env, BEFORE[:, 0], AutoresetMode.NEXT_STEP, seed=3)
    single_steps(other, (BEFORE_V1 if "version" in settings else BEFORE)[:, 0], AutoresetMode.NEXT_STEP, seed=8)
    before = other.snapshot()
    if named is not None:
        with pytest.raises(ValueError, match=f"of an environment with other settings: {named}$"):
            other.restore(env.snapshot())
        assert pickle.dumps(other.snapshot()) == pickle.dumps(before)
        return
    other.restore(env.snapshot())
    left = AFTER[:27, 0]
    assert single_steps(other, left, AutoresetMode.NEXT_STEP) == single_steps(env, left, AutoresetMode.NEXT_STEP)


def test_what_is_no_snapshot_is_refused():
    single, batch = GFMWTGEnv(duration_s=4.0, version="v0"), GFMWTGVectorEnv(1, duration_s=4.0, version="v0")
    single.reset(seed=1), batch.reset(seed=1)
    for env, other in ((single, batch), (batch, single)):
        for wrong in (None, (1, 2, 3), other.snapshot()):
            with pytest.raises(ValueError, match=rf"snapshot\(\) of a {type(env).__name__} returned, got "):
                env.restore(wrong)


def test_snapshot_of_another_size_is_refused_and_changes_nothing():
    five, three = GFMWTGVectorEnv(5, duration_s=4.0, version="v0"), GFMWTGVectorEnv(3, duration_s=4.0, version="v0")
    vector_steps(five, BEFORE[:, :5], seed=9), vector_steps(three, BEFORE[:, :3], seed=3)
    twin = copy.deepcopy(three)
    with pytest.raises(ValueError):
        three.restore(five.snapshot())
    assert vector_steps(three, AFTER[:20, :3]) == vector_steps(twin, AFTER[:20, :3])
