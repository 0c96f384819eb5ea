"""Facts about the conventional strategies as entries."""

from pathlib import Path

import numpy as np
import pytest

import baselines
from baselines.distilled_law import DistilledLaw, Gains
from baselines.fast_droop import FastDroop
from baselines.tip_speed_feedback import TipSpeedFeedback
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.tasks import V0
from wtg_gym.tasks.observation import of_groups
from wtg_gym.tasks.sensing import MeasuredObservation

FOLDER = Path(baselines.__file__).parent


def test_entries_are_the_built_in_strategies_and_every_module_is_named():
    entries = load_entries("baselines", task=V0)
    assert {entry.name: entry.law for entry in entries if entry.kind == "law"} == STRATEGIES
    assert [(each.name, each.kind) for each in entries if each.kind != "law"] == [("tip-speed-feedback", "feedback")]
    named = {name for order in baselines.ORDER.values() for name in order if isinstance(name, str)}
    assert named == {path.stem for path in FOLDER.glob("[a-z]*.py")}


def test_feedback_rests_where_the_turbine_captures_what_is_asked():
    policy = TipSpeedFeedback(gain=1.0)
    best, limit = tracking_point(0.0).tip_speed_ratio, tracking_point(0.1).tip_speed_ratio
    for deviation_hz, deloading in ((-0.4, 0.0), (0.0, 0.05), (0.4, 0.1), (-0.2, 0.025), (-1.0, 0.0)):
        observation = np.zeros((1, 18))
        for group in (0, 9):
            ratio = tracking_point(deloading).tip_speed_ratio
            observation[0, group] = deviation_hz / 0.5
            observation[0, group + 2] = (ratio - best) / (limit - best)
        action, _ = policy.predict(observation)
        assert np.abs(action).max() < 1e-3
        # A rotor that is too fast gives more power.
        observation[0, [2, 11]] += 0.1
        assert policy.predict(observation)[0] == pytest.approx(np.full((1, 2), 0.1), abs=1e-3)


def test_fast_droop_is_one_gain_of_each_groups_own_measured_frequency():
    observation = np.random.default_rng(0).normal(size=(1, 28))
    deviations_hz = np.array([-0.3, 0.1, 0.0, 2.0])
    observation[0, ::7] = deviations_hz / 0.5
    action, _ = FastDroop().predict(observation)
    assert action == pytest.approx(np.array([[1.0, -0.4, 0.0, -1.0]]))


def test_the_distilled_law_adds_its_terms_and_filters_them():
    observation = np.random.default_rng(0).normal(size=(1, 28))
    observation[0, ::7] = deviations_hz = np.array([-0.3, 0.1, 0.0, -0.2])
    observation[0, ::7] /= 0.5
    speeds_pu, winds_m_s = np.array([0.97, 0.77, 0.67, 0.57]), np.array([8.0, 10.0, 12.0, 7.0])
    observation[0, 3::7], observation[0, 5::7] = (speeds_pu - 1.0) / 0.25, (winds_m_s - 10.0) / 5.0
    policy = DistilledLaw(Gains(offset=0.1, frequency=1.0, filtered_frequency=-0.5, speed=-0.4, wind=0.05))
    actions, state = policy.predict(observation, episode_start=np.array([True]))
    parts = np.array([np.full(4, -0.1), speeds_pu - 1.0, winds_m_s - 10.0])
    assert deviations_hz.mean() == pytest.approx(-0.1) and np.allclose(state[0].T, parts)
    weights = np.array([-0.5, -0.4, 0.05])
    assert actions[0] == pytest.approx(0.1 - 0.1 + weights @ parts)
    observation[0, ::7], observation[0, 3::7], observation[0, 5::7] = 0.0, 0.0, 0.0
    actions, state = policy.predict(observation, state, np.array([False]))
    parts *= np.exp(-0.5 / np.array([[15.0], [15.0], [40.0]]))
    assert np.allclose(state[0].T, parts) and actions[0] == pytest.approx(0.1 + weights @ parts)
    assert policy.predict(observation, state, np.array([True]))[1] == pytest.approx(np.zeros((1, 4, 3)))
    several = DistilledLaw(np.array([policy.gains, np.zeros(5)])[:, np.newaxis, np.newaxis])
    seen = of_groups(np.repeat(observation[np.newaxis], 2, axis=0), MeasuredObservation, "k")
    one = policy.act(of_groups(observation, MeasuredObservation, "k"))[0]
    assert several.act(seen)[0] == pytest.approx(np.array([one, np.zeros((1, 4))]))
