"""The leaderboard as one HTML file: ranking, profiles, metrics, and traces of two entries side by side.

The file needs nothing but a browser: the plotting library, Bokeh, is taken from its Python package and written into it.
"""

from wtg_gym.plotting.page.data import untraced
from wtg_gym.plotting.page.html import N_SCENARIOS, SIZE_LIMIT, Page, leaderboard_page

__all__ = ["N_SCENARIOS", "SIZE_LIMIT", "Page", "leaderboard_page", "untraced"]
