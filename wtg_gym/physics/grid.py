"""A grid as data: network, machines, WTG groups and where its numbers come from, in one JSON file."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import tempfile
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

from wtg_gym.files import interpreting, parse_json, read_text, sha256, write_atomically
from wtg_gym.physics.checked import Checked, require_items
from wtg_gym.physics.machine_parameters import AnyExciter, AnyGovernor, AnyStabiliser
from wtg_gym.physics.network import MOST_UNITS, NetworkCase
from wtg_gym.physics.parameters import MOST_GROUPS, WtgGroup
from wtg_gym.ranges import did_you_mean, require_known
from wtg_gym.systems.compiled import cache_folder

#: The grids that come with the package.
FOLDER = Path(__file__).parents[1] / "grids"
#: The one that is meant where none is named: the paper's.
DEFAULT_GRID = "ieee14"
#: Controls of a machine by the name that stands in a file.
MODELS: Mapping[str, type[Any]] = types.MappingProxyType(
    {each.MODEL: each for control in (AnyExciter, AnyGovernor, AnyStabiliser) for each in get_args(control)}
)


@dataclass(frozen=True, kw_only=True)
class Grid(Checked):
    """A network with its machines and WTG groups, as a file describes it.

    Args:
        case: the network.
        groups: the WTG groups.
        replaced: buses whose synchronous machines these stand for.
        source: where the numbers come from.
        licence: of the source.
        repairs: what was changed because it contradicted itself, a sentence each.
        substitutions: what stands in place of a model that is not here, a sentence each.
    """

    MOST = types.MappingProxyType({"groups": MOST_GROUPS, "replaced": MOST_UNITS})

    case: NetworkCase
    groups: tuple[WtgGroup, ...] = ()
    replaced: tuple[int, ...] = ()
    source: str = ""
    licence: str = ""
    repairs: tuple[str, ...] = ()
    substitutions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for bus in (*self.replaced, *(group.bus for group in self.groups)):
            self.case.bus_index(bus)

    @functools.cached_property
    def with_groups(self) -> NetworkCase:
        """The network as it is with the groups, without the machines that they replace."""
        machines = tuple(machine for machine in self.case.machines if machine.bus not in self.replaced)
        return dataclasses.replace(self.case, machines=machines)


def known_grids() -> tuple[str, ...]:
    """Return the names of the grids that come with the package."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.json")))


def get_grid(name: str) -> Grid:
    """Return a grid by its name, or by the path of its file, which ends in ".json".

    Raises:
        ValueError: the name is unknown, or the file is damaged; the message says what is wrong.
    """
    path = Path(name) if name.endswith(".json") else FOLDER / f"{name}.json"
    if path.parent == FOLDER and not path.exists():
        known = f"{', '.join(known_grids())}, or the path of a .json file{did_you_mean(name, known_grids())}"
        raise ValueError(f"unknown grid {name!r}; known grids: {known}")
    return read_grid(path)


def read_grid(path: Path) -> Grid:
    """Return the grid of a file; a ValueError says what is wrong with it."""
    text = read_text(path, "grid")
    with interpreting(path, "grid"):
        return _grid_of(text)


@functools.lru_cache(maxsize=64)
def _grid_of(text: str) -> Grid:
    data = parse_json(text, "it")
    own = {field.name for field in dataclasses.fields(Grid)} - {"case"}
    if not isinstance(data, dict):
        raise ValueError("it must hold an object")
    case = {key: value for key, value in data.items() if key not in own}
    grid: Grid = record_of(Grid, {"case": case, **{key: value for key, value in data.items() if key in own}})
    return grid


def record_of(kind: Any, data: Any) -> Any:
    """Return a dataclass from a JSON object; the records in it too."""
    if not isinstance(data, Mapping):
        raise ValueError(f"{kind.__name__} must be an object, got {data!r:.80}")
    hints = get_type_hints(kind)
    kinds = {field.name: hints[field.name] for field in dataclasses.fields(kind)}
    require_known(kind.__name__, data, list(kinds))
    nothing = dataclasses.MISSING
    needed = [each.name for each in dataclasses.fields(kind) if each.default is each.default_factory is nothing]
    if missing := [name for name in needed if name not in data]:
        raise ValueError(f"{kind.__name__} {dict(data)!r:.300} misses {', '.join(missing)}")
    for name, value in data.items():
        require_items(kind, name, value)
    return kind(**{name: _value(kinds[name], value) for name, value in data.items()})


def _value(kind: Any, value: Any) -> Any:
    """Return a value as the type of its field says: objects as records, lists as tuples of them."""
    kinds = [each for each in (get_args(kind) or (kind,)) if dataclasses.is_dataclass(each)]
    if isinstance(value, list):
        return tuple(record_of(kinds[0], each) if kinds else _value(None, each) for each in value)
    if not isinstance(value, Mapping) or not kinds:
        return value
    if kinds[0] not in MODELS.values():
        return record_of(kinds[0], value)
    given = dict(value)
    models = [name for name, each in MODELS.items() if each in kinds]
    if (model := given.pop("model", None)) not in models:
        raise ValueError(f"unknown model {model!r}; known here: {', '.join(models)}{did_you_mean(model, models)}")
    return record_of(MODELS[model], given)


def grid_text(grid: Grid) -> str:
    """Return a grid as its file: what is not as the defaults say."""
    data = {**data_of(grid), **data_of(grid.case)}
    del data["case"]
    return text_of(data)


def file_of(grid: Grid) -> str:
    """Return the path of a grid's file in the user's cache, so that it is one by its path as every other."""
    text = grid_text(grid)
    path = (cache_folder() or Path(tempfile.mkdtemp())) / f"grid-{sha256(text.encode())[:16]}.json"
    with contextlib.suppress(ValueError):
        if read_text(path, "grid") == text:
            return str(path)
    write_atomically(path, text)
    return str(path)


def digest_of_grid(grid: Grid) -> str:
    """Return the sha256 of what is in a grid, so that a hash does not depend on where its file lies."""
    return sha256(grid_text(grid).encode())


def text_of(data: Mapping[str, Any]) -> str:
    """Return an object as JSON with a line for each value, and for each record of a list."""
    written = functools.partial(json.dumps, ensure_ascii=False, allow_nan=False)
    lines = []
    for key, value in data.items():
        text = written(value)
        if isinstance(value, list) and value and isinstance(value[0], dict):
            text = "[\n  " + ",\n  ".join(map(written, value)) + "\n ]"
        lines.append(f" {written(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def data_of(record: Any) -> Any:
    """Return a record as JSON-ready data, without what is as by default."""
    if isinstance(record, tuple):
        return [data_of(each) for each in record]
    if not dataclasses.is_dataclass(record):
        return record
    found: dict[str, Any] = {}
    names = {each: name for name, each in MODELS.items()}
    if type(record) in names:
        found["model"] = names[type(record)]
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        factory: Any = field.default_factory
        default = field.default if factory is dataclasses.MISSING else factory()
        if value != default:
            found[field.name] = data_of(value)
    return found
