"""Pictures of a running episode: the grid with its events, and frequency and wind turbines so far.

Needs matplotlib, and a window needs pygame too; both are imported only when something is drawn.
"""

from wtg_gym.envs.rendering.frame import Frame
from wtg_gym.envs.rendering.lane_frames import LaneFrames

__all__ = ["Frame", "LaneFrames"]
