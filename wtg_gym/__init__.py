"""Grid-forming wind turbine generators on the modified IEEE 14-bus system, as a Gymnasium benchmark.

Importing this package registers `GFMWTG-14bus-v0`. The environments' classes and what scores a policy are loaded, with
the numerical packages that they need, when they are first used.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register, registry

if TYPE_CHECKING:
    from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
    from wtg_gym.evaluation import Entry, evaluate, leaderboard_rows, load_entries, markdown_table

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

__all__ = [
    "ENV_ID",
    "Entry",
    "GFMWTGEnv",
    "GFMWTGVectorEnv",
    "__version__",
    "evaluate",
    "leaderboard_rows",
    "load_entries",
    "markdown_table",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("wtg_gym.envs" if name.startswith("GFM") else "wtg_gym.evaluation"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
