"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter, Token

from wtg_gym.policies.names import BASELINES
from wtg_gym.scenarios import SUITES, get_suite

#: An option that takes no value.
Flag = Annotated[bool, Parameter(negative="", show_default=False)]
#: An option that takes one word or several.
Words = Annotated[tuple[str, ...], Parameter(consume_multiple=1, negative="", show_default=False)]


def suite_name(text: str) -> str:
    """Return the full name of a suite: "faults" is "faults-v1", as v0 has no such suite; a ValueError lists all."""
    full = [name for name, suite in SUITES.items() if name == f"{text}-{suite.benchmark.version}"]
    return get_suite(full[0] if text not in SUITES and len(full) == 1 else text).name


def _suite(_: Any, tokens: Sequence[Token]) -> str:
    return suite_name(tokens[0].value)


def _whole(_: Any, tokens: Sequence[Token]) -> int:
    # Without this, 2.5 would be rounded.
    return int(tokens[0].value)


SuiteName = Annotated[str, Parameter(converter=_suite)]
Whole = Annotated[int, Parameter(converter=_whole)]

Threads = Annotated[Whole | None, Parameter(help="threads to step with; default: one per processor")]
Json = Annotated[bool, Parameter(negative="", show_default=False, help="print JSON, and nothing else, on stdout")]
Suite = Annotated[SuiteName, Parameter(help="one of those that `wtg-gym suites` lists")]
Entries = Annotated[
    Words,
    Parameter(
        help="'baselines'; 'policies', the trained ones that come with the package; one of either by its name in the "
        "leaderboard, such as linear-feedback or 'PPO (k)'; a .toml file with a law; a folder with entry.toml and "
        "policy.onnx; a package with entries, or module:ATTRIBUTE, whose code is run. Several are allowed; default: "
        f"{BASELINES}"
    ),
]


def _group(title: str, text: str = "") -> Callable[[type], type]:
    """Make the fields of a record options of every command that takes one."""
    return Parameter(name="*", group=Group(title, help=text, sort_key=10))


@_group("Workers", "other processes that play, see docs/performance.md")
@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """The processes that play."""

    backend: Literal["loky", "dask", "ray"] | None = None
    """loky's on this machine, or those of Dask or Ray; default: this process"""
    address: str | None = None
    """of a cluster: tcp://host:8786 for dask, host:6379 or auto for ray; default: workers on this machine"""
    jobs: Whole | None = None
    """number of workers; default: one per processor"""


@_group("Scenarios of the split", "all, unless one of these says which")
@dataclass(frozen=True, kw_only=True)
class SeedOptions:
    """The scenarios of a split that are played."""

    seeds: Words | None = None
    """seeds of the split: N, or A:B with B left out; several are allowed"""
    scenarios: Whole | None = None
    """the first so many; of the split fresh how many to draw, by default as many as test has"""
    commit: str | None = None
    """for the split fresh: full hash of the git commit with the entries"""
    secret_file: Path | None = None
    """for the split fresh: file with the secret, 16 bytes or more"""


@_group("Plant and time steps")
@dataclass(frozen=True, kw_only=True)
class PlantOptions:
    """The plant and its time steps."""

    groups: Whole | None = None
    """number of WTG groups at bus 2 that share 20 turbines of 5 MW; default: the suite's"""
    control_dt: float = 0.1
    """control interval [s]"""
    simulation_dt: float = 0.025
    """integration step, at most 0.04 s"""
    machine_model: Literal["genrou", "classical"] = "genrou"
    """synchronous machines: genrou with exciters, or classical"""
    on_failure: Literal["terminate", "trip"] = "terminate"
    """the failure of a rotor (stall, over-speed, under-speed) ends the run, or disconnects its group"""
    physics: Literal["paper", "extended", "nrel-5mw"] | None = None
    """the paper's model; extended by what it leaves out; or that with the NREL 5 MW turbine; default: the suite's"""
