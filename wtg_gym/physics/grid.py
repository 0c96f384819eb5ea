"""Networks as data, and a grid: a network with its machines and WTG groups in one JSON file."""

import contextlib
import dataclasses
import functools
import json
import math
import tempfile
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wtg_gym.files import interpreting, parse_json, read_text, sha256, write_atomically
from wtg_gym.physics.machine_parameters import AnyExciter, AnyGovernor, AnyStabiliser, SynchronousMachineParameters
from wtg_gym.physics.parameters import MOST_GROUPS, WtgGroup
from wtg_gym.ranges import Checked, design, did_you_mean, parameter, require_items, require_known, required
from wtg_gym.systems.compiled import cache_folder

#: Buses and machines or sources of a network at most: a batch of episodes of more would not fit into memory.
MOST_BUSES, MOST_UNITS = 2000, 600


@dataclass(frozen=True, kw_only=True)
class Bus(Checked):
    """A bus: number, constant-impedance load and shunt, and the voltage its units hold."""

    number: int = required("-", "IEEE 14", "bus number")
    load_mw: float = parameter(0.0, "MW", "IEEE 14", "active load at the initial voltage", -1e9, 1e9)
    load_mvar: float = parameter(0.0, "Mvar", "IEEE 14", "reactive load at the initial voltage", -1e9, 1e9)
    shunt_mw: float = parameter(0.0, "MW", "IEEE 14", "active shunt at 1 p.u. of voltage", -1e9, 1e9)
    shunt_mvar: float = parameter(0.0, "Mvar", "IEEE 14", "capacitive shunt at 1 p.u. of voltage", -1e9, 1e9)
    voltage_pu: float | None = parameter(
        None, "p.u.", "IEEE 14", "voltage that its units hold, None for none", 0.1, 10.0
    )
    x: float | None = design(None, "-", "where pictures show it, from the left; None: laid out", -1e6, 1e6)
    y: float | None = design(None, "-", "and from below", -1e6, 1e6)


@dataclass(frozen=True, kw_only=True)
class Branch(Checked):
    """A line or transformer as a π section; the tap is on the `from_bus` side. Values in p.u. of the system base."""

    from_bus: int = required("-", "IEEE 14", "bus at the tap's side")
    to_bus: int = required("-", "IEEE 14", "bus at the other end")
    resistance: float = required("p.u.", "IEEE 14", "series resistance", -1e6, 1e6)
    reactance: float = required("p.u.", "IEEE 14", "series reactance", -1e6, 1e6)
    charging: float = parameter(0.0, "p.u.", "IEEE 14", "charging susceptance of the whole line", -1e6, 1e6)
    tap: float = parameter(1.0, "-", "IEEE 14", "tap ratio", 0.01, 100.0)
    phase_rad: float = parameter(0.0, "rad", "IEEE 14", "phase shift", -2.0 * math.pi, 2.0 * math.pi)


@dataclass(frozen=True, kw_only=True)
class Source(Checked):
    """An imposed source: a voltage behind an impedance, whose frequency and angle events prescribe."""

    bus: int = required("-", "design", "bus number")
    resistance: float = design(0.0, "p.u.", "resistance behind which it stands, on the system base", 0.0, 1e3)
    reactance: float = design(1e-3, "p.u.", "reactance behind which it stands, on the system base", 1e-6, 1e3)


@dataclass(frozen=True, kw_only=True)
class NetworkCase(Checked):
    """A network with its synchronous machines, as data.

    The voltage angle at `slack_bus` is zero. Its machines or sources balance the power; without any, all WTG groups do.
    A ValueError says that a bus is missing, doubled or not connected, nothing balances the power, or a value is out of
    range.
    """

    MOST = types.MappingProxyType(
        {"buses": MOST_BUSES, "branches": 2 * MOST_BUSES, "machines": MOST_UNITS, "sources": MOST_UNITS}
    )

    name: str
    base_mva: float = required("MVA", "IEEE 14", "system base", 1e-3, 1e9)
    frequency_hz: float = required("Hz", "IEEE 14", "nominal frequency", 1.0, 1000.0)
    slack_bus: int
    buses: tuple[Bus, ...]
    branches: tuple[Branch, ...]
    machines: tuple[SynchronousMachineParameters, ...]
    sources: tuple[Source, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers = self.bus_numbers
        if len(set(numbers)) != len(numbers):
            raise ValueError(f"{self.name}: bus numbers must be unique, got {list(numbers)}")
        for branch in self.branches:
            self.bus_index(branch.from_bus)
            self.bus_index(branch.to_bus)
            if branch.from_bus == branch.to_bus:
                raise ValueError(f"{self.name}: a branch goes from bus {branch.from_bus} to itself")
            if branch.resistance == 0.0 and branch.reactance == 0.0:
                raise ValueError(f"{self.name}: branch {branch.from_bus}-{branch.to_bus} has no impedance")
        for bus in self.unit_buses:
            self.bus_index(bus)
        if self.machines and not self.balanced:
            raise ValueError(
                f"{self.name}: no synchronous machine or source at the slack bus {self.slack_bus} balances the power"
            )
        if len(self.parts_without(())) > 1:
            raise ValueError(f"{self.name}: the network is not connected")
        if self.buses[self.bus_index(self.slack_bus)].voltage_pu is None:
            raise ValueError(f"{self.name}: the slack bus {self.slack_bus} must hold a voltage; its voltage_pu is None")

    @functools.cached_property
    def bus_numbers(self) -> tuple[int, ...]:
        """Return the bus numbers in order of the index."""
        return tuple(bus.number for bus in self.buses)

    @property
    def unit_buses(self) -> tuple[int, ...]:
        """Bus of each machine, then of each source."""
        return (*(machine.bus for machine in self.machines), *(source.bus for source in self.sources))

    @property
    def balanced(self) -> bool:
        """Whether a machine or a source balances the power at the slack bus."""
        return self.slack_bus in self.unit_buses

    @functools.cached_property
    def load_mw(self) -> float:
        """Load of all buses [MW]."""
        return sum(bus.load_mw for bus in self.buses)

    def bus_index(self, number: int) -> int:
        """Return the index of a bus number; a ValueError lists the buses there are."""
        if isinstance(number, bool) or number not in self.bus_numbers:
            raise ValueError(f"unknown bus {number!r}; {self.name} has buses {list(self.bus_numbers)}")
        return self.bus_numbers.index(number)

    def branch_index(self, from_bus: int, to_bus: int, circuit: int | None = None) -> int:
        """Return the index of the branch between two buses, either way round; a ValueError lists the branches.

        `circuit` says which of parallel branches, counted from 1; None: the first.
        """
        self.bus_index(from_bus)
        self.bus_index(to_bus)
        circuits = self._branches_by_ends.get(frozenset((from_bus, to_bus)), [])
        if 0 < (circuit or 1) <= len(circuits):
            return circuits[(circuit or 1) - 1]
        if circuits:
            raise ValueError(f"no circuit {circuit} between buses {from_bus} and {to_bus}; there are {len(circuits)}")
        known = ", ".join(f"{b.from_bus}-{b.to_bus}" for b in self.branches)
        raise ValueError(f"no branch {from_bus}-{to_bus} in {self.name}; branches: {known}")

    @functools.cached_property
    def _branches_by_ends(self) -> dict[frozenset[int], list[int]]:
        indices: dict[frozenset[int], list[int]] = {}
        for index, branch in enumerate(self.branches):
            indices.setdefault(frozenset((branch.from_bus, branch.to_bus)), []).append(index)
        return indices

    def parts_without(self, branches: tuple[int, ...]) -> list[set[int]]:
        """Return the buses of each part that hangs together when the branches of these indices are open."""
        at = {number: place for place, number in enumerate(self.bus_numbers)}
        closed = [(at[b.from_bus], at[b.to_bus]) for index, b in enumerate(self.branches) if index not in branches]
        ends = np.array(closed, dtype=np.int64).reshape(-1, 2).T
        shape = (len(at), len(at))
        n, part_of = connected_components(coo_array((np.ones(ends.shape[1]), ends), shape=shape), directed=False)
        parts: list[set[int]] = [set() for _ in range(n)]
        for number, part in zip(self.bus_numbers, part_of.tolist(), strict=True):
            parts[part].add(number)
        return parts

    @functools.cached_property
    def bridges(self) -> frozenset[int]:
        """Return the indices of the branches any one of which splits the network when it opens."""
        return frozenset(index for index in range(len(self.branches)) if len(self.parts_without((index,))) > 1)

    def with_machines(
        self, change: Callable[[SynchronousMachineParameters], SynchronousMachineParameters]
    ) -> "NetworkCase":
        """Return the network with other machines: `change` turns each into its own."""
        return dataclasses.replace(self, machines=tuple(map(change, self.machines)))

    def classical(self) -> "NetworkCase":
        """Return the network with a constant voltage behind x'_d in place of every machine and its exciter."""
        return self.with_machines(lambda m: dataclasses.replace(m, classical=True, exciter=None, stabiliser=None))


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
    """A network with its machines and WTG groups, as a file describes it."""

    MOST = types.MappingProxyType({"groups": MOST_GROUPS, "replaced": MOST_UNITS})

    case: NetworkCase
    groups: tuple[WtgGroup, ...] = ()
    replaced: tuple[int, ...] = ()  # buses whose synchronous machines these stand for
    source: str = ""  # where the numbers come from
    licence: str = ""  # of the source
    repairs: tuple[str, ...] = ()  # what was changed because it contradicted itself, a sentence each
    substitutions: tuple[str, ...] = ()  # models that replace others, which are not here, a sentence each
    #: Largest loss that the grid is planned for [MW]; None: all that the machines at a bus give.
    incident_mw: float | None = design(None, "MW", "largest loss that the grid is planned for", 1e-3, 1e6)

    def __post_init__(self) -> None:
        super().__post_init__()
        for bus in (*self.replaced, *(group.bus for group in self.groups)):
            self.case.bus_index(bus)

    @functools.cached_property
    def infeeds_mw(self) -> Mapping[int, float]:
        """What the machines at each bus give together, those included that groups replace [MW]."""
        infeeds = dict.fromkeys((machine.bus for machine in self.case.machines), 0.0)
        for machine in self.case.machines:
            infeeds[machine.bus] += machine.dispatch_mw
        return types.MappingProxyType(infeeds)

    @property
    def largest_loss_mw(self) -> float:
        """The loss that the grid is planned for [MW]."""
        return max(self.infeeds_mw.values(), default=0.0) if self.incident_mw is None else self.incident_mw

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

    A ValueError says that the name is unknown, or the file is damaged.
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
    grid_fields = {field.name for field in dataclasses.fields(Grid)} - {"case"}
    if not isinstance(data, dict):
        raise ValueError("it must hold an object")
    case = {key: value for key, value in data.items() if key not in grid_fields}
    grid: Grid = record_of(Grid, {"case": case, **{key: value for key, value in data.items() if key in grid_fields}})
    return grid


def record_of(record: Any, data: Any) -> Any:
    """Return a dataclass from a JSON object; the records in it too."""
    if not isinstance(data, Mapping):
        raise ValueError(f"{record.__name__} must be an object, got {data!r:.80}")
    hints = get_type_hints(record)
    field_types = {field.name: hints[field.name] for field in dataclasses.fields(record)}
    require_known(record.__name__, data, list(field_types))
    nothing = dataclasses.MISSING
    needed = [field.name for field in dataclasses.fields(record) if field.default is field.default_factory is nothing]
    if missing := [name for name in needed if name not in data]:
        raise ValueError(f"{record.__name__} {dict(data)!r:.300} misses {', '.join(missing)}")
    for name, value in data.items():
        require_items(record, name, value)
    try:
        return record(**{name: _value(field_types[name], value) for name, value in data.items()})
    except ValueError as error:
        bus = data.get("bus", data.get("number"))
        raise ValueError(str(error) if bus is None else f"at bus {bus}: {error}") from error


def _value(hint: Any, value: Any) -> Any:
    """Return a value as the type of its field says: objects as records, lists as tuples of them."""
    records = [item for item in (get_args(hint) or (hint,)) if dataclasses.is_dataclass(item)]
    if isinstance(value, list):
        return tuple(record_of(records[0], item) if records else _value(None, item) for item in value)
    if not isinstance(value, Mapping) or not records:
        return value
    if records[0] not in MODELS.values():
        return record_of(records[0], value)
    fields = dict(value)
    models = [name for name, item in MODELS.items() if item in records]
    if (model := fields.pop("model", None)) not in models:
        raise ValueError(f"unknown model {model!r}; known here: {', '.join(models)}{did_you_mean(model, models)}")
    return record_of(MODELS[model], fields)


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
        return [data_of(item) for item in record]
    if not dataclasses.is_dataclass(record):
        return record
    model = getattr(record, "MODEL", None)
    data: dict[str, Any] = {} if model is None else {"model": model}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        factory: Any = field.default_factory
        default = field.default if factory is dataclasses.MISSING else factory()
        if value != default:
            data[field.name] = data_of(value)
    return data
