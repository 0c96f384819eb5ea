"""The Gymnasium environments."""

from wtg_gym.envs.gfm_wtg import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.envs.settings import CostWeights, EnvSettings

__all__ = ["CostWeights", "EnvSettings", "GFMWTGEnv", "GFMWTGVectorEnv"]
