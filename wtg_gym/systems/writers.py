"""The instructions of programs on the lanes of a block: forward, on a tape, and the way back."""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from llvmlite import ir

from wtg_gym.systems import expressions as ex
from wtg_gym.systems.programs import HEAD, Each, Product, Program, Repeat, When
from wtg_gym.systems.systems import Place, System, Trace
from wtg_gym.systems.vectors import Lanes, accumulated, repeated

_WHOLE = ir.IntType(64)
#: Rows of a matrix that are multiplied side by side.
_ROWS_AT_ONCE = 2


class Writer:
    """What writes the instructions of a program."""

    #: Arrays that its routines are given, and what they do.
    n_arrays, purpose = 2, "run"

    def __init__(
        self,
        builder: Any,
        width: int,
        data: Sequence[Any],
        scalars: Mapping[str, Any],
        program: Program,
        known: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self.block, self.scratch, self.rows, self.constants, *others = data
        # On a tape alone; the scratch of the way there, and cotangents of constants, on the way back alone.
        self.tape, self.matrices, self.constant_bars = (*others, None, None, None)[:3]
        self.builder, self.lanes = builder, Lanes(builder, width, self.constants)
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
        return self._whole(_WHOLE(HEAD * self.program.places[id(entry)] + which))

    def _whole(self, place: Any) -> Any:
        return self.builder.load(self.builder.gep(self.rows, [place]))

    def _system(self, system: System, unit: Any) -> None:
        lanes, trace = self.lanes, system.trace(**self.known)
        rows = self._rows(system, unit)
        inputs = self._inputs(system, trace, unit, lambda name, k: lanes.load(self._at(rows[name], k)))
        instruction = lanes.program(inputs)
        noted = {at: instruction(symbol) for symbol, at in trace.inputs.items() if self._notes(system, at)}
        self._note(system, unit, noted)
        used = set(ex.needed(value for *_, value in trace.stores))
        # A row may be read by another name than it is written by.
        symbols: dict[Any, list[ex.Number]] = {}
        for symbol, at in trace.inputs.items():
            symbols.setdefault(system.row(*at), []).append(symbol)
        # Each number of a record is computed and stored in one go: few numbers are held at a time.
        for name, k, value in sorted(trace.stores, key=lambda store: store[1]):
            before = symbols.get(system.row(name, k), [])
            if any(symbol is value for symbol in before):
                # It stays what it is.
                continue
            result = instruction(value)
            for symbol in before:
                # A later read needs the earlier value.
                if symbol in used:
                    instruction(symbol)
            lanes.store(result, self._at(rows[name], k))

    def _rows(self, system: System, unit: Any) -> dict[str, Any]:
        slots, places, add = system.slots, system.places, self.builder.add
        base = add(self._head(system, 1), self.builder.mul(unit, _WHOLE(len(slots))))
        return {name: self._row(places[name], self._whole(add(base, _WHOLE(i)))) for i, name in enumerate(slots)}

    def _inputs(
        self, system: System, trace: Trace, unit: Any, read: Callable[[str, int], Any]
    ) -> dict[ex.Number, Callable[[], Any]]:
        builder, lanes = self.builder, self.lanes
        first = builder.gep(self.constants, [self._first_constant(system, unit)])

        def constant(name: str) -> Any:
            return lanes.spread(builder.load(builder.gep(first, [_WHOLE(system.constants_used.index(name))])))

        return {
            **{symbol: functools.partial(read, *at) for symbol, at in trace.inputs.items()},
            **{symbol: functools.partial(constant, name) for symbol, name in trace.constants.items()},
            **{s: functools.partial(lanes.spread, self.scalars[name]) for s, name in trace.scalars.items()},
        }

    def _first_constant(self, system: System, unit: Any) -> Any:
        return self.builder.add(self._head(system, 2), self.builder.mul(unit, _WHOLE(len(system.constants_used))))

    def _notes(self, system: System, at: tuple[str, int]) -> bool:
        return False

    def _note(self, system: System, unit: Any, values: Mapping[tuple[str, int], Any]) -> None:
        """Write inputs onto the tape."""

    def _row(self, place: Place, row: Any) -> Any:
        first = self.scratch if place.in_scratch else self.block
        return self._pointer(first, row)

    def _at(self, first: Any, k: int) -> Any:
        return self.builder.gep(first, [_WHOLE(k * self.lanes.width)])

    def _is_up(self, entry: When | Repeat) -> Any:
        return self.lanes.any_positive(self.lanes.load(self._row(entry.place, self._head(entry, 1))))

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
        n_outer = self._head(entry.outer, 0)
        with repeated(self.builder, n_outer) as unit:
            self._system(entry.outer, unit)
            self._share(entry, unit, n_outer)

    def _share(self, entry: Each, unit: Any, n_outer: Any) -> None:
        share = self.builder.sdiv(self._head(entry.inner, 0), n_outer)
        first = self.builder.mul(unit, share)
        with repeated(self.builder, share) as inner:
            self._system(entry.inner, self.builder.add(first, inner))

    def _places(self, entry: Any, which: Iterable[int]) -> list[Any]:
        first = self._head(entry, 1)
        return [self._whole(self.builder.add(first, _WHOLE(i))) for i in which]

    def _pointer(self, data: Any, row: Any) -> Any:
        return self.builder.gep(data, [self.builder.mul(row, _WHOLE(self.lanes.width))])

    def _complex(self, data: Any, row: Any) -> tuple[Any, Any, Any]:
        """Return where a complex number lies, and its parts."""
        first = self._pointer(data, row)
        return first, self.lanes.load(first), self.lanes.load(self._at(first, 1))

    def _store_complex(self, first: Any, re: Any, im: Any) -> None:
        self.lanes.store(re, first)
        self.lanes.store(im, self._at(first, 1))

    def _product(self, entry: Product) -> None:
        builder, lanes = self.builder, self.lanes
        n = self._head(entry, 0)
        matrix, stride, vector, vector_stride, result, result_stride, n_results = self._places(entry, range(7))
        of_matrix = self.block if entry.matrix in entry.pairs.rows else self.scratch

        def rows(first_row: Any, n_rows: int) -> None:
            """Write the results of some rows of the matrix: several sums at once need not wait for each other."""
            zeros = [lanes.constant(0.0)] * (2 * n_rows)
            with accumulated(builder, n, zeros) as (column, sums, following):
                _, e_re, e_im = self._complex(self.scratch, builder.add(vector, builder.mul(column, vector_stride)))
                for i, (re, im) in enumerate(zip(sums[::2], sums[1::2], strict=True)):
                    place = builder.add(builder.mul(builder.add(first_row, _WHOLE(i)), n), column)
                    _, y_re, y_im = self._complex(of_matrix, builder.add(matrix, builder.mul(place, stride)))
                    d_re = lanes.call("fma", y_re, e_re, builder.fneg(builder.fmul(y_im, e_im)))
                    d_im = lanes.call("fma", y_re, e_im, builder.fmul(y_im, e_re))
                    following += builder.fadd(re, d_re), builder.fadd(im, d_im)
            for i, (re, im) in enumerate(zip(sums[::2], sums[1::2], strict=True)):
                row = builder.add(result, builder.mul(builder.add(first_row, _WHOLE(i)), result_stride))
                self._store_complex(self._pointer(self.scratch, row), re, im)

        pairs = builder.sdiv(n_results, _WHOLE(_ROWS_AT_ONCE))
        with repeated(builder, pairs) as pair:
            rows(builder.mul(pair, _WHOLE(_ROWS_AT_ONCE)), _ROWS_AT_ONCE)
        whole = builder.mul(pairs, _WHOLE(_ROWS_AT_ONCE))
        with repeated(builder, builder.sub(n_results, whole)) as rest:
            rows(builder.add(whole, rest), 1)


class TapedWriter(Writer):
    """Writes a program that notes on a tape what the way back needs."""

    n_arrays, purpose = 3, "taped"

    def _notes(self, system: System, at: tuple[str, int]) -> bool:
        return at in system.noted

    def _note(self, system: System, unit: Any, values: Mapping[tuple[str, int], Any]) -> None:
        first = self._on_tape(system, unit)
        for k, at in enumerate(system.noted):
            self.lanes.store(values[at], self._at(first, k))

    def _on_tape(self, system: System, unit: Any) -> Any:
        """Return a pointer to the first that a system has noted of a unit."""
        row = self.builder.add(self._head(system, 3), self.builder.mul(unit, _WHOLE(len(system.noted))))
        return self._pointer(self.tape, row)


class NotingWriter(TapedWriter):
    """Writes a program that changes nothing, and only notes."""

    purpose = "noted"

    def _system(self, system: System, unit: Any) -> None:
        rows = self._rows(system, unit)
        self._note(system, unit, {at: self.lanes.load(self._at(rows[at[0]], at[1])) for at in system.noted})


class BackWriter(TapedWriter):
    """Writes the adjoint: rows of block and scratch hold cotangents here."""

    n_arrays, purpose, with_constants = 5, "back with constants", True

    def write(self, entries: Sequence[Any]) -> None:
        builder = self.builder
        for entry in reversed(entries):
            if isinstance(entry, (System, Each)):
                outer = entry.outer if isinstance(entry, Each) else entry
                n = self._head(outer, 0)
                with repeated(builder, n) as done:
                    unit = builder.sub(builder.sub(n, done), _WHOLE(1))
                    if isinstance(entry, Each):
                        self._share(entry, unit, n)
                    self._system(outer, unit)
            elif isinstance(entry, Product):
                self._product(entry)
            else:
                raise NotImplementedError(f"{type(entry).__name__} has no way back of its own")

    def _system(self, system: System, unit: Any) -> None:
        lanes, adjoint, rows, noted = self.lanes, system.adjoint, self._rows(system, unit), system.noted
        first = self._on_tape(system, unit)
        symbols = self._inputs(
            system, adjoint.trace, unit, lambda name, k: lanes.load(self._at(first, noted.index((name, k))))
        )
        bars = {at: lanes.load(self._at(rows[at[0]], at[1])) for at in adjoint.seeds.values()}
        symbols |= {symbol: functools.partial(bars.__getitem__, at) for symbol, at in adjoint.seeds.items()}
        instruction = lanes.program(symbols)
        written = set(adjoint.seeds.values())
        for at in sorted({*adjoint.inputs, *written}, key=lambda at: at[1]):
            pointer, cotangent = self._at(rows[at[0]], at[1]), instruction(adjoint.inputs.get(at, 0.0))
            lanes.store(cotangent if at in written else self.builder.fadd(lanes.load(pointer), cotangent), pointer)
        for name, value in adjoint.constants.items() if self.with_constants else ():
            first_constant = self._pointer(self.constant_bars, self._first_constant(system, unit))
            pointer = self._at(first_constant, system.constants_used.index(name))
            lanes.store(self.builder.fadd(lanes.load(pointer), instruction(value)), pointer)

    def _product(self, entry: Product) -> None:
        """Pull the cotangents of the result back to the vector; the matrix lies in scratch, and has none."""
        builder, lanes = self.builder, self.lanes
        n = self._head(entry, 0)
        matrix, stride, vector, vector_stride, result, result_stride = self._places(entry, range(6))
        with repeated(builder, n) as i:
            bar, re, im = self._complex(self.scratch, builder.add(result, builder.mul(i, result_stride)))
            self._store_complex(bar, lanes.constant(0.0), lanes.constant(0.0))
            with repeated(builder, n) as j:
                place = builder.add(builder.mul(i, n), j)
                _, y_re, y_im = self._complex(self.matrices, builder.add(matrix, builder.mul(place, stride)))
                e, e_re, e_im = self._complex(self.scratch, builder.add(vector, builder.mul(j, vector_stride)))
                to_re = lanes.call("fma", y_re, re, lanes.call("fma", y_im, im, e_re))
                to_im = builder.fsub(lanes.call("fma", y_re, im, e_im), builder.fmul(y_im, re))
                self._store_complex(e, to_re, to_im)


class BackWithoutConstants(BackWriter):
    """Writes the way back without cotangents of constants."""

    purpose, with_constants = "back", False
