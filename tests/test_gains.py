"""Facts about what training measures."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from wtg_gym.envs import EnvSettings, GFMWTGVectorEnv
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.gains import GainEnvs, Gains, law_costs, stagger, stratum_scales
from wtg_gym.sb3 import SB3VecEnv
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks import V1

ENV_ID = "GFMWTG-14bus-v0"


def reference_cost(seed: int) -> float:
    env = gym.make(ENV_ID, duration_s=2.0)
    env.reset(options={"scenario": get_suite("standard").scenario(seed, n_turbines=[10.0, 10.0], duration_s=2.0)})
    total = 0.0
    for _ in range(20):
        total -= float(env.step(np.zeros(4, np.float32))[1])
    return total


def test_gain_is_the_share_of_the_reference_cost_that_is_saved() -> None:
    env, plain = SB3VecEnv(3, gains=True, duration_s=2.0, version="v0"), SB3VecEnv(3, duration_s=2.0, version="v0")
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


def test_gain_of_v1_is_the_share_of_the_reference_cost_that_is_saved_in_scales_of_the_stratum(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scales, offsets = {"ordinary": 0.2, "large": 0.5, "extreme": 0.25}, dict(V1.cost_offsets)
    monkeypatch.setattr("wtg_gym.gains.stratum_scales", lambda _settings: scales)
    env = GFMWTGVectorEnv(6, n_threads=1, version="v1", strategy="mppt", duration_s=10.0)
    env.reset(seed=1)
    gains, seeds = Gains(env.lanes), env.lanes.scenario_seeds.tolist()
    gains.follow(range(6))
    references = gains.reference_costs()
    _, rewards, *_ = env.step(np.zeros((6, 8), np.float32))
    hundred = TaskLanes(EnvSettings(version="v1", strategy="coordinated-tuned", duration_s=10.0), 6)
    paid, strata = law_costs(hundred, env.lanes.scenarios(seeds)), [env.lanes.suite.stratum(seed) for seed in seeds]
    assert np.array_equal(references, paid[:, 0]) and len(set(strata)) > 1
    sizes = paid.sum(axis=1) + [offsets[name] for name in strata]
    own = np.array([scales[name] for name in strata])
    assert gains.of(references, rewards) == pytest.approx(100.0 * (references + rewards) / sizes / own, rel=1e-12)
    # A step costs no more than five times what the reference's episode does.
    assert gains.of(references, rewards - 1e5) == pytest.approx(-500.0 / own, rel=1e-12)
    gains.close()
    env.close()


def test_scales_are_those_of_the_score() -> None:
    assert stratum_scales(EnvSettings(version="v1")) == dict.fromkeys(("ordinary", "large", "extreme"), V1.scale)


def test_gains_go_around_the_native_batch_of_any_library() -> None:
    arguments: dict[str, Any] = {"num_envs": 2, "duration_s": 2.0, "autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    envs, own = GainEnvs(gym.make_vec(ENV_ID, **arguments)), SB3VecEnv(2, gains=True, version="v0", duration_s=2.0)
    own.seed(3)
    assert np.array_equal(envs.reset(seed=[3, 4])[0], own.reset())
    actions = np.full(envs.action_space.shape, 0.5, np.float32)
    for _ in range(25):
        _, gains, *_ = envs.step(actions)
        assert np.array_equal(gains.astype(np.float32), own.step(actions)[1]) and (gains != 0.0).all()


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ({"autoreset_mode": gym.vector.AutoresetMode.DISABLED}, None, "start again by themselves"),
        ({"scenario": get_suite("standard").scenario(10_000)}, None, "scenarios of a suite"),
        ({}, {"reset_mask": [True, False]}, "no reset options"),
    ],
)
def test_gains_refuse_lanes_that_they_cannot_follow(arguments: Any, options: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GainEnvs(gym.make_vec(ENV_ID, num_envs=2, **arguments)).reset(options=options)


def test_gains_refuse_what_is_wrapped() -> None:
    with pytest.raises(ValueError, match="native batch alone"):
        GainEnvs(gym.wrappers.vector.NormalizeReward(gym.make_vec(ENV_ID, num_envs=2)))
