"""Facts about randomness: one generator per environment, from the seed."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import actions_of, eventful, single_steps
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.scenarios import SPLITS, SUITES, get_suite

ACTIONS = actions_of(30, 60)[:, 0]


def test_same_seed_gives_the_same_episodes():
    env = GFMWTGEnv(duration_s=2.0, version="v0")
    first = single_steps(env, ACTIONS, AutoresetMode.NEXT_STEP, seed=5)
    again = single_steps(env, ACTIONS, AutoresetMode.NEXT_STEP, seed=5)
    fresh = single_steps(GFMWTGEnv(duration_s=2.0, version="v0"), ACTIONS, AutoresetMode.NEXT_STEP, seed=5)
    assert first == again == fresh


def test_reset_without_a_seed_goes_on_with_the_stream():
    env, twin = (GFMWTGEnv(duration_s=2.0, version="v0") for _ in range(2))
    stream = [env.reset(seed=5)[1]["scenario_seed"], *(env.reset()[1]["scenario_seed"] for _ in range(9))]
    assert len(set(stream)) == 10
    assert [twin.reset(seed=5)[1]["scenario_seed"], *(twin.reset()[1]["scenario_seed"] for _ in range(9))] == stream


def test_environments_without_a_seed_differ():
    assert len({GFMWTGEnv(duration_s=2.0, version="v0").reset()[1]["scenario_seed"] for _ in range(5)}) == 5
    batch = GFMWTGVectorEnv(5, duration_s=2.0, version="v0")
    seen = np.concatenate([batch.reset()[1]["scenario_seed"], batch.reset()[1]["scenario_seed"]])
    assert len(set(seen.tolist())) == 10


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("suite", SUITES)
def test_scenarios_come_from_the_asked_split_alone_which_is_train_by_default(suite: str, split: str):
    seeds = get_suite(suite).seeds(split)
    asked = {"suite": suite} if split == "train" else {"suite": suite, "split": split}
    batch = GFMWTGVectorEnv(5, duration_s=2.0, **asked)
    assert all(int(seed) in seeds for seed in batch.reset(seed=1)[1]["scenario_seed"])
    env = GFMWTGEnv(duration_s=2.0, **asked)
    assert all(env.reset()[1]["scenario_seed"] in seeds for _ in range(5))


def test_drawn_scenario_is_the_suites_own():
    env, twin = GFMWTGEnv(version="v0"), GFMWTGEnv(version="v0")
    observation, info = env.reset(seed=2)
    scenario = get_suite("standard").scenario(info["scenario_seed"])
    again, other = twin.reset(options={"scenario": scenario})
    assert again.tobytes() == observation.tobytes() and other == info
    for action in ACTIONS:
        assert env.step(action)[0].tobytes() == twin.step(action)[0].tobytes()


def test_fixed_scenario_is_the_same_in_every_episode_and_tells_its_seed():
    env = GFMWTGEnv(scenario=eventful().to_dict(), duration_s=4.0, version="v0")
    starts = [env.reset(seed=seed) for seed in (1, 2, None)]
    assert len({observation.tobytes() for observation, _ in starts}) == 1
    assert [info["scenario_seed"] for _, info in starts] == [-1] * 3
    env = GFMWTGEnv(scenario=eventful(seed=77).to_dict(), version="v0")
    assert env.reset()[1]["scenario_seed"] == 77
