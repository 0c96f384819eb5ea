"""Facts about what training measures."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from agents.gains import Gains, law_costs, stagger, stratum_costs, stratum_scales
from agents.multi_agent import GainVecEnv
from wtg_gym.envs import EnvSettings, GFMWTGVectorEnv
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.sb3 import SB3VecEnv
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import V1

ENV_ID = "GFMWTG-14bus-v0"


def reference_cost(seed: int) -> float:
    env = gym.make(ENV_ID, duration_s=2.0)
    env.reset(options={"scenario": get_suite("standard").scenario(seed, n_turbines=[10.0, 10.0], duration_s=2.0)})
    total = 0.0
    for _ in range(20):
        total -= float(env.step(np.zeros(4, np.float32))[1])
    return total


def test_gain_is_the_share_of_the_reference_cost_that_is_saved() -> None:
    env, plain = GainVecEnv(3, duration_s=2.0, version="v0"), SB3VecEnv(3, duration_s=2.0, version="v0")
    for each in (env, plain):
        each.seed(11)
    plain.reset()
    assert np.array_equal(env.reset(), stagger(plain.vector_env))
    rng = np.random.default_rng(0)
    gain = {lane: 0.0 for lane in range(3)}
    cost, seeds, n_ended = dict(gain), plain.vector_env.lanes.scenario_seeds.copy(), 0
    for _ in range(50):
        actions = rng.uniform(-1.0, 1.0, (3, 4)).astype(np.float32)
        for each in (env, plain):
            each.step_async(actions)
        (observations, gains, dones, _), (same, rewards, same_dones, _) = env.step_wait(), plain.step_wait()
        assert np.array_equal(observations, same) and np.array_equal(dones, same_dones)
        for lane in range(3):
            gain[lane] += float(gains[lane])
            cost[lane] -= float(rewards[lane])
            if dones[lane]:
                # The first episode of a lane is what spreading has left of it.
                if n_ended >= 3:
                    reference = reference_cost(int(seeds[lane]))
                    assert gain[lane] == pytest.approx(100.0 * (reference - cost[lane]) / (reference + 5.0), abs=1e-3)
                gain[lane], cost[lane], n_ended = 0.0, 0.0, n_ended + 1
        seeds = plain.vector_env.lanes.scenario_seeds.copy()
    assert n_ended >= 6
    env.close()
    plain.close()


def test_failure_forfeits_what_the_reference_would_still_have_paid() -> None:
    # Power point tracking survives this scenario of the training split, and stalls at full positive action.
    arguments: dict[str, Any] = {"version": "v0", "strategy": "mppt", "duration_s": 30.0}
    env = GFMWTGVectorEnv(1, autoreset_mode="SameStep", n_threads=1, **arguments)
    env.reset(seed=522)
    gains, total, cost, n_steps, failed = Gains(env.lanes), 0.0, 0.0, 0, False
    (scenario,) = env.lanes.scenarios(env.lanes.scenario_seeds.tolist())
    gains.follow([0])
    while not failed:
        before = gains.reference_costs()
        _, rewards, terminated, truncated, _ = env.step(np.ones((1, 4), np.float32))
        total += float(gains.of(before, rewards)[0])
        cost, n_steps, failed = cost - float(rewards[0]), n_steps + 1, bool(terminated[0])
        assert not truncated[0]
    # The reference is the law that scores 100, not the zero action of this environment.
    single = gym.make(ENV_ID, duration_s=30.0)
    single.reset(options={"scenario": scenario})
    paid = [-float(single.step(np.zeros(4, np.float32))[1]) for _ in range(300)]
    scale = 100.0 / (sum(paid) + 5.0)
    assert n_steps < 300 and total == pytest.approx(scale * (sum(paid[:n_steps]) - cost), rel=1e-6)
    # Less than the saving alone, by the rest of the reference's cost.
    assert total == pytest.approx(scale * (sum(paid) - cost) - scale * sum(paid[n_steps:]), rel=1e-6)
    assert sum(paid[n_steps:]) > 0.0 and total < 0.0
    gains.close()
    env.close()


def test_the_reference_plays_sixteen_lanes_as_it_plays_one() -> None:
    settings = EnvSettings(version="v1", strategy="mppt", duration_s=30.0, on_failure="terminate")
    alone, together = TaskLanes(settings, 1), TaskLanes(settings, 16)
    seeds = list(get_suite("standard-v1").train[:20])
    costs = law_costs(together, together.scenarios(seeds))
    assert np.array_equal(costs, [law_costs(alone, alone.scenarios([seed]))[0] for seed in seeds])
    # Some of them fail, after which nothing is paid.
    assert (costs[:, -1] == 0.0).any() and (costs[:, -1] > 0.0).any()


def test_gain_of_v1_is_the_saving_in_scales_of_the_stratum(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(vars(V1), "scores_mean", True)
    env = GFMWTGVectorEnv(3, n_threads=1, version="v1", strategy="mppt", duration_s=10.0)
    env.reset(seed=1)
    gains = Gains(env.lanes)
    gains.follow(range(3))
    references = gains.reference_costs()
    _, rewards, *_ = env.step(np.zeros((3, 8), np.float32))
    scales, suite = stratum_scales(env.lanes.settings), env.lanes.suite
    own = np.array([scales[suite.stratum(int(seed))] for seed in env.lanes.scenario_seeds])
    assert gains.of(references, rewards) == pytest.approx(100.0 * (references + rewards) / own, rel=1e-12)
    gains.close()
    env.close()


def test_scales_are_differences_of_the_anchors_mean_costs() -> None:
    settings = EnvSettings(version="v1", duration_s=10.0)
    zero, hundred = (stratum_costs(settings, law) for law in V1.anchors)
    scales = stratum_scales(settings)
    assert scales == {name: zero[name] - hundred[name] for name in scales} and min(scales.values()) > 0.0
    lanes, name = TaskLanes(EnvSettings(version="v1", strategy=V1.hundred), 30), next(iter(scales))
    own = [seed for seed in lanes.suite.train[:90] if lanes.suite.stratum(seed) == name][:30]
    assert law_costs(lanes, lanes.scenarios(own)).sum(axis=1).mean() == pytest.approx(hundred[name], rel=1e-12)
    # The longer episode of the suite, not that of the settings.
    assert lanes.duration_s > settings.episode_duration_s()
