"""The Gymnasium environments."""

from wtg_gym.envs.gfm_wtg import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.envs.settings import CostWeights, EnvArguments, EnvSettings

__all__ = ["CostWeights", "EnvArguments", "EnvSettings", "GFMWTGEnv", "GFMWTGVectorEnv"]
