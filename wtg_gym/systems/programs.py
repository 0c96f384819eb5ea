"""Programs: lists of systems, compiled once for all plants, and the table that says where a plant has its rows.

An entry of a program is a :class:`~wtg_gym.systems.systems.System`, which goes over all units of its kind, or one of
the few things that are no map over units: :class:`Product`, :class:`When`, :class:`Repeat`, :class:`Each`.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from wtg_gym.systems import expressions as ex
from wtg_gym.systems.records import flatten
from wtg_gym.systems.systems import SCALARS, Kind, Place, System, Trace, constants_of
from wtg_gym.systems.vectors import Lanes, repeated

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
_WHOLE = ir.IntType(64)
#: Numbers in a table's head for each entry: how many units, the places of its first row and its first constant, and of
#: its first row on the program's tape.
_HEAD = 4


class Product(NamedTuple):
    """`result` = `matrix` · `vector`, complex: a row of the matrix for each unit, all in scratch."""

    pairs: Kind  # whose units are the matrix' entries, row by row
    matrix: str
    units: Kind
    vector: str
    result: str


class When(NamedTuple):
    """Entries that run where a number of the lane is above zero in any lane of the block."""

    lane: Kind
    flag: str
    entries: tuple[Any, ...]


class Repeat(NamedTuple):
    """Entries that run, and again while a number of the lane is above zero in any lane, `most` times in all."""

    lane: Kind
    flag: str
    entries: tuple[Any, ...]
    most: int


class Each(NamedTuple):
    """For each unit of `outer` in turn: that system, then `inner` over that unit's share of its own units."""

    outer: System
    inner: System


class Tables(NamedTuple):
    """Where the systems of programs find the rows of a plant, and its constants."""

    table: Whole
    numbers: Floats


#: Scalars of a program that asks for none.
NONE = (0.0, 0.0, 0.0, 0.0)


class Arrangement(Protocol):
    """Where a plant has its rows, and what is constant."""

    def n_units(self, kind: Kind) -> int:
        """Return how many units of a kind there are."""

    def first_rows(self, kind: Kind, part: str) -> Whole:
        """Return the first row of a part of each unit, (n_units,), in the block or in scratch."""

    def seen(self, kind: Kind, label: str) -> Whole:
        """Return which unit of a kind that it sees each unit means, (n_units,)."""

    def constants(self, kind: Kind, name: str) -> Sequence[Any]:
        """Return a constant of each unit: records, or numbers (n_units,)."""

    def has(self, what: str) -> bool:
        """Return whether the plant has what a system is for."""


def systems_of(entries: Sequence[Any]) -> Iterator[System]:
    """Yield the systems among entries and within them, in their order."""
    for entry in entries:
        if isinstance(entry, System):
            yield entry
        elif isinstance(entry, Each):
            yield from entry
        elif isinstance(entry, (When, Repeat)):
            yield from systems_of(entry.entries)


def _flat(entries: Sequence[Any]) -> Iterator[Any]:
    """Yield everything that has a place in the head of a table."""
    for entry in entries:
        if isinstance(entry, Each):
            yield from entry
        else:
            yield entry
            if isinstance(entry, (When, Repeat)):
                yield from _flat(entry.entries)


class Program:
    """A list of entries, and where they stand in the table of all programs.

    Args:
        name: of the program.
        entries: systems and what is none.
        first: place of its first entry in the head of the table.
    """

    def __init__(self, name: str, entries: Sequence[Any], first: int) -> None:
        self.name, self.entries = name, tuple(entries)
        self.places = {id(entry): first + i for i, entry in enumerate(_flat(self.entries))}
        if len(self.places) < len(list(_flat(self.entries))):
            raise ValueError(f"a system stands in program {name!r} twice")

    @property
    def n_entries(self) -> int:
        """How many places it takes in the head of the table."""
        return len(self.places)

    def digest(self) -> str:
        """Return a hash of everything that its machine code depends on."""
        found = hashlib.sha256(repr(list(self.places.values())).encode())
        for one in systems_of(self.entries):
            found.update(repr((one.name, _slots(one), one.when)).encode())
            order = {number: i for i, number in enumerate(ex.needed(value for *_, value in one.trace.stores))}
            for number, _ in order.items():
                told = (order[a] if isinstance(a, ex.Number) else a for a in number.arguments)
                found.update(repr((number.operation, *told)).encode())
            stores = [(name, k, order.get(value, value)) for name, k, value in one.trace.stores]
            found.update(repr(stores).encode())
        return found.hexdigest()

    def function(self, **known: float) -> Callable[..., None]:
        """Return the program for numba: of (block, scratch, tables, scalars, lanes).

        Args:
            known: values of scalars; what follows from them is left out, and those handed over do not count.
        """
        program, writer = self, functools.partial(_Writer, known=known)

        @intrinsic
        def run(typing_context, block, scratch, tables, scalars, lanes) -> Any:  # type: ignore[no-untyped-def]
            return _written(program, writer, (block, scratch, tables, scalars, lanes))

        return cast("Callable[..., None]", run)

    def taped(self, *, runs: bool = True) -> Callable[..., None]:
        """Return the program that notes what the way back needs: of (block, scratch, tables, tape, scalars, lanes).

        Args:
            runs: change rows as the program does; else only note what they hold.
        """
        program, writer = self, _TapedWriter if runs else _NotingWriter

        @intrinsic
        def run(typing_context, block, scratch, tables, tape, scalars, lanes) -> Any:  # type: ignore[no-untyped-def]
            return _written(program, writer, (block, scratch, tables, tape, scalars, lanes))

        return cast("Callable[..., None]", run)

    def back(self, *, constants: bool = False) -> Callable[..., None]:
        """Return the way back through the program.

        It is of (bars, scratch_bars, tables, tape, scratch, constant_bars, scalars, lanes): cotangents (bars) of the
        rows in block and scratch after the program become those before it, and those of the constants, in their order
        in the tables, are added to.

        Args:
            constants: whether cotangents of the constants are wanted.
        """
        program, writer = self, _BackWriter if constants else _BackWithoutConstants

        @intrinsic
        def run(  # type: ignore[no-untyped-def]
            typing_context, bars, scratch_bars, tables, tape, scratch, constant_bars, scalars, lanes
        ) -> Any:
            arrays = (bars, scratch_bars, tables, tape, scratch, constant_bars, scalars, lanes)
            return _written(program, writer, arrays)

        return cast("Callable[..., None]", run)

    def tape_rows(self, plant: Arrangement) -> int:
        """Return how many rows a run of the program notes."""
        return sum(len(_noted(one)) * _n_units(one, plant) for one in systems_of(self.entries))


def _written(program: Program, writer: Any, kinds: Sequence[Any]) -> Any:
    """Return the signature of a program and what writes its instructions, as numba asks for them."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def data_of(kind: Any, argument: Any) -> list[Any]:
            if isinstance(kind, types.Array):
                return [context.make_array(kind)(context, builder, argument).data]
            parts = (builder.extract_value(argument, i) for i in range(len(kind)))
            return [each for own, part in zip(kind.types, parts, strict=True) for each in data_of(own, part)]

        *arrays, _, lanes = signature.args
        data = [each for pair in zip(arrays, arguments, strict=False) for each in data_of(*pair)]
        given = {name: builder.extract_value(arguments[-2], i) for i, name in enumerate(SCALARS)}
        writer(builder, len(lanes), data, given, program).write(program.entries)
        return context.get_dummy_value()

    return types.void(*kinds), code


def _n_units(one: System, plant: Arrangement) -> int:
    return plant.n_units(one.kind) if one.when is None or plant.has(one.when) else 0


def _noted(one: System) -> list[tuple[str, int]]:
    """Return the inputs of a system that its derivatives depend on, by argument and place within it."""
    adjoint = one.adjoint
    used = ex.needed((*adjoint.inputs.values(), *adjoint.constants.values()))
    return [adjoint.trace.inputs[number] for number in used if number in adjoint.trace.inputs]


def _slots(one: System) -> list[str]:
    """Return the parts whose rows a system is given, in the order of the table."""
    return list(dict.fromkeys((*one.reads, *one.writes)))


def _constants_used(one: System) -> list[str]:
    names = one.trace.constants
    return [names[number] for number in ex.needed(value for *_, value in one.trace.stores) if number in names]


class _Writer:
    """What writes the instructions of a program."""

    def __init__(
        self,
        builder: Any,
        width: int,
        data: Sequence[Any],
        scalars: Mapping[str, Any],
        program: Program,
        known: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self.block, self.scratch, self.table, self.numbers, *self.others = data
        self.builder, self.lanes = builder, Lanes(builder, width, self.numbers)
        self.scalars, self.program, self.known = scalars, program, known

    def write(self, entries: Sequence[Any]) -> None:
        for entry in entries:
            if isinstance(entry, System):
                with repeated(self.builder, self._head(entry, 0)) as unit:
                    self._system(entry, unit)
            elif isinstance(entry, Product):
                self._product(entry)
            elif isinstance(entry, When):
                with self.builder.if_then(self._is_up(entry)):
                    self.write(entry.entries)
            elif isinstance(entry, Repeat):
                self._repeat(entry)
            else:
                self._each(entry)

    def _head(self, entry: Any, which: int) -> Any:
        return self._whole(_WHOLE(_HEAD * self.program.places[id(entry)] + which))

    def _whole(self, place: Any) -> Any:
        return self.builder.load(self.builder.gep(self.table, [place]))

    def _system(self, one: System, unit: Any) -> None:
        """Write the instructions on one unit."""
        lanes, trace = self.lanes, one.trace_with(**self.known)
        rows = self._rows(one, unit)
        instruction = lanes.program(self._given(one, trace, unit, lambda name, k: lanes.load(self._at(rows[name], k))))
        self._note(one, unit, {at: instruction(symbol) for symbol, at in trace.inputs.items() if self._notes(one, at)})
        symbols = {at: symbol for symbol, at in trace.inputs.items()}
        used = set(ex.needed(value for *_, value in trace.stores))
        # What belongs to one number of a record is worked out and stored together: few numbers are held at a time.
        for name, k, value in sorted(trace.stores, key=lambda store: store[1]):
            if symbols.get((name, k)) is value:
                # It stays what it is.
                continue
            found = instruction(value)
            if symbols.get((name, k)) in used:
                # What is read later, too, is what was there before.
                instruction(symbols[name, k])
            lanes.store(found, self._at(rows[name], k))

    def _rows(self, one: System, unit: Any) -> dict[str, Any]:
        """Return pointers to the first row of each part that a system names."""
        slots, parts = _slots(one), {**one.reads, **one.targets}
        base = self.builder.add(self._head(one, 1), self.builder.mul(unit, _WHOLE(len(slots))))
        return {
            name: self._row(parts[name], self._whole(self.builder.add(base, _WHOLE(i)))) for i, name in enumerate(slots)
        }

    def _given(
        self, one: System, trace: Trace, unit: Any, read: Callable[[str, int], Any]
    ) -> dict[ex.Number, Callable[[], Any]]:
        """Return what gives the symbols of a trace."""
        builder, lanes = self.builder, self.lanes

        def constant(name: str) -> Any:
            return lanes.spread(builder.load(builder.gep(self.numbers, [self._constant_place(one, name, unit)])))

        return {
            **{symbol: functools.partial(read, *at) for symbol, at in trace.inputs.items()},
            **{symbol: functools.partial(constant, name) for symbol, name in trace.constants.items()},
            **{s: functools.partial(lanes.spread, self.scalars[name]) for s, name in trace.scalars.items()},
        }

    def _constant_place(self, one: System, name: str, unit: Any) -> Any:
        used = _constants_used(one)
        first = self.builder.add(self._head(one, 2), self.builder.mul(unit, _WHOLE(len(used))))
        return self.builder.add(first, _WHOLE(used.index(name)))

    def _notes(self, one: System, at: tuple[str, int]) -> bool:
        """Return whether an input goes onto a tape."""
        return False

    def _note(self, one: System, unit: Any, values: Mapping[tuple[str, int], Any]) -> None:
        """Write inputs onto the tape."""

    def _row(self, place: Place, row: Any) -> Any:
        """Return a pointer to a row."""
        first = self.scratch if place.in_scratch else self.block
        return self.builder.gep(first, [self.builder.mul(row, _WHOLE(self.lanes.width))])

    def _at(self, first: Any, k: int) -> Any:
        """Return a pointer to the row k after that of a pointer."""
        return self.builder.gep(first, [_WHOLE(k * self.lanes.width)])

    def _is_up(self, entry: When | Repeat) -> Any:
        place = entry.lane.find(entry.flag)
        assert place is not None
        return self.lanes.any_positive(self.lanes.load(self._row(place, self._head(entry, 1))))

    def _repeat(self, entry: Repeat) -> None:
        builder = self.builder
        before = builder.block
        body, done = builder.append_basic_block("again"), builder.append_basic_block("settled")
        builder.branch(body)
        builder.position_at_end(body)
        count = builder.phi(_WHOLE)
        count.add_incoming(_WHOLE(1), before)
        self.write(entry.entries)
        again = builder.and_(self._is_up(entry), builder.icmp_signed("<", count, _WHOLE(entry.most)))
        count.add_incoming(builder.add(count, _WHOLE(1)), builder.block)
        builder.cbranch(again, body, done)
        builder.position_at_end(done)

    def _each(self, entry: Each) -> None:
        builder = self.builder
        n_outer = self._head(entry.outer, 0)
        with repeated(builder, n_outer) as unit:
            self._system(entry.outer, unit)
            share = builder.sdiv(self._head(entry.inner, 0), n_outer)
            first = builder.mul(unit, share)
            with repeated(builder, share) as own:
                self._system(entry.inner, builder.add(first, own))

    def _product(self, entry: Product) -> None:
        builder, lanes = self.builder, self.lanes
        n, places = self._head(entry, 0), self._head(entry, 1)
        matrix, stride, vector, vector_stride, result, result_stride = (
            self._whole(builder.add(places, _WHOLE(i))) for i in range(6)
        )

        def load(row: Any) -> tuple[Any, Any]:
            first = builder.gep(self.scratch, [builder.mul(row, _WHOLE(lanes.width))])
            return lanes.load(first), lanes.load(self._at(first, 1))

        def rows(first_row: Any, n_rows: int) -> None:
            """Write the results of some rows of the matrix: several sums at once need not wait for each other."""
            entry_block = builder.block
            check, body, done = (builder.append_basic_block(name) for name in ("columns", "column", "summed"))
            builder.branch(check)
            builder.position_at_end(check)
            column = builder.phi(_WHOLE)
            column.add_incoming(_WHOLE(0), entry_block)
            sums = [[builder.phi(lanes.kind) for _ in range(2)] for _ in range(n_rows)]
            for pair in sums:
                for each in pair:
                    each.add_incoming(lanes.constant(0.0), entry_block)
            builder.cbranch(builder.icmp_signed("<", column, n), body, done)
            builder.position_at_end(body)
            e_re, e_im = load(builder.add(vector, builder.mul(column, vector_stride)))
            for i, (re, im) in enumerate(sums):
                place = builder.add(builder.mul(builder.add(first_row, _WHOLE(i)), n), column)
                y_re, y_im = load(builder.add(matrix, builder.mul(place, stride)))
                d_re = lanes.call("fma", y_re, e_re, builder.fneg(builder.fmul(y_im, e_im)))
                d_im = lanes.call("fma", y_re, e_im, builder.fmul(y_im, e_re))
                re.add_incoming(builder.fadd(re, d_re), builder.block)
                im.add_incoming(builder.fadd(im, d_im), builder.block)
            column.add_incoming(builder.add(column, _WHOLE(1)), builder.block)
            builder.branch(check)
            builder.position_at_end(done)
            for i, (re, im) in enumerate(sums):
                row = builder.add(result, builder.mul(builder.add(first_row, _WHOLE(i)), result_stride))
                first = builder.gep(self.scratch, [builder.mul(row, _WHOLE(lanes.width))])
                lanes.store(re, first)
                lanes.store(im, self._at(first, 1))

        pairs = builder.sdiv(n, _WHOLE(_ROWS_AT_ONCE))
        with repeated(builder, pairs) as pair:
            rows(builder.mul(pair, _WHOLE(_ROWS_AT_ONCE)), _ROWS_AT_ONCE)
        whole = builder.mul(pairs, _WHOLE(_ROWS_AT_ONCE))
        with repeated(builder, builder.sub(n, whole)) as rest:
            rows(builder.add(whole, rest), 1)


class _TapedWriter(_Writer):
    """Writes a program that notes on a tape what the way back needs."""

    def _notes(self, one: System, at: tuple[str, int]) -> bool:
        return at in _noted(one)

    def _note(self, one: System, unit: Any, values: Mapping[tuple[str, int], Any]) -> None:
        for k, at in enumerate(_noted(one)):
            self.lanes.store(values[at], self._on_tape(one, unit, k))

    def _on_tape(self, one: System, unit: Any, k: int) -> Any:
        """Return a pointer to what a system has noted of a unit."""
        tape, n = self.others[0], len(_noted(one))
        row = self.builder.add(self._head(one, 3), self.builder.add(self.builder.mul(unit, _WHOLE(n)), _WHOLE(k)))
        return self.builder.gep(tape, [self.builder.mul(row, _WHOLE(self.lanes.width))])


class _NotingWriter(_TapedWriter):
    """Writes a program that changes nothing, and only notes."""

    def _system(self, one: System, unit: Any) -> None:
        rows = self._rows(one, unit)
        self._note(one, unit, {at: self.lanes.load(self._at(rows[at[0]], at[1])) for at in _noted(one)})


class _BackWriter(_TapedWriter):
    """Writes the way back: what are rows of block and scratch elsewhere are their cotangents here."""

    with_constants = True

    def write(self, entries: Sequence[Any]) -> None:
        builder = self.builder
        for entry in reversed(entries):
            if isinstance(entry, System):
                n = self._head(entry, 0)
                with repeated(builder, n) as done:
                    self._system(entry, builder.sub(builder.sub(n, done), _WHOLE(1)))
            elif isinstance(entry, Product):
                self._product(entry)
            elif isinstance(entry, Each):
                self._each_back(entry)
            else:
                raise NotImplementedError(f"{type(entry).__name__} has no way back of its own")

    def _each_back(self, entry: Each) -> None:
        builder = self.builder
        n_outer = self._head(entry.outer, 0)
        with repeated(builder, n_outer) as done:
            unit = builder.sub(builder.sub(n_outer, done), _WHOLE(1))
            share = builder.sdiv(self._head(entry.inner, 0), n_outer)
            first = builder.mul(unit, share)
            with repeated(builder, share) as own:
                self._system(entry.inner, builder.add(first, own))
            self._system(entry.outer, unit)

    def _system(self, one: System, unit: Any) -> None:
        lanes, adjoint, rows, noted = self.lanes, one.adjoint, self._rows(one, unit), _noted(one)
        given = self._given(
            one, adjoint.trace, unit, lambda name, k: lanes.load(self._on_tape(one, unit, noted.index((name, k))))
        )
        bars = {at: lanes.load(self._at(rows[at[0]], at[1])) for at in adjoint.seeds.values()}
        given |= {symbol: functools.partial(bars.__getitem__, at) for symbol, at in adjoint.seeds.items()}
        instruction = lanes.program(given)
        written = set(adjoint.seeds.values())
        for at in sorted({*adjoint.inputs, *written}, key=lambda at: at[1]):
            pointer, found = self._at(rows[at[0]], at[1]), instruction(adjoint.inputs.get(at, 0.0))
            lanes.store(found if at in written else self.builder.fadd(lanes.load(pointer), found), pointer)
        for name, value in adjoint.constants.items() if self.with_constants else ():
            self._add_to_constant(one, name, unit, instruction(value))

    def _add_to_constant(self, one: System, name: str, unit: Any, value: Any) -> None:
        place = self.builder.mul(self._constant_place(one, name, unit), _WHOLE(self.lanes.width))
        pointer = self.builder.gep(self.others[2], [place])
        self.lanes.store(self.builder.fadd(self.lanes.load(pointer), value), pointer)

    def _product(self, entry: Product) -> None:
        """Pull the cotangents of the result back to the vector; the matrix lies in scratch, and has none."""
        builder, lanes = self.builder, self.lanes
        n, places = self._head(entry, 0), self._head(entry, 1)
        matrix, stride, vector, vector_stride, result, result_stride = (
            self._whole(builder.add(places, _WHOLE(i))) for i in range(6)
        )

        def at(data: Any, row: Any) -> Any:
            return builder.gep(data, [builder.mul(row, _WHOLE(lanes.width))])

        with repeated(builder, n) as i:
            bar = at(self.scratch, builder.add(result, builder.mul(i, result_stride)))
            re, im = lanes.load(bar), lanes.load(self._at(bar, 1))
            lanes.store(lanes.constant(0.0), bar)
            lanes.store(lanes.constant(0.0), self._at(bar, 1))
            with repeated(builder, n) as j:
                place = builder.add(builder.mul(i, n), j)
                y = at(self.others[1], builder.add(matrix, builder.mul(place, stride)))
                y_re, y_im = lanes.load(y), lanes.load(self._at(y, 1))
                e = at(self.scratch, builder.add(vector, builder.mul(j, vector_stride)))
                to_re = lanes.call("fma", y_re, re, lanes.call("fma", y_im, im, lanes.load(e)))
                to_im = lanes.call("fma", y_re, im, lanes.load(self._at(e, 1)))
                to_im = builder.fsub(to_im, builder.fmul(y_im, re))
                lanes.store(to_re, e)
                lanes.store(to_im, self._at(e, 1))


class _BackWithoutConstants(_BackWriter):
    """Writes the way back without cotangents of constants."""

    with_constants = False


#: Rows of a matrix that are multiplied side by side.
_ROWS_AT_ONCE = 2


def build_table(programs: Sequence[Program], plant: Arrangement, *, taped: bool = False) -> Tables:
    """Return the tables of programs for a plant.

    Args:
        programs, plant: what the table is for.
        taped: whether programs are run that note what the way back needs.
    """
    head = np.zeros((sum(program.n_entries for program in programs), _HEAD), dtype=np.int64)
    rows, numbers, cells = list[int](), list[float](), dict[Any, int]()
    for program in programs:
        n_taped = 0
        for entry in _flat(program.entries):
            own = head[program.places[id(entry)]]
            own[1] = head.size + len(rows)
            if isinstance(entry, System):
                n = _n_units(entry, plant)
                values = _constants_of(entry, plant, n, numbers, cells)
                own[0], own[2], own[3] = n, len(numbers), n_taped
                n_taped += len(_noted(entry)) * n if taped else 0
                rows += _system_rows(entry, plant, n)
                numbers += values
            elif isinstance(entry, Product):
                own[0] = plant.n_units(entry.units)
                rows += _product_rows(entry, plant)
            else:
                at = entry.lane.find(entry.flag)
                assert at is not None
                own[:2] = 1, plant.first_rows(at.kind, at.part)[0]
    table = np.concatenate([head.ravel(), np.array(rows, dtype=np.int64)])
    return Tables(table, np.array(numbers, dtype=np.float64))


def constant_places(
    programs: Sequence[Program], plant: Arrangement, tables: Tables, argument: str, leaf: str, unit: int | None
) -> list[int]:
    """Return where among its numbers a table has a constant.

    Args:
        programs, plant, tables: as :func:`build_table` was given and returned.
        argument, leaf: of the constant, as in "machine" and "governor.droop".
        unit: whose constant, among those of its kind; None for all of them.
    """
    found = []
    for program in programs:
        for one in systems_of(program.entries):
            used = _constants_used(one)
            place = one.kind.find_constant(argument)
            if place is None or f"{argument}.{leaf}" not in used:
                continue
            n = _n_units(one, plant)
            units = plant.seen(one.kind, place.seen)[:n] if place.seen else np.arange(n)
            first = int(tables.table[_HEAD * program.places[id(one)] + 2])
            found += [
                first + int(k) * len(used) + used.index(f"{argument}.{leaf}")
                for k in np.flatnonzero((units == unit) | (unit is None))
            ]
    return found


def _product_rows(entry: Product, plant: Arrangement) -> list[int]:
    rows: list[int] = []
    for kind, part in ((entry.pairs, entry.matrix), (entry.units, entry.vector), (entry.units, entry.result)):
        found = plant.first_rows(kind, part)
        rows += [int(found[0]) if found.size else 0, int(found[1] - found[0]) if found.size > 1 else 0]
    return rows


def _system_rows(one: System, plant: Arrangement, n: int) -> list[int]:
    """Return the first rows of a system's parts for each of n units."""
    if n == 0:
        return []
    parts = {**one.reads, **one.targets}
    found = [_rows_of(one.kind, parts[name], plant) for name in _slots(one)]
    rows: list[int] = np.stack(found, axis=1).ravel().tolist()
    return rows


def _rows_of(kind: Kind, place: Place, plant: Arrangement) -> Whole:
    found = plant.first_rows(place.kind, place.part) + place.offset
    return found if not place.seen else found[plant.seen(kind, place.seen)]


def _constants_of(one: System, plant: Arrangement, n: int, numbers: list[float], cells: dict[Any, int]) -> list[float]:
    """Return the constants of a system for each of n units; what tables hold is added to `numbers`."""
    used = _constants_used(one)
    if n == 0 or not used:
        return []
    values: dict[str, Floats] = {}
    for argument in dict.fromkeys(name.partition(".")[0] for name in used):
        place = one.kind.find_constant(argument)
        assert place is not None
        given = plant.constants(place.kind, place.part)
        if place.record is ex.Cells:
            key = place.kind, place.part
            if key not in cells:
                cells[key] = len(numbers)
                numbers += np.asarray(given).ravel().tolist()
            each: list[Any] = [(cells[key], *np.shape(given)[:2])] * n
        else:
            chosen = given if not place.seen else [given[i] for i in plant.seen(one.kind, place.seen)]
            each = [_numbers(value) for value in chosen]
        names = [name for name, _ in constants_of(argument, place.record)]
        table = np.array(each, dtype=np.float64).reshape(n, len(names))
        values |= dict(zip(names, table.T, strict=True))
    found: list[float] = np.stack([values[name] for name in used], axis=1).ravel().tolist()
    return found


def _numbers(value: Any) -> tuple[Any, ...]:
    """Return the numbers of a constant: a record, an entry of a structured array, or a number."""
    plain = value.item() if isinstance(value, np.void) else value
    return flatten(plain) if isinstance(plain, tuple) else (plain,)


def in_one_table(*before: Program, **entries: Sequence[Any]) -> tuple[Program, ...]:
    """Return programs by their names that share a table, behind that of programs before them."""
    found: list[Program] = []
    first = sum(program.n_entries for program in before)
    for name, own in entries.items():
        found.append(Program(name, own, first))
        first += found[-1].n_entries
    return tuple(found)
