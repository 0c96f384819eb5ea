"""Figures for screen and print: recorded runs, policies, the paper's figures, and those of the studies beyond it.

Needs matplotlib of the `leaderboard` extra once something is drawn; importing the package does not. Every function
returns a matplotlib figure, built without pyplot; :func:`figure_bytes` turns one into a file.
"""

from wtg_gym.plotting.characteristics import plot_characteristic
from wtg_gym.plotting.eigenvalue_plane import plot_modes
from wtg_gym.plotting.front import plot_front
from wtg_gym.plotting.influence_bars import plot_influences
from wtg_gym.plotting.learning import LearningCurve, plot_learning_curves
from wtg_gym.plotting.measurements import plot_accuracy, plot_growth
from wtg_gym.plotting.paper_figures import plot_bode, plot_case_study, plot_power_coefficient
from wtg_gym.plotting.physics_figures import plot_plant_parts, plot_plant_runs, plot_stiffness
from wtg_gym.plotting.policy_runs import plot_costs, plot_runs
from wtg_gym.plotting.responses import plot_responses
from wtg_gym.plotting.side_by_side import plot_one_event
from wtg_gym.plotting.study_figures import plot_damping, plot_equilibria, plot_machine_models, plot_margins
from wtg_gym.plotting.style import STRATEGY_LOOKS, figure_bytes, save_figure, strategy_looks
from wtg_gym.plotting.trajectories import plot_trajectories

__all__ = [
    "STRATEGY_LOOKS",
    "LearningCurve",
    "figure_bytes",
    "plot_accuracy",
    "plot_bode",
    "plot_case_study",
    "plot_characteristic",
    "plot_costs",
    "plot_damping",
    "plot_equilibria",
    "plot_front",
    "plot_growth",
    "plot_influences",
    "plot_learning_curves",
    "plot_machine_models",
    "plot_margins",
    "plot_modes",
    "plot_one_event",
    "plot_plant_parts",
    "plot_plant_runs",
    "plot_power_coefficient",
    "plot_responses",
    "plot_runs",
    "plot_stiffness",
    "plot_trajectories",
    "save_figure",
    "strategy_looks",
]
