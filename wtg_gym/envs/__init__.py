"""The Gymnasium environments."""

from wtg_gym.envs.gfm_wtg import GFMWTGEnv
from wtg_gym.envs.gfm_wtg_vector import GFMWTGVectorEnv
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.tasks.cost import CostWeights

__all__ = ["CostWeights", "EnvSettings", "GFMWTGEnv", "GFMWTGVectorEnv"]
