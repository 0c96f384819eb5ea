"""Figures for screen and print: recorded runs, and the report on an entry.

Needs matplotlib of the `leaderboard` extra once something is drawn; importing the package does not. Every function
returns a matplotlib figure, built without pyplot; :func:`figure_bytes` turns one into a file.
"""

from wtg_gym.plotting.style import figure_bytes, save_figure
from wtg_gym.plotting.trajectories import plot_trajectories

__all__ = ["figure_bytes", "plot_trajectories", "save_figure"]
