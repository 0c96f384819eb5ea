"""The reward of version v1: an episode returns its score less 100, whoever plays it."""

import functools
import math

import numpy as np
import pytest

from tests.envs.rollouts import actions_of, calm, eventful
from wtg_gym import GFMWTGEnv, GFMWTGVectorEnv, LoadStep, Scenario, get_suite
from wtg_gym.tasks import V1

SUITE = get_suite("standard-v1")
N_STEPS = 60
SHORT = {"version": "v1", "duration_s": 30.0}
#: All load but a third is lost: the frequency passes its upper limit.
BLACKOUT = calm(n_wtg=4, duration_s=30.0, events=(LoadStep(time_s=12.3, bus=3, power_mw=-150.0),), inertia_scale=0.3)
ZERO, RANDOM = np.zeros((N_STEPS, 8)), actions_of(4, N_STEPS, n_action=8)[:, 0]


def drawn(seed: int) -> Scenario:
    """Return a scenario of the test split, cut, whose margin follows from what is left."""
    return SUITE.scenario(seed, duration_s=30.0)


CASES = {
    "ample": ({"strategy": "mppt"}, drawn(20_001), ZERO, 40.0),
    "tight": ({}, drawn(20_002), RANDOM, 200.0),
    "short": ({"action_mode": "k", "weights": {"duty": 1.0}}, drawn(20_000), RANDOM[:, :4], 1000.0),
    "of one's own": ({}, eventful(n_wtg=4), RANDOM, 1000.0),
    "blackout": ({"strategy": "coordinated-piecewise"}, BLACKOUT, ZERO, 40.0),
    "v0": ({"version": "v0", "reward": "score"}, eventful(), RANDOM[:, :4], 5.0),
}


def costs(settings, scenario: Scenario, actions: np.ndarray) -> np.ndarray:
    """Return what an episode has cost up to each step, by the environment whose reward is the cost."""
    env = GFMWTGEnv(scenario=scenario, **{**SHORT, **settings, "reward": "cost"})
    env.reset()
    return np.cumsum([-reward for _, reward, *_ in steps(env, actions)])


def tuned(settings):
    """Return settings with the law that scores 100."""
    return {**settings, "strategy": "coordinated-piecewise" if settings.get("version") == "v0" else "coordinated-tuned"}


def steps(env: GFMWTGEnv, actions: np.ndarray):
    taken = []
    for action in actions:
        taken.append(env.step(action))
        if taken[-1][2] or taken[-1][3]:
            break
    return taken


@functools.cache
def played(name: str) -> tuple[list[float], bool]:
    settings, scenario, actions, _ = CASES[name]
    env = GFMWTGEnv(scenario=scenario, **{**SHORT, **settings})
    env.reset()
    taken = steps(env, actions)
    return [step[1] for step in taken], taken[-1][2]


@pytest.mark.parametrize("name", CASES)
def test_an_episode_returns_its_score_less_a_hundred(name):
    settings, scenario, actions, offset = CASES[name]
    rewards, failed = played(name)
    paid = costs(settings, scenario, actions)
    hundred = costs(tuned(settings), scenario, 0.0 * actions)
    # v0 has no scale of its own.
    points = 100.0 / (V1.scale or 1.0) if name != "v0" else 100.0
    assert failed == (name == "blackout") and len(rewards) == len(paid) <= len(hundred)
    # Up to every step but the last, which makes up for the logarithm.
    expected = points * (hundred[: len(paid)] - paid) / (hundred[-1] + offset)
    expected[-1] = points * math.log((hundred[-1] + offset) / (paid[-1] + offset))
    assert np.cumsum(rewards) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_an_episode_that_is_cut_returns_what_it_is_worth_so_far():
    settings, scenario, actions, offset = CASES["tight"]
    env = GFMWTGVectorEnv(2, max_episode_steps=7, scenario=scenario, **SHORT)
    env.reset()
    total = np.zeros(2)
    for step in range(1, 8):
        _, rewards, _, truncated, _ = env.step(np.tile(actions[step - 1], (2, 1)))
        total += rewards
    assert truncated.all()
    own, hundred = (costs(given, scenario, a)[6] for given, a in ((settings, actions), (tuned(settings), ZERO)))
    assert total == pytest.approx(100.0 / V1.scale * math.log((hundred + offset) / (own + offset)), rel=1e-9)
    # The step that resets it returns nothing.
    assert not env.step(np.ones((2, 8)))[1].any()


@pytest.mark.parametrize("n_lanes", [1, 33])
def test_the_law_that_scores_a_hundred_returns_nothing_and_others_what_they_return_alone(n_lanes):
    settings = {**SHORT, "autoreset_mode": "SameStep", "n_threads": 2}
    env = GFMWTGVectorEnv(n_lanes, strategy="coordinated-tuned", **settings)
    env.reset(seed=3)
    assert not any(env.step(np.zeros((n_lanes, 8)))[1].any() for _ in range(2 * N_STEPS))
    env.close()
    env = GFMWTGVectorEnv(n_lanes, **settings)
    scenarios = [CASES[("tight", "of one's own")[lane % 2]][1] for lane in range(n_lanes)]
    env.reset(options={"scenarios": scenarios})
    rewards = np.array([env.step(np.tile(action, (n_lanes, 1)))[1] for action in RANDOM])
    for lane, scenario in enumerate(scenarios):
        name = ("tight", "of one's own")[lane % 2]
        expected = played(name)[0]
        assert rewards[: len(expected), lane].tolist() == expected, (lane, scenario.name)
    env.close()
