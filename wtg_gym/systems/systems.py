"""Kinds of unit, and systems: pure functions of one unit in one lane.

A *kind* says what its units keep. Each part is a record, or a single number, and takes rows: of the lane where it lasts
from step to step, or of a scratch that a thread shares between its lanes. A *system* names by its arguments the parts
that it reads, and by `writes` those that its result replaces. It sees the parts of its own unit, and those of the units
that its kind sees: the lane, the host of an attached unit, the two ends of a pair.

A system says nothing of loops, of how many units or lanes there are, nor where rows lie.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import pickle
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, get_type_hints

from wtg_gym.systems import expressions as ex
from wtg_gym.systems.records import flatten, is_record, kinds_of, leaves, short_names, size
from wtg_gym.systems.tracing import retargeted


@dataclass(frozen=True, eq=False, kw_only=True)
class Kind:
    """A kind of unit.

    Args:
        name: of the kind, in the plural; no other kind has it, and a copy is the same kind.
        rows: parts that every lane keeps, by name: record classes, or float.
        scratch: parts that last for a control step only.
        constants: what is known of a unit before a run.
        sees: other kinds whose parts its systems may name, by a label; one that ends with "_" stands before the names.
        states: parts that the integration moves. Each has three more in scratch: "x_rates", and the integration's own
            "x_base" and "x_sum".
    """

    name: str
    rows: Mapping[str, Any] = field(default_factory=dict)
    scratch: Mapping[str, Any] = field(default_factory=dict)
    constants: Mapping[str, Any] = field(default_factory=dict)
    sees: Mapping[str, Kind] = field(default_factory=dict)
    states: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        own = {f"{state}_{what}": self.rows[state] for state in self.states for what in ("rates", "base", "sum")}
        object.__setattr__(self, "scratch", {**own, **self.scratch})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Kind) and self.name == other.name

    def __hash__(self) -> int:
        return hash(self.name)

    def find(self, argument: str) -> Place | None:
        """Return where an argument of a system lies: a part, or a number of a part by its short name; None for none."""
        for label, kind, name in self._meanings(argument):
            for in_scratch, parts in enumerate((kind.rows, kind.scratch)):
                if name in parts:
                    return Place(kind, label, name, parts[name], in_scratch=bool(in_scratch))
        for label, kind, name in self._meanings(argument):
            for in_scratch, parts in enumerate((kind.rows, kind.scratch)):
                for part, record in parts.items():
                    if is_record(record) and name in short_names(record):
                        offset = short_names(record).index(name)
                        return Place(kind, label, part, float, in_scratch=bool(in_scratch), offset=offset)
        return None

    def find_constant(self, argument: str) -> Place | None:
        """Return whose constant an argument is; None for none."""
        for label, kind, name in self._meanings(argument):
            if name in kind.constants:
                return Place(kind, label, name, kind.constants[name], in_scratch=False)
        return None

    def _meanings(self, argument: str) -> Iterator[tuple[str, Kind, str]]:
        """Yield the kinds that may have something of this name, with their labels and what they call it."""
        yield "", self, argument
        for label, kind in self.sees.items():
            prefix = label if label.endswith("_") else ""
            if argument.startswith(prefix):
                yield label, kind, argument.removeprefix(prefix)


class Place(NamedTuple):
    """What an argument is."""

    kind: Kind  # whose units have it
    seen: str  # label under which that kind is seen; "" for the kind itself
    part: str
    record: Any
    in_scratch: bool
    offset: int = 0  # of a number within its part


#: Numbers that a caller hands to a program with every call.
SCALARS = ("fraction", "ahead", "first", "last")


class Trace(NamedTuple):
    """A system as a program."""

    inputs: dict[ex.Number, tuple[str, int]]  # argument and place within it, of what is read in rows
    constants: dict[ex.Number, str]  # "argument" or "argument.leaf"
    scalars: dict[ex.Number, str]
    stores: list[tuple[str, int, Any]]  # part, place within it, value


class Adjoint(NamedTuple):
    """A system pulled back: cotangents of what it reads, from those of what it writes."""

    trace: Trace
    seeds: dict[ex.Number, tuple[str, int]]  # part and place within it, of what is written
    inputs: dict[tuple[str, int], Any]  # by argument and place within it
    constants: dict[str, Any]


@dataclass(frozen=True, eq=False)
class System:
    """A pure function over the units of a kind; :func:`system` makes it.

    Args:
        kind: whose units it is applied to.
        equation: the function.
        writes: the parts that its result, or the entries of that tuple, replace.
        when: what a plant must have for the system to act; None for any.
        backward: another function of the same arguments that has the derivatives to follow; None for the equation.
        arguments: their names, where the function takes any.
        origin: function and arguments that make it again; None for a function of a module.
    """

    kind: Kind
    equation: Callable[..., Any]
    writes: tuple[str, ...]
    when: str | None = None
    backward: Callable[..., Any] | None = None
    arguments: tuple[str, ...] = ()
    origin: tuple[Any, ...] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        if self.origin is not None:
            return self.origin
        module, name = self.equation.__module__, self.equation.__qualname__
        if getattr(sys.modules.get(module), name, None) is not self:
            raise pickle.PicklingError(f"system {name!r} cannot be pickled: module {module} has none of this name")
        return _of_module, (module, name)

    def __deepcopy__(self, memo: Any) -> System:
        return self

    @property
    def name(self) -> str:
        """Name of the function."""
        name: str = getattr(self.equation, "py_func", self.equation).__name__
        return name

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Evaluate the equation."""
        return self.equation(*arguments, **named)

    @functools.cached_property
    def reads(self) -> dict[str, Place]:
        """Parts that the arguments name."""
        return {a: place for a in self.arguments_named if (place := self.kind.find(a)) is not None}

    @functools.cached_property
    def targets(self) -> dict[str, Place]:
        """Parts that the result replaces."""
        found = {name: self.kind.find(name) for name in self.writes}
        if unknown := [name for name, place in found.items() if place is None]:
            raise TypeError(f"system {self.name!r} writes {unknown[0]!r}, which no unit of {self.kind.name} has")
        return {name: place for name, place in found.items() if place is not None}

    @property
    def arguments_named(self) -> tuple[str, ...]:
        """Names of the arguments."""
        return self.arguments or tuple(inspect.signature(getattr(self.equation, "py_func", self.equation)).parameters)

    @property
    def trace(self) -> Trace:
        """The program of the equation, to the last bit."""
        return self.trace_with()

    def trace_with(self, **known: float) -> Trace:
        """Return the program of the equation where some scalars are known."""
        key = tuple(sorted((name, value) for name, value in known.items() if name in self.arguments_named))
        if key not in self._traces:
            with ex.making():
                self._traces[key] = self.traced(known)
        return self._traces[key]

    @functools.cached_property
    def _traces(self) -> dict[Any, Trace]:
        return {}

    def traced(self, known: Mapping[str, float], equation: Callable[..., Any] | None = None) -> Trace:
        """Run the equation on numbers that remember; `known` has the values of some scalars."""
        found = Trace({}, {}, {}, [])
        given = {name: known[name] if name in known else self._given(name, found) for name in self.arguments_named}
        result = retargeted(equation or self.equation)(*given.values())
        results = (result,) if not isinstance(result, tuple) or is_record(type(result)) else result
        for name, value in zip(self.writes, results, strict=True):
            values = flatten(value) if is_record(type(value)) else (value,)
            if len(values) != count(self.targets[name].record):
                raise TypeError(f"system {self.name!r} writes {len(values)} numbers to {name!r}")
            found.stores.extend((name, place, each) for place, each in enumerate(values))
        return found

    @functools.cached_property
    def adjoint(self) -> Adjoint:
        """The derivatives of the equation, pulled back."""
        with ex.making():
            trace = self.traced({}, self.backward)
            seeds = {ex.symbol(f"bar of {name}[{k}]"): (name, k) for name, k, _ in trace.stores}
            pairs = [(value, seed) for (*_, value), seed in zip(trace.stores, seeds, strict=True)]
            found = ex.pulled_back(pairs, (*trace.inputs, *trace.constants))
            # A row has one cotangent, by whatever names a system reads and writes it.
            places = {self.row(*at): at for at in (*trace.inputs.values(), *seeds.values())}
            inputs: dict[tuple[str, int], Any] = {}
            for symbol, at in trace.inputs.items():
                if symbol in found:
                    own = places[self.row(*at)]
                    inputs[own] = inputs[own] + found[symbol] if own in inputs else found[symbol]
        constants = {name: found[symbol] for symbol, name in trace.constants.items() if symbol in found}
        return Adjoint(trace, seeds, inputs, constants)

    @functools.cached_property
    def slots(self) -> list[str]:
        """Parts whose rows the system is given, in the order of a table."""
        return list(dict.fromkeys((*self.reads, *self.writes)))

    @functools.cached_property
    def constants_used(self) -> list[str]:
        """Constants that the result depends on."""
        names = self.trace.constants
        return [names[number] for number in ex.needed(value for *_, value in self.trace.stores) if number in names]

    @functools.cached_property
    def noted(self) -> list[tuple[str, int]]:
        """Inputs that the derivatives depend on, by argument and place within it."""
        adjoint = self.adjoint
        used = ex.needed((*adjoint.inputs.values(), *adjoint.constants.values()))
        return [adjoint.trace.inputs[number] for number in used if number in adjoint.trace.inputs]

    def row(self, name: str, k: int) -> tuple[str, str, int]:
        """Return which row an argument's number is: by label, part and place in it, whatever it is called here."""
        place = self.reads.get(name) or self.targets[name]
        return place.seen, place.part, place.offset + k

    def _given(self, name: str, found: Trace) -> Any:
        if name in self.reads:
            return built(self.reads[name].record, self._symbols(name, found))
        if name in SCALARS:
            symbol = ex.symbol(name)
            found.scalars[symbol] = name
            return symbol
        constant = self.kind.find_constant(name)
        if constant is None:
            raise TypeError(
                f"argument {name!r} of system {self.name!r} is no part or constant of {self.kind.name}, nor of what "
                f"they see: {', '.join(kind.name for kind in self.kind.sees.values())}"
            )
        values = self._constants(name, constant.record, found)
        return ex.Cells(*values) if constant.record is ex.Cells else built(constant.record, values)

    def _symbols(self, name: str, found: Trace) -> Iterator[Any]:
        for place in range(count(self.reads[name].record)):
            symbol = ex.symbol(f"{name}[{place}]")
            found.inputs[symbol] = (name, place)
            yield symbol

    @staticmethod
    def _constants(name: str, record: Any, found: Trace) -> Iterator[Any]:
        for leaf, kind in constants_of(name, record):
            symbol = ex.symbol(leaf)
            found.constants[symbol] = leaf
            yield symbol != 0.0 if kind is bool else symbol


def _of_module(module: str, name: str) -> Any:
    return getattr(importlib.import_module(module), name)


def system(
    kind: Kind, *writes: str, when: str | None = None, backward: Callable[..., Any] | None = None
) -> Callable[[Callable[..., Any]], System]:
    """Return a decorator that makes a :class:`System` of a function."""
    return lambda equation: System(kind, equation, writes, when, backward)


def count(record: Any) -> int:
    """Return how many numbers a part has: a record, or a single number."""
    return size(record) if is_record(record) else 1


def built(record: Any, values: Iterator[Any]) -> Any:
    """Return a record, or a single number, of values in the order of its numbers."""
    if not is_record(record):
        return next(values)
    return record(*(built(kind, values) for kind in get_type_hints(record).values()))


def constants_of(name: str, record: Any) -> list[tuple[str, Any]]:
    """Return the numbers of a constant with their types: "name", or "name.leaf" for those of a record or a table."""
    if record is ex.Cells:
        return [(f"{name}.{leaf}", float) for leaf in ex.Cells.LEAVES]
    if not is_record(record):
        return [(name, record)]
    return [(f"{name}.{leaf}", kind) for leaf, kind in zip(leaves(record), kinds_of(record), strict=True)]
