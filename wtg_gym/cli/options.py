"""Options that several commands share.

Modules of commands import only this one, `output` and the standard library. A command imports the rest when it runs, so
that its help appears at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter, Token, validators

from wtg_gym.cli.output import check_writable

#: That of `wtg_gym.scenarios`, whose import takes a second.
DEFAULT_SUITE = "standard-v1"
#: An option that takes no value.
Flag = Annotated[bool, Parameter(negative="", show_default=False)]
#: An option that takes one word or several.
Words = Annotated[tuple[str, ...], Parameter(consume_multiple=1, negative="", show_default=False)]


def _suite(_: Any, tokens: Sequence[Token]) -> str:
    from wtg_gym.scenarios import get_suite

    get_suite(name := tokens[0].value)
    return name


def _whole(_: Any, tokens: Sequence[Token]) -> int:
    # Without this, 2.5 would be rounded.
    return int(tokens[0].value)


def _can_be_written(_: Any, path: Path | None) -> None:
    """Refuse a file or folder now, rather than after the work; folders that are missing are made."""
    if path is None:
        return
    there = next(parent for parent in (path, *path.absolute().parents) if parent.exists())
    folder = there.parent if there == path and there.is_file() else there
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder")
    check_writable(folder)


def _output_file(*endings: str) -> Parameter:
    return Parameter(validator=(validators.Path(ext=endings, dir_okay=False), _can_be_written))


SuiteName = Annotated[str, Parameter(converter=_suite)]
Whole = Annotated[int, Parameter(converter=_whole)]
OutputFolder = Annotated[Path, Parameter(validator=(validators.Path(file_okay=False), _can_be_written))]
CsvFile = Annotated[Path, _output_file("csv")]
FigureFile = Annotated[Path, _output_file("png", "svg", "pdf")]
JsonFile = Annotated[Path, _output_file("json")]
PageFile = Annotated[Path, _output_file("html", "htm", "md")]

Threads = Annotated[Whole | None, Parameter(help="threads to step with; default: one per processor")]
Json = Annotated[bool, Parameter(negative="", show_default=False, help="print JSON, and nothing else, on stdout")]
Suite = Annotated[
    SuiteName, Parameter(help="one of those that `wtg-gym suites` lists, or the .json file of a suite or a grid")
]
Entries = Annotated[
    Words,
    Parameter(
        help="'baselines'; 'policies', the trained ones that come with the package; one of either by its name in the "
        "leaderboard, such as linear-feedback or 'PPO (k)'; a .toml file with a law; a folder with entry.toml and "
        "policy.onnx; or module:ATTRIBUTE, whose code is run. Several are allowed; default: "
        "baselines"
    ),
]


@Parameter(name="*", group=Group("Workers", help="other processes that play, see docs/performance.md", sort_key=10))
@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """The processes that play."""

    backend: Literal["loky", "dask"] | None = None
    """loky's on this machine, or those of Dask; default: this process"""
    address: str | None = None
    """of Dask's scheduler, such as tcp://host:8786; default: workers on this machine"""
    jobs: Whole | None = None
    """number of workers; default: one per processor"""


@Parameter(name="*", group=Group("Scenarios of the split", help="all, unless one of these says which", sort_key=10))
@dataclass(frozen=True, kw_only=True)
class SeedOptions:
    """The scenarios of a split that are played."""

    seeds: Annotated[tuple[Whole, ...] | None, Parameter(consume_multiple=1, negative="")] = None
    """seeds of the split; in bash {20000..20009} is ten of them"""
    scenarios: Whole | None = None
    """the first so many"""


@Parameter(name="*", group=Group("Scenario", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class ScenarioOptions:
    """The scenario, and changes to it."""

    suite: SuiteName = "paper"
    """suite to draw from, one of those that `wtg-gym suites` lists; the grid is its own too"""
    seed: Whole | None = None
    """seed of the suite; default: its first test seed, of the suite paper the load increase"""
    scenario: Path | None = None
    """scenario file in JSON, as `wtg-gym suites NAME --seed N --json` prints, in the place of a seed"""
    duration: float | None = None
    """length of the run [s]; a drawn scenario is drawn anew for it"""
    wind: Annotated[tuple[float, ...] | None, Parameter(consume_multiple=1, negative="")] = None
    """constant wind, 3 … 25 m/s: one for all WTG groups or one each"""
    wind_csv: Path | None = None
    """wind series: time_s, then one column per WTG group [m/s], uniform steps"""

    def __post_init__(self) -> None:
        """Refuse options that exclude each other."""
        for first, second in (("scenario", "seed"), ("wind", "wind_csv")):
            if getattr(self, first) is not None and getattr(self, second) is not None:
                raise ValueError(f"--{first} and --{second.replace('_', '-')} exclude each other: give one of the two")
