"""Programs: lists of systems, compiled once for all plants, and linked to the rows and constants of each plant.

An entry of a program is a :class:`~wtg_gym.systems.systems.System`, which goes over all units of its kind, or a control
block: :class:`Product`, :class:`When`, :class:`Repeat`, :class:`Each`.
"""

import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.systems import expressions as ex
from wtg_gym.systems.systems import Kind, Place, System, constants_of, count, flatten

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Complex = npt.NDArray[np.complex128]
#: Columns of the head of `Code.rows`, which has a line for each entry: number of units; index of its first row, of its
#: first constant, of its first row on the tape.
HEAD = 4
#: Entries of a program, at most.
_MOST = 40


@dataclass(frozen=True, eq=False)
class Product:
    """`result` = `matrix` · `vector`, complex: a row of the matrix for each unit of the result, vectors in scratch."""

    pairs: Kind  # whose units are the matrix' entries, row by row
    matrix: str
    units: Kind
    vector: str
    result: str
    of: Kind | None = None  # whose result it is; None: of the same units

    def __post_init__(self) -> None:
        records = (
            self.pairs.record_of(self.matrix, "rows", "scratch"),
            self.units.record_of(self.vector, "scratch"),
            (self.of or self.units).record_of(self.result, "scratch"),
        )
        if any(count(record) != 2 for record in records):
            names = f"{self.matrix!r}, {self.vector!r} and {self.result!r}"
            raise TypeError(f"{names} of a product must be complex numbers")


@dataclass(frozen=True, eq=False)
class _Flagged:
    """Entries that a number of the environment lets run."""

    env: Kind
    flag: str
    entries: tuple[Any, ...]

    def __post_init__(self) -> None:
        if not self.place.has_rows or self.place.record is not float:
            raise TypeError(f"{self.flag!r} of {self.env.name} is no single number that an environment has")

    @property
    def place(self) -> Place:
        """Where the number lies."""
        return self.env.find(self.flag)


@dataclass(frozen=True, eq=False)
class When(_Flagged):
    """Entries that run where a number of the environment is above zero in any environment of the block."""


@dataclass(frozen=True, eq=False)
class Repeat(_Flagged):
    """Entries that run, and again while a number of the environment is above zero in any, `most` times in all."""

    most: int


class Here(NamedTuple):
    """Marks where systems of devices, or of optional controls, are inserted."""

    name: StrEnum


class Each(NamedTuple):
    """For each unit of `outer` in turn: that system, then `inner` over that unit's share of its own units."""

    outer: System
    inner: System


class Code(NamedTuple):
    """Programs linked to a plant: the rows and constants that they read, and where their machine code is."""

    rows: Whole = np.zeros(0, dtype=np.int64)
    constants: Floats = np.zeros(0)
    addresses: Whole = np.zeros(0, dtype=np.int64)  # in this process, from systems.routines.addresses_of

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy may live in another process.
        return Code, (self.rows, self.constants)


class MemoryMap(NamedTuple):
    """Where a plant has its rows, and what is constant."""

    n_units: Callable[[Kind], int]
    first_rows: Callable[[Kind, str], Whole]  # of a part of each unit (n_units,), in the block or in scratch
    seen: Callable[[Kind, str], Whole]  # index of the unit that each unit of a kind sees by a label (n_units,)
    constants: Mapping[tuple[Kind, str], Sequence[Any]]  # of each unit: records, or numbers (n_units,)
    conditions: Collection[str]  # that hold: what the plant has of what systems are for


def _flat(entries: Sequence[Any]) -> Iterator[Any]:
    """Yield everything that has a place in the head of the rows."""
    for entry in entries:
        if isinstance(entry, Each):
            yield from entry
        else:
            yield entry
            if isinstance(entry, (When, Repeat)):
                yield from _flat(entry.entries)


def _with(entries: Sequence[Any], joining: Mapping[str, Sequence[System]]) -> Iterator[Any]:
    """Yield entries, with the systems of devices where they join."""
    for entry in entries:
        if isinstance(entry, Here):
            yield from joining.get(entry.name, ())
        elif isinstance(entry, (When, Repeat)):
            yield replace(entry, entries=tuple(_with(entry.entries, joining)))
        else:
            yield entry


class Program:
    """A list of systems and control blocks, the program of a number among those that are linked together."""

    def __init__(self, name: str, entries: Sequence[Any], number: int) -> None:
        self.name, self.number, self._unjoined = name, number, tuple(entries)
        self.entries: tuple[Any, ...] = tuple(_with(entries, {}))
        self.places = {id(entry): _MOST * number + i for i, entry in enumerate(_flat(self.entries))}
        self.systems = [entry for entry in _flat(self.entries) if isinstance(entry, System)]
        self._digests: dict[bool, str] = {}
        if len(self.places) > _MOST:
            raise ValueError(f"program {name!r} has {len(self.places)} entries; allowed: at most {_MOST}")
        if len(self.places) < len(list(_flat(self.entries))):
            raise ValueError(f"a system stands in program {name!r} twice")

    def joined(self, joining: Mapping[str, Sequence[System]]) -> "Program":
        """Return the program with systems of devices, by the places where they join."""
        return Program(self.name, tuple(_with(self._unjoined, joining)), self.number) if joining else self

    def digest(self, *, back: bool = False) -> str:
        """Return a hash of everything that its machine code depends on, or that of the way back through it."""
        if back not in self._digests:
            content = self.name, list(self.places.values()), [_content(entry) for entry in self.entries]
            sha = hashlib.sha256(repr(content).encode())
            for system in self.systems:
                for line in _operations(system, back=back):
                    sha.update(repr(line).encode())
            self._digests[back] = sha.hexdigest()
        return self._digests[back]

    def tape_rows(self, plant: MemoryMap) -> int:
        """Return how many rows a run of the program notes."""
        return sum(len(system.noted) * _n_units(system, plant) for system in self.systems)


def _content(entry: Any) -> tuple[Any, ...]:
    """Return the structure of an entry, without the operations of systems, and the entries within it."""
    if isinstance(entry, System):
        slots = [(slot, entry.places[slot].in_scratch) for slot in entry.slots]
        return entry.name, slots, entry.constants_used, entry.when
    if isinstance(entry, Each):
        return "each", _content(entry.outer), _content(entry.inner)
    if isinstance(entry, (When, Repeat)):
        most = entry.most if isinstance(entry, Repeat) else 1
        return type(entry).__name__, entry.place.in_scratch, most, [_content(inner) for inner in entry.entries]
    if isinstance(entry, Product):
        return "product", entry.matrix in entry.pairs.rows
    return (type(entry).__name__,)


def _operations(system: System, *, back: bool) -> Iterator[Any]:
    """Yield what the machine code of a system works out, or that of the way back through it."""
    stores: list[tuple[Any, Any]] = [((name, k), value) for name, k, value in system.trace().stores]
    if back:
        stores += [*system.adjoint.inputs.items(), *system.adjoint.constants.items()]
        yield system.noted, list(system.adjoint.seeds.values())
    order = {number: i for i, number in enumerate(ex.needed(value for _, value in stores))}
    for number in order:
        yield number.operation, *(order[a] if isinstance(a, ex.Number) else a for a in number.arguments)
    yield [(at, order.get(value, value)) for at, value in stores]


def _n_units(entry: Any, plant: MemoryMap) -> int:
    if isinstance(entry, System):
        return plant.n_units(entry.kind) if entry.when is None or entry.when in plant.conditions else 0
    return plant.n_units(entry.units) if isinstance(entry, Product) else 1


def link(programs: Sequence[Program], plant: MemoryMap, taped: Sequence[Program] = ()) -> Code:
    """Return programs linked to a plant; `taped` are those of them that have a way back."""
    head = np.zeros((_MOST * len(programs), HEAD), dtype=np.int64)
    rows, numbers, cells = list[int](), list[float](), dict[Any, int]()
    for program in programs:
        n_taped = 0
        for entry in _flat(program.entries):
            row, n = head[program.places[id(entry)]], _n_units(entry, plant)
            row[:] = n, head.size + len(rows), len(numbers), n_taped
            if isinstance(entry, System):
                # Tables of cells come before the constants of the system.
                values = _constants_of(entry, plant, n, numbers, cells)
                row[2] = len(numbers)
                rows += _system_rows(entry, plant, n)
                numbers += values
                n_taped += len(entry.noted) * n if program in taped else 0
            elif isinstance(entry, Product):
                rows += _product_rows(entry, plant)
            else:
                row[1] = plant.first_rows(entry.place.kind, entry.place.part)[0] + entry.place.offset
    return Code(np.concatenate([head.ravel(), np.array(rows, dtype=np.int64)]), np.array(numbers, dtype=np.float64))


def constant_places(
    programs: Sequence[Program], plant: MemoryMap, code: Code, argument: str, leaf: str, unit: int | None
) -> list[int]:
    """Return where among its constants linked code has one, as :func:`link` was given and returned.

    Argument and leaf are as in "machine" and "governor.droop"; the unit is None for all of its kind.
    """
    indices, name = list[int](), f"{argument}.{leaf}"
    for program in programs:
        for system in program.systems:
            used = system.constants_used
            if name in used:
                n, place = _n_units(system, plant), system.places[argument]
                units = plant.seen(system.kind, place.seen)[:n] if place.seen else np.arange(n)
                first = int(code.rows[HEAD * program.places[id(system)] + 2]) + used.index(name)
                indices += (first + len(used) * np.flatnonzero((units == unit) | (unit is None))).tolist()
    return indices


def _product_rows(entry: Product, plant: MemoryMap) -> list[int]:
    """Return, of matrix, vector and result, the first row and how many rows later that of the next unit is."""
    of, places = entry.of or entry.units, list[int]()
    for kind, part in (entry.pairs, entry.matrix), (entry.units, entry.vector), (of, entry.result):
        rows = plant.first_rows(kind, part)
        places += [int(rows[0]) if rows.size else 0, int(rows[1] - rows[0]) if rows.size > 1 else 0]
    return [*places, plant.n_units(of) if plant.n_units(entry.pairs) else 0]


def _system_rows(system: System, plant: MemoryMap, n: int) -> list[int]:
    columns = []
    for place in (system.places[name] for name in system.slots) if n else ():
        rows = plant.first_rows(place.kind, place.part) + place.offset
        columns.append(rows[plant.seen(system.kind, place.seen)] if place.seen else rows)
    flat: list[int] = np.stack(columns, axis=1).ravel().tolist() if columns else []
    return flat


def _constants_of(system: System, plant: MemoryMap, n: int, numbers: list[float], cells: dict[Any, int]) -> list[float]:
    """Return the constants of a system for each of n units; those kept in tables are added to `numbers`."""
    used = system.constants_used
    if n == 0 or not used:
        return []
    values: dict[str, Floats] = {}
    for argument in dict.fromkeys(name.partition(".")[0] for name in used):
        place = system.places[argument]
        constants = plant.constants[place.kind, place.part]
        if place.record is ex.Cells:
            key = place.kind, place.part
            if key not in cells:
                cells[key] = len(numbers)
                numbers += np.asarray(constants).ravel().tolist()
            entries: list[Any] = [(cells[key], *np.shape(constants)[:2])] * n
        else:
            chosen = constants if not place.seen else [constants[i] for i in plant.seen(system.kind, place.seen)]
            entries = [flatten(value.item() if isinstance(value, np.void) else value) for value in chosen]
        names = [name for name, _ in constants_of(argument, place.record)]
        table = np.array(entries, dtype=np.float64).reshape(n, len(names))
        values |= dict(zip(names, table.T, strict=True))
    flat: list[float] = np.stack([values[name] for name in used], axis=1).ravel().tolist()
    return flat


def unconditional(entries: Sequence[Any]) -> tuple[Any, ...]:
    """Replace each `When` by its entries, for systems that do nothing where its condition fails."""
    return tuple(inner for entry in entries for inner in (entry.entries if isinstance(entry, When) else (entry,)))


def numbered(*before: Program, **entries: Sequence[Any]) -> tuple[Program, ...]:
    """Return programs by their names, numbered on from `before`; a plant links them together."""
    return tuple(Program(name, part, i) for i, (name, part) in enumerate(entries.items(), start=len(before)))
