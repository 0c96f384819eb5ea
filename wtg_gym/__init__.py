"""Grid-forming wind turbine generators on the modified IEEE 14-bus system, as a Gymnasium benchmark.

Importing this package registers `GFMWTG-14bus-v0`.
"""

from importlib.metadata import PackageNotFoundError, version

from gymnasium.envs.registration import register, registry

try:
    __version__ = version("wtg-gym")
except PackageNotFoundError:  # a checkout that was not installed
    __version__ = "0+unknown"

#: Id of the environment.
ENV_ID = "GFMWTG-14bus-v0"

if ENV_ID not in registry:
    register(
        ENV_ID,
        entry_point="wtg_gym.envs.gfm_wtg:GFMWTGEnv",
        vector_entry_point="wtg_gym.envs.gfm_wtg:GFMWTGVectorEnv",
    )

__all__ = ["ENV_ID", "__version__"]
