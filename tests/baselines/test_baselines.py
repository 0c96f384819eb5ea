"""Facts about the conventional strategies as entries."""

from pathlib import Path

import numpy as np
import pytest

import baselines
from baselines.fast_droop import FastDroop
from baselines.mean_droop import MeanDroop
from baselines.tip_speed_feedback import TipSpeedFeedback
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.tasks import V0

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


def test_mean_droop_acts_on_the_mean_deviation_and_spares_slow_rotors():
    observation = np.random.default_rng(0).normal(size=(1, 28))
    observation[0, ::7] = np.array([-0.3, 0.1, 0.0, -0.2]) / 0.5
    speeds_pu = np.array([0.9, 0.7, 0.6, 0.3])
    observation[0, 3::7] = (speeds_pu - 1.0) / 0.25
    policy = MeanDroop(full_action_hz=0.5, slow_rotor_pu=0.7, rotor_gain=5.0)
    assert policy.predict(observation)[0] == pytest.approx(np.array([[0.2, 0.2, -0.3, -1.0]]))
    own = np.repeat(observation.reshape(1, 1, 4, 7), 2, axis=1)
    several = MeanDroop(*(np.array([[a], [b]]) for a, b in ((0.5, 1.0), (0.7, 0.5), (5.0, 1.0))))
    both = several.act(own[..., 0], own[..., 3])
    assert both == pytest.approx(np.array([[[0.2, 0.2, -0.3, -1.0], [0.1, 0.1, 0.1, -0.1]]]))
