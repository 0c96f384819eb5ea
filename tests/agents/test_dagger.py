"""Facts about the planner and its pupil: no foresight, plans from where the episode is."""

from dataclasses import replace
from functools import partial

import numpy as np
import torch

from agents import planner as planning
from agents.dagger import DaggerLearner, Hyperparameters, Plans, observe
from agents.gradient import GradientPolicy
from agents.planner import Futures, Planner, PlannerOptions, begun, drive, planned, without_foresight
from agents.run import RunSettings
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.evaluation import evaluate
from wtg_gym.physics.scenario import GroupTrip, LoadRamp, LoadStep

SETTINGS = EnvSettings(suite="standard-v1", strategy="coordinated-free", action_mode="k", reward="cost")
SHORT = replace(SETTINGS, duration_s=20.0)
QUICK = PlannerOptions(horizon_s=10.0, iterations=1)


def test_a_plan_knows_nothing_of_what_comes():
    batch = EnvBatch(SHORT, 1, 1)
    (drawn,) = batch.scenarios([1_000_000])
    drawn = replace(drawn, events=())
    wind, noise = drawn.wind_speed.copy(), drawn.load_noise_mw.copy()
    wind[:, 101:] *= 0.9
    noise[101:] += 5.0
    step = LoadStep(time_s=10.1, bus=4, power_mw=30.0)
    plans = []
    happened = replace(drawn, events=(replace(step, time_s=9.9),))
    for scenario in (drawn, replace(drawn, wind_speed=wind, load_noise_mw=noise, events=(step,)), drawn, happened):
        planner = Planner(SHORT, 1, QUICK)
        planner.start([scenario])
        for _ in range(20):
            planner.take(np.full((1, 4), 0.1))
        plans.append(planner.plan())
    assert np.array_equal(plans[0], plans[1]) and np.array_equal(plans[0], plans[2])
    assert not np.array_equal(plans[0], plans[3])


def test_of_events_it_knows_what_has_passed():
    now, past = LoadStep(time_s=10.0, bus=4, power_mw=30.0), LoadStep(time_s=9.0, bus=4, power_mw=30.0)
    ramps = [LoadRamp(time_s=6.0, bus=4, power_mw=5.0 * s, reactive_mvar=s, duration_s=s) for s in (5.0, 8.0, 3.0)]
    known = [*begun([now, past, *ramps], 10.0)]
    # Two ramps of the same slope are one, until the first ends.
    assert known[0] == past and known[1] == known[2] and known[3] == ramps[2]
    assert (known[1].duration_s, known[1].power_mw, known[1].reactive_mvar) == (4.0, 20.0, 4.0)


def test_futures_go_on_as_other_scenarios_of_the_suite():
    batch = EnvBatch(replace(SETTINGS, duration_s=240.0), 1, 1)
    futures, suite = Futures(batch), batch.suite
    (drawn,) = suite.scenarios([1_000_001])
    known, rng = without_foresight(drawn, 20.0, 60.0), np.random.default_rng(0)
    drawn_futures = [futures.draw(known, 20.0, rng) for _ in range(5)]
    for future in drawn_futures:
        n_past = known.wind_speed.shape[1]
        assert future.events[: len(known.events)] == known.events
        assert np.array_equal(future.wind_speed[:, :n_past], known.wind_speed)
        assert all(event.time_s > 20.0 for event in future.events[len(known.events) :])
        assert suite.margin(future) >= min(low for low, _ in suite.margins.values())
    assert len({future.events for future in drawn_futures}) > 1


def test_it_plans_from_where_the_episode_is_to_its_end():
    batch = EnvBatch(SHORT, 2, 1)
    planner = Planner(SHORT, 2, QUICK)
    actions = drive(planner, batch, batch.scenarios([1_000_000, 1_000_001]))
    assert actions.shape == (40, 2, 4) and batch.ended()[1].all()
    # What futures have of the past is the episode, to the bit.
    planner.start(batch.scenarios([1_000_000, 1_000_001]))
    batch.start(range(2), batch.scenarios([1_000_000, 1_000_001]))
    for taken in actions[:30]:
        batch.step(taken)
        planner.take(taken)
    planner.plan()
    past = planner._episodes.tape.before(0)
    for rows in (batch.simulator.layout.wtg("rotor_speed"), batch.simulator.layout.machine("speed")):
        of_futures = past[:, rows, : 2 * QUICK.futures].reshape(*past[:, rows].shape[:2], 2, -1)
        assert (of_futures == batch.simulator.blocks[:, rows, :2, np.newaxis]).all()


def test_it_costs_less_than_the_law_where_reserves_are_ample(monkeypatch):
    seeds = [10_002, 10_005, 10_008]
    monkeypatch.setattr(planning, "EnvSettings", partial(EnvSettings, duration_s=60.0))
    entry = planned("standard-v1", "coordinated-free", seeds, PlannerOptions(interval_s=30.0, iterations=3))
    results = evaluate([entry, "coordinated-free"], "standard-v1", "validation", seeds=seeds, duration_s=60.0)
    assert results.pinned_costs["planner"].mean() < results.pinned_costs["coordinated-free"].mean()


def test_batches_hold_episodes_of_all_rounds():
    plans = Plans()
    for index in range(3):
        seen = [np.full((2, 4, 6), 10 * index) + np.arange(2)[:, None, None]] * 5
        plans.add(seen, [step[..., :1] for step in seen], [np.ones((2, 4), dtype=bool)] * 5)
    observations, actions, counts = plans.batch(6, np.random.default_rng(0))
    assert observations.shape == (5, 6, 4, 6) and actions.shape == (5, 6, 4, 1) and counts.shape == (5, 6, 4)
    assert torch.equal(observations[..., :1], actions)
    assert (observations[0, :, 0, 0] // 10).tolist() == [0, 0, 1, 1, 2, 2]


def test_plans_of_a_group_that_is_gone_are_not_learned():
    batch, plans = EnvBatch(SHORT, 1, 1), Plans()
    (drawn,) = batch.scenarios([1_000_000])
    drawn = replace(drawn, events=(GroupTrip(time_s=9.0, group=1),))
    observe(Planner(SHORT, 1, QUICK), batch, [drawn], plans, lambda plan: plan)
    (counts,) = plans.counts
    assert counts[:18].all() and not counts[20:, 0, 1].any() and counts[:, 0, [0, 2, 3]].all()
    settings = RunSettings(algo="dagger", hyperparameters={}, timesteps=1, n_envs=1, action_mode="k")
    learner, other = (DaggerLearner(settings, Hyperparameters(hidden=(4,), lstm=4)) for _ in range(2))
    learner.plans = plans
    other.policy.load_state_dict(learner.policy.state_dict())
    other.plans.observations, other.plans.counts = plans.observations, plans.counts
    # Whatever was planned for it.
    other.plans.actions = [torch.where(counts[..., None] > 0.5, plans.actions[0], 0.9)]
    h = Hyperparameters(lstm=4, hidden=(4,), updates=2)
    assert learner.fit(h, np.random.default_rng(0)) == other.fit(h, np.random.default_rng(0))


def test_it_does_not_look_at_its_last_actions():
    policy = GradientPolicy(6, 1, (4,), 4)
    seen = torch.rand(3, 8)
    other = torch.cat([seen[:, :6], torch.rand(3, 2)], dim=1)
    assert torch.equal(policy(seen)[0], policy(other)[0])
    assert torch.allclose(policy.of_episodes(seen[None])[0], policy(seen)[0])
