"""Facts about the figure of learning curves."""

from __future__ import annotations

import numpy as np
import pytest

from wtg_gym.plotting import LearningCurve, plot_learning_curves


def curve(*scores: float, interval: float = 1000.0, seconds: float = 60.0) -> LearningCurve:
    n = np.arange(float(len(scores)))
    return LearningCurve(timesteps=interval * n, wall_time_s=seconds * n, score=np.array(scores))


def test_line_is_the_mean_of_the_seeds_where_all_were_validated() -> None:
    figure = plot_learning_curves({"ppo, k": [curve(90.0, 100.0, 110.0), curve(100.0, 104.0, seconds=120.0)]})
    by_steps, by_time = figure.axes
    line = by_steps.lines[0]
    assert list(line.get_xdata()) == [0.0, 1000.0] and list(line.get_ydata()) == [95.0, 102.0]
    assert list(by_time.lines[0].get_xdata()) == [0.0, 1.5]
    (band,) = by_steps.collections
    assert band.get_paths()[0].get_extents().bounds == (0.0, 90.0, 1000.0, 14.0)
    assert (by_steps.get_xlabel(), by_time.get_xlabel()) == ("environment steps", "wall time [min]")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["ppo, k (2 seeds)"]


def test_set_ups_have_colours_of_their_own_and_long_and_short_ones_share_a_logarithmic_axis() -> None:
    figure = plot_learning_curves({"ppo, k": [curve(90.0, 101.0)], "sac, k": [curve(80.0, 102.0, seconds=20_000.0)]})
    by_steps, by_time = figure.axes
    assert by_steps.lines[0].get_color() != by_steps.lines[1].get_color()
    assert (by_steps.get_xscale(), by_time.get_xscale()) == ("linear", "log")
    assert by_time.get_xlabel() == "wall time [h]"


def test_bad_scores_do_not_squeeze_the_good_ones() -> None:
    by_steps = plot_learning_curves({"td3, k": [curve(100.0, -900.0, 103.0)]}).axes[0]
    assert by_steps.get_ylim()[0] == -5.0 and by_steps.get_ylim()[1] > 103.0


def test_anchors_in_sight_are_named() -> None:
    curves = {"ppo, k": [curve(-3.0, 60.0, 101.0)]}
    for anchors in (None, ("coordinated-piecewise", "coordinated-tuned")):
        figure = plot_learning_curves(curves) if anchors is None else plot_learning_curves(curves, anchors)
        named = {text.get_text(): text.get_position()[1] for text in figure.axes[1].texts}
        zero, hundred = anchors or ("mppt", "coordinated-piecewise")
        assert (named[zero], named[hundred]) == (0.0, 100.0)


@pytest.mark.parametrize(
    ("curves", "text"),
    [
        ({}, "there is no learning curve"),
        ({"ppo": []}, "there is no learning curve"),
        (
            {
                "ppo": [
                    LearningCurve(timesteps=np.array([t]), wall_time_s=np.zeros(1), score=np.zeros(1))
                    for t in (1.0, 2.0)
                ]
            },
            "'ppo' were never validated at the same step",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(curves: dict[str, list[LearningCurve]], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        plot_learning_curves(curves)
