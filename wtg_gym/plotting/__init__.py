"""Figures for screen and print: recorded runs, policies, and studies; the paper's are in `wtg_gym.reproduce`.

Needs matplotlib of the `leaderboard` extra once something is drawn; importing the package does not. Every function
returns a matplotlib figure, built without pyplot; :func:`figure_bytes` turns one into a file.
"""

from wtg_gym.plotting.animation import animate_trajectories
from wtg_gym.plotting.front import plot_front
from wtg_gym.plotting.learning import LearningCurve, plot_learning_curves
from wtg_gym.plotting.policy_runs import plot_costs, plot_runs
from wtg_gym.plotting.responses import plot_responses
from wtg_gym.plotting.side_by_side import plot_one_event
from wtg_gym.plotting.style import STRATEGY_LOOKS, figure_bytes, save_figure, strategy_looks
from wtg_gym.plotting.trajectories import plot_trajectories

__all__ = [
    "STRATEGY_LOOKS",
    "LearningCurve",
    "animate_trajectories",
    "figure_bytes",
    "plot_costs",
    "plot_front",
    "plot_learning_curves",
    "plot_one_event",
    "plot_responses",
    "plot_runs",
    "plot_trajectories",
    "save_figure",
    "strategy_looks",
]
