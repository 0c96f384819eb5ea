"""Grid-forming wind turbine generators in a power grid, as a Gymnasium benchmark.

Importing this package registers `GFMWTG-14bus-v0`, `GFMWTG-14bus-v1`, and `GFMWTG-v1` for any grid. The environments'
classes and what scores a policy are loaded, with the numerical packages that they need, when they are first used.
"""

import warnings
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register, registry

if TYPE_CHECKING:
    from wtg_gym.envs import GFMWTGEnv as GFMWTGEnv
    from wtg_gym.envs import GFMWTGVectorEnv as GFMWTGVectorEnv
    from wtg_gym.evaluation import Entry as Entry
    from wtg_gym.evaluation import Results as Results
    from wtg_gym.evaluation import evaluate as evaluate
    from wtg_gym.evaluation import leaderboard_rows as leaderboard_rows
    from wtg_gym.evaluation import load_entries as load_entries
    from wtg_gym.evaluation import markdown_table as markdown_table
    from wtg_gym.physics.plant import Plant as Plant
    from wtg_gym.physics.scenario import Fault as Fault
    from wtg_gym.physics.scenario import FrequencyRamp as FrequencyRamp
    from wtg_gym.physics.scenario import GovernorLoss as GovernorLoss
    from wtg_gym.physics.scenario import GroupTrip as GroupTrip
    from wtg_gym.physics.scenario import LineTrip as LineTrip
    from wtg_gym.physics.scenario import LoadRamp as LoadRamp
    from wtg_gym.physics.scenario import LoadStep as LoadStep
    from wtg_gym.physics.scenario import LoadTrip as LoadTrip
    from wtg_gym.physics.scenario import MachineOutage as MachineOutage
    from wtg_gym.physics.scenario import PhaseJump as PhaseJump
    from wtg_gym.physics.scenario import ReactanceStep as ReactanceStep
    from wtg_gym.physics.scenario import Scenario as Scenario
    from wtg_gym.physics.tracking_law import TrackingLaw as TrackingLaw
    from wtg_gym.physics.tracking_law import get_law as get_law
    from wtg_gym.physics.trajectory import Trajectory as Trajectory
    from wtg_gym.physics.trajectory import simulate as simulate
    from wtg_gym.policies.torch_export import export_onnx as export_onnx
    from wtg_gym.scenarios import get_suite as get_suite

try:
    __version__ = version("wtg-gym")
except PackageNotFoundError:  # a checkout that was not installed
    __version__ = "0+unknown"

#: Ids of the environments: the paper's system, and the grid that needs the wind.
ENV_IDS = ("GFMWTG-14bus-v0", "GFMWTG-14bus-v1")
#: The default version.
ENV_ID = ENV_IDS[1]

# The last one is version v1 with any grid, by the argument `grid`.
for _id in (*ENV_IDS, "GFMWTG-v1"):
    if _id not in registry:
        register(
            _id,
            entry_point="wtg_gym.envs.gfm_wtg:GFMWTGEnv",
            vector_entry_point="wtg_gym.envs.gfm_wtg_vector:GFMWTGVectorEnv",
            kwargs={"version": _id.rpartition("-")[2]},
        )

# v0 is the paper's system, and stays, but Gymnasium warns of every id that has one with a higher number. Filters that
# are set after this import, as pytest's are, go first.
warnings.filterwarnings("ignore", rf".*The environment {ENV_IDS[0]} is out of date", DeprecationWarning)

#: Public names by their modules, which are imported when a name is first used.
_PLACES = {
    "envs": "GFMWTGEnv GFMWTGVectorEnv",
    "evaluation": "Entry Results evaluate leaderboard_rows load_entries markdown_table",
    "physics.plant": "Plant",
    "physics.scenario": "Fault FrequencyRamp GovernorLoss GroupTrip LineTrip LoadRamp LoadStep LoadTrip MachineOutage "
    "PhaseJump ReactanceStep Scenario",
    "physics.tracking_law": "TrackingLaw get_law",
    "physics.trajectory": "Trajectory simulate",
    "policies.torch_export": "export_onnx",
    "scenarios": "get_suite",
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names.split()}
__all__ = ["ENV_ID", "ENV_IDS", "__version__", *_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"wtg_gym.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
