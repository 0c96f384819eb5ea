"""The Gymnasium environments; the one of many lanes is imported when it is first used."""

from typing import TYPE_CHECKING, Any

from wtg_gym.envs.gfm_wtg import GFMWTGEnv
from wtg_gym.envs.settings import EnvArguments, EnvSettings
from wtg_gym.tasks.cost import CostWeights

if TYPE_CHECKING:
    from wtg_gym.envs.gfm_wtg_vector import GFMWTGVectorEnv

__all__ = ["CostWeights", "EnvArguments", "EnvSettings", "GFMWTGEnv", "GFMWTGVectorEnv"]


def __getattr__(name: str) -> Any:
    if name == "GFMWTGVectorEnv":
        from wtg_gym.envs.gfm_wtg_vector import GFMWTGVectorEnv

        return GFMWTGVectorEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
