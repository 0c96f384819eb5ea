"""Pictures of a running episode: the grid with its events, and what frequency and wind turbines have done so far.

Takes plain numbers and knows no environment, so that a change of the picture changes no result. Needs matplotlib, and a
window needs pygame too; both are imported only when something is to be drawn.
"""

from wtg_gym.rendering.diagram import BUS_PLACES
from wtg_gym.rendering.events import describe_event
from wtg_gym.rendering.frame import FRAME_SIZE, FramePainter
from wtg_gym.rendering.panels import PANELS, Episode, n_traces
from wtg_gym.rendering.window import Window

__all__ = ["BUS_PLACES", "FRAME_SIZE", "PANELS", "Episode", "FramePainter", "Window", "describe_event", "n_traces"]
