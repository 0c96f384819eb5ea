"""Facts about randomness: one generator per environment, from the seed."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import actions_of, eventful, single_steps
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.scenarios import SPLITS, SUITES, get_suite

ACTIONS = actions_of(30, 60)[:, 0]


def test_same_seed_gives_the_same_episodes_one_after_the_other():
    env, fresh = (GFMWTGEnv(duration_s=2.0, version="v0") for _ in range(2))
    first, again, other = (single_steps(own, ACTIONS, AutoresetMode.NEXT_STEP, seed=5) for own in (env, env, fresh))
    assert first == again == other
    streams = [[own.reset(seed=seed)[1]["scenario_seed"] for seed in (5, *[None] * 9)] for own in (env, fresh)]
    assert streams[0] == streams[1] and len(set(streams[0])) == 10


def test_environments_without_a_seed_differ():
    assert len({GFMWTGEnv(duration_s=2.0, version="v0").reset()[1]["scenario_seed"] for _ in range(5)}) == 5
    batch = GFMWTGVectorEnv(5, duration_s=2.0, version="v0")
    seen = np.concatenate([batch.reset()[1]["scenario_seed"], batch.reset()[1]["scenario_seed"]])
    assert len(set(seen.tolist())) == 10


@pytest.mark.parametrize("suite", SUITES)
def test_scenarios_come_from_the_asked_split_alone_which_is_train_by_default(suite):
    for split in SPLITS:
        asked = {"suite": suite} if split == "train" else {"suite": suite, "split": split}
        batch, env = GFMWTGVectorEnv(5, duration_s=2.0, **asked), GFMWTGEnv(duration_s=2.0, **asked)
        drawn = [*batch.reset(seed=1)[1]["scenario_seed"], *(env.reset()[1]["scenario_seed"] for _ in range(5))]
        assert all(int(seed) in get_suite(suite).seeds(split) for seed in drawn)


def test_fixed_scenario_is_the_same_in_every_episode_and_tells_its_seed():
    env = GFMWTGEnv(scenario=eventful().to_dict(), duration_s=4.0, version="v0")
    starts = [env.reset(seed=seed) for seed in (1, 2, None)]
    assert len({observation.tobytes() for observation, _ in starts}) == 1
    assert [info["scenario_seed"] for _, info in starts] == [-1] * 3
    env = GFMWTGEnv(scenario=eventful(seed=77).to_dict(), version="v0")
    assert env.reset()[1]["scenario_seed"] == 77
