"""Facts about the planner and its pupil: no foresight, plans from where the episode is, the same bits again."""

from dataclasses import replace

import numpy as np
import torch

from agents import gradient
from agents.dagger import DaggerLearner, Plans, main
from agents.planner import Planner, PlannerOptions, drive, planned
from agents.run import folders
from tests.agents.small import run_and_interrupted_run
from tests.interruption import interrupted
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation import evaluate
from wtg_gym.physics.scenario import LoadStep

SETTINGS = EnvSettings(suite="standard-v1", strategy="coordinated-free", action_mode="k", reward="cost")
SHORT = replace(SETTINGS, duration_s=20.0)
QUICK = PlannerOptions(horizon_s=5.0, iterations=1)


def test_a_plan_knows_nothing_of_what_comes():
    lanes = TaskLanes(SHORT, 1, 1)
    (drawn,) = lanes.scenarios([1_000_000])
    drawn = replace(drawn, events=())
    wind, noise = drawn.wind_speed.copy(), drawn.load_noise_mw.copy()
    wind[:, 101:] *= 0.9
    noise[101:] += 5.0
    step = LoadStep(time_s=10.1, bus=4, power_mw=30.0)
    plans = []
    for scenario in (drawn, replace(drawn, wind_speed=wind, load_noise_mw=noise, events=(step,)), drawn):
        planner = Planner(SHORT, 1, QUICK, 1)
        planner.start([scenario])
        for _ in range(20):
            planner.take(np.full((1, 4), 0.1))
        plans.append(planner.plan())
    assert np.array_equal(plans[0], plans[1]) and np.array_equal(plans[0], plans[2])
    # An event that has happened counts.
    planner.start([replace(drawn, events=(replace(step, time_s=9.9),))])
    for _ in range(20):
        planner.take(np.full((1, 4), 0.1))
    assert not np.array_equal(plans[0], planner.plan())


def test_it_plans_from_where_the_episode_is_to_its_end():
    lanes = TaskLanes(SHORT, 2, 1)
    planner = Planner(SHORT, 2, QUICK, 1)
    actions = drive(planner, lanes, lanes.scenarios([1_000_000, 1_000_001]))
    assert actions.shape == (40, 2, 4) and lanes.ended()[1].all()
    # What it replays of the past is the episode, to the bit.
    planner.plan()
    lanes.start(range(2), lanes.scenarios([1_000_000, 1_000_001]))
    for step, taken in enumerate(actions):
        lanes.step(taken)
        if step < 39:
            replayed = planner._episodes.tape.before(step + 1)
            rows = lanes.simulator.layout.wtg("rotor_speed")
            assert np.array_equal(lanes.simulator.blocks[:, rows], replayed[:, rows])


def test_it_costs_less_than_the_law_where_reserves_are_ample():
    seeds = [10_002, 10_005, 10_008]
    entry = planned("standard-v1", "coordinated-free", seeds, PlannerOptions(interval_s=30.0, iterations=3))
    results = evaluate([entry, "coordinated-free"], "standard-v1", "validation", seeds=seeds)
    assert results.pinned_costs["planner"].mean() < results.pinned_costs["coordinated-free"].mean()


def test_batches_hold_episodes_of_all_rounds():
    plans = Plans()
    for index in range(3):
        seen = [np.full((2, 4, 6), index) + np.arange(2)[:, None, None]] * 5
        plans.add(seen, [each[..., :1] for each in seen], [np.ones(2, dtype=bool)] * 5)
    observations, actions, running = plans.batch(6, np.random.default_rng(0))
    assert observations.shape == (5, 6, 4, 6) and actions.shape == (5, 6, 4, 1) and running.shape == (5, 6)
    assert torch.equal(observations[..., :1], actions)
    assert all(index <= observations[0, 2 * index, 0, 0] <= index + 1 for index in range(3))


OPTIONS = ["--strategy", "coordinated-free", "--action-mode", "k", "--timesteps", "2160", "--interval", "1080"]
OPTIONS += ["--n-envs", "3", "--validation-episodes", "3", "--lstm", "4", "--hidden", "4", "--updates", "2"]
OPTIONS += ["--horizon-s", "2", "--interval-s", "60", "--iterations", "1"]


def test_run_repeats_also_after_an_interruption_and_gradients_go_on_from_it(tmp_path, capsys):
    def interrupt(patch, when):
        patch.setattr(DaggerLearner, "fit", interrupted(DaggerLearner.fit, when))

    runs = run_and_interrupted_run(main, OPTIONS, interrupt, tmp_path)
    saved = [folders(run.folder / "checkpoints")[0] / "state.pt" for run in runs]
    states = [torch.load(path, weights_only=True)["policy"] for path in saved]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])

    descends = ["--strategy", "coordinated-free", "--action-mode", "k", "--per-group", "--start", str(tmp_path / "one")]
    descends += ["--lstm", "4", "--timesteps", "720", "--n-envs", "1", "--validation-episodes", "3"]
    folder = tmp_path / "descended"
    assert gradient.main([*descends, "--hidden", "4", "--learning-rate", "0", "--output", str(folder)]) == 0
    kept = torch.load(folders(folder / "checkpoints")[0] / "state.pt", weights_only=True)["policy"]
    assert all(torch.equal(states[0][key], kept[key]) for key in states[0])
    assert gradient.main([*descends, "--hidden", "5", "--output", str(tmp_path / "other")]) == 2
    assert "size mismatch" in capsys.readouterr().err


def test_a_start_without_a_run_is_named(tmp_path, capsys):
    options = ["--per-group", "--start", str(tmp_path), "--output", str(tmp_path / "run")]
    assert gradient.main(options) == 2
    assert f"start: {tmp_path} holds no checkpoint" in capsys.readouterr().err
