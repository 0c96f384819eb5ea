"""Kinds of unit, and systems: pure functions of one unit in one environment.

A *kind* says what its units keep. Each part is a record, or a single number, and takes rows: of the environment where
it lasts from step to step, or of a scratch that a thread shares between its environments. A *system* names by its
arguments the parts that it reads, and by `writes` those that its result replaces. It sees the parts of its own unit,
and those of the units that its kind sees: the environment, the host of an attached unit, the two ends of a pair.

A system says nothing of loops, of how many units or environments there are, nor where rows lie.
"""

import functools
import inspect
import pickle
import pkgutil
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from wtg_gym.ranges import did_you_mean
from wtg_gym.systems import expressions as ex
from wtg_gym.systems.expressions import retargeted

_DTYPES = {float: np.float64, int: np.int64, bool: np.bool_, complex: np.complex128}


def is_record(value: Any) -> bool:
    return isinstance(value, type) and hasattr(value, "_fields")


@functools.cache
def leaves(record: Any) -> dict[str, Any]:
    """Return the types of a record's numbers by dotted names, in their order: "angle", …, "exciter.lead_lag", …"""
    types: dict[str, Any] = {}
    for name, hint in get_type_hints(record).items():
        types |= {f"{name}.{leaf}": type_ for leaf, type_ in leaves(hint).items()} if is_record(hint) else {name: hint}
    return types


@functools.cache
def short_names(record: Any) -> tuple[str, ...]:
    """Return the last part of each of :func:`leaves`' names: "lead_lag" of "exciter.lead_lag"."""
    return tuple(leaf.rpartition(".")[2] for leaf in leaves(record))


@functools.cache
def dtype(record: type) -> np.dtype[Any]:
    """Return the data type of a record of constants, with :func:`leaves` as names; floats, whole numbers and flags."""
    return np.dtype([(leaf, _DTYPES[type_]) for leaf, type_ in leaves(record).items()], align=True)


def flatten(value: Any) -> tuple[Any, ...]:
    """Return the numbers of a record, in the order of :func:`leaves`, or a single number."""
    return tuple(number for part in value for number in flatten(part)) if isinstance(value, tuple) else (value,)


def structured(record: type, entries: Any) -> np.ndarray[Any, np.dtype[Any]]:
    """Return entries of a record as a structured array."""
    return np.array([flatten(entry) for entry in entries], dtype=dtype(record))


def each(function: Callable[..., Any], *records: Any) -> Any:
    """Apply a function of numbers to every number of records of one class; return the record of the results."""
    if not is_record(type(records[0])):
        return function(*records)
    return type(records[0])(*(each(function, *values) for values in zip(*records, strict=True)))


#: Further rows in scratch of a state "x": "x_rates", and "x_base" and "x_sum" of the integration.
_OF_STATES = ("rates", "base", "sum")
#: Numbers that a caller hands to a program with every call.
SCALARS = ("fraction", "ahead", "first", "last")


@dataclass(frozen=True, eq=False, kw_only=True)
class Kind:
    """A kind of unit.

    The full name of a part is its label and its own name: "own_heat" in the unit itself, "unit_voltage" in a unit seen
    by the label "unit". That of a number within a record goes on: "own_state_pitch_angle". Systems use a full name, or
    any end of it that no other place has. A TypeError refuses a state that is not in rows, two parts of one
    name, and the label "own".
    """

    name: str  # in the plural; no other kind has it, and a copy is the same kind
    rows: Mapping[str, Any] = field(default_factory=dict)  # parts that an environment keeps: records, or float
    scratch: Mapping[str, Any] = field(default_factory=dict)  # parts that last for a control step only
    constants: Mapping[str, Any] = field(default_factory=dict)  # what is known of a unit before a run
    #: Other kinds whose parts its systems may name, by a label; of one that ends with "_" by full names only.
    sees: "Mapping[str, Kind]" = field(default_factory=dict)
    #: Parts that the integration moves. Each has three more in scratch, which are named as a whole: "x_rates", and the
    #: integration's own "x_base" and "x_sum".
    states: tuple[str, ...] = ()
    #: What a plant may have or lack, so that systems of the kind, and of those that see it, act or not.
    conditions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        of_states = {f"{state}_{what}": self.record_of(state, "rows") for state in self.states for what in _OF_STATES}
        # A copy of a kind has those of its states already.
        scratch = (name for name, record in self.scratch.items() if record is not of_states.get(name))
        names = [*self.rows, *of_states, *scratch, *self.constants]
        object.__setattr__(self, "scratch", {**of_states, **self.scratch})
        if len(set(self.states)) < len(self.states):
            raise TypeError(f"{self.name} have a state twice: {', '.join(self.states)}")
        if twice := [name for name in names if names.count(name) > 1]:
            raise TypeError(f"{self.name} have two parts with the name {twice[0]!r}")
        if "own" in (label.removesuffix("_") for label in self.sees):
            raise TypeError(f"{self.name} see {self.sees}: the label 'own' is that of the kind itself")
        if twice := [name for name, places in self.ends.items() if sum(place.name == name for place in places) > 1]:
            raise TypeError(f"{self.name} have a part, and a number within another one, with the name {twice[0]!r}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Kind) and self.name == other.name

    def __hash__(self) -> int:
        return hash(self.name)

    def __getstate__(self) -> dict[str, Any]:
        # A copy finds its names anew.
        return {name: value for name, value in vars(self).items() if name != "ends"}

    def record_of(self, part: str, *where: str) -> Any:
        """Return the record, or float, of a part in "rows" or "scratch"; a TypeError names the parts most like it."""
        parts = {name: record for place in where for name, record in getattr(self, place).items()}
        if part not in parts:
            raise TypeError(f"{self.name} have no part {part!r} in {' or '.join(where)}{did_you_mean(part, parts)}")
        return parts[part]

    def find(self, name: str, subject: str = "") -> "Place":
        """Return what a name, or the end of one, means to the systems of the kind.

        A TypeError, which begins with `subject` or the name, says that nothing has it, or that several places have it.
        """
        places = self.meanings(name)
        if len(places) == 1:
            return places[0]
        if not places:
            kinds = ", ".join(dict.fromkeys(kind.name for kind in self.sees.values())) or "nothing"
            problem = f"is no part or constant of {self.name}, nor of what they see: {kinds}"
            seen = {"own": self, **self.sees}.items()
            known = [end for label, kind in seen if not label.endswith("_") for end in kind.ends]
            parts = ((label, place) for label, kind in seen for places in kind.ends.values() for place in places)
            known += [f"{label.removesuffix('_')}_{place.name}" for label, place in parts]
            raise TypeError(f"{subject or repr(name)} {problem}{did_you_mean(name, known)}")
        several = " and ".join(f"{place.name!r} ({place.where} of {place.kind.name})" for place in places)
        raise TypeError(f"{subject or repr(name)} can mean {several}: use one of these full names")

    def meanings(self, name: str) -> "list[Place]":
        """Return all places that systems of the kind might mean by a name."""
        places = [Place(self, "", name, float, "scalars", name=name)] if name in SCALARS else []
        for label, kind in {"": self, **self.sees}.items():
            prefix = f"{label.removesuffix('_') or 'own'}_"
            rest = name.removeprefix(prefix)
            ends = [] if label.endswith("_") else kind.ends.get(name, [])
            full = [place for place in kind.ends.get(rest, []) if place.name == rest != name]
            places += [place._replace(seen=label, name=prefix + place.name) for place in (*ends, *full)]
        return places

    @functools.cached_property
    def ends(self) -> "dict[str, list[Place]]":
        """The kind's own parts, and numbers within records, by all ends of their names without a label."""
        places: dict[str, list[Place]] = {}
        of_states = {f"{state}_{what}" for state in self.states for what in _OF_STATES}
        for where in ("rows", "scratch", "constants"):
            for part, record in getattr(self, where).items():
                paths = [((part,), record)]
                if is_record(record) and where != "constants" and part not in of_states:
                    paths += [((part, *leaf.split(".")), float) for leaf in leaves(record)]
                for at, (path, means) in enumerate(paths):
                    place = Place(self, "", part, means, where, max(at - 1, 0), "_".join(path))
                    for first in range(len(path)):
                        places.setdefault("_".join(path[first:]), []).append(place)
        return places


class Place(NamedTuple):
    """What a name means."""

    kind: Kind  # whose units have it
    seen: str  # label under which that kind is seen; "" for the kind itself
    part: str
    record: Any
    where: str  # "rows", "scratch", "constants" or "scalars"
    offset: int = 0  # of a number within its part
    name: str = ""  # the full one

    @property
    def in_scratch(self) -> bool:
        """Whether it lies in scratch."""
        return self.where == "scratch"

    @property
    def has_rows(self) -> bool:
        """Whether it has rows, in the block or in scratch."""
        return self.where in ("rows", "scratch")


class Trace(NamedTuple):
    """A system as a program."""

    inputs: dict[ex.Number, tuple[str, int]]  # argument and place within it, of what is read in rows
    constants: dict[ex.Number, str]  # "argument" or "argument.leaf"
    scalars: dict[ex.Number, str]
    stores: list[tuple[str, int, Any]]  # part, place within it, value


class Adjoint(NamedTuple):
    """The adjoint of a system: cotangents of its inputs, from those of its outputs."""

    trace: Trace
    seeds: dict[ex.Number, tuple[str, int]]  # part and place within it, of what is written
    inputs: dict[tuple[str, int], Any]  # by argument and place within it
    constants: dict[str, Any]


@dataclass(frozen=True, eq=False)
class System:
    """A pure function over the units of a kind; :func:`system` makes it.

    A TypeError says that a name means nothing, or several things, that an annotation is not the record that the name
    means, that `when` is no condition, or that `backward` has other arguments.
    """

    kind: Kind
    equation: Callable[..., Any]
    writes: tuple[str, ...]  # parts that its result, or the entries of that tuple, replace
    when: str | None = None  # condition of the kind, or of those that it sees, under which it acts; None for any
    backward: Callable[..., Any] | None = None  # another function of the same arguments that has the derivatives
    arguments: tuple[str, ...] = ()  # their names, where the function takes any
    origin: tuple[Any, ...] | None = None  # function and arguments that make it again; None for one of a module

    def __post_init__(self) -> None:
        kinds = dict.fromkeys((self.kind, *self.kind.sees.values()))
        known = [condition for kind in kinds for condition in kind.conditions]
        if self.when is not None and self.when not in known:
            problem = f"is no condition of {self.kind.name} or of what they see: {', '.join(known) or 'none'}"
            raise TypeError(f"when={self.when!r} of system {self.name!r} {problem}{did_you_mean(self.when, known)}")
        if self.backward is not None and (back := _parameters(self.backward)) != self.arguments_named:
            raise TypeError(f"the way back of system {self.name!r} takes {back}, not {self.arguments_named}")
        for name in self.writes:
            if not self.places[name].has_rows:
                raise TypeError(f"system {self.name!r} writes {name!r}, which is one of the {self.places[name].where}")
        written = [self.row(name, k) for name in self.writes for k in range(count(self.places[name].record))]
        if len(set(written)) < len(written):
            raise TypeError(f"system {self.name!r} writes a number twice: {', '.join(self.writes)}")
        for name, annotation in self._annotations().items():
            record = self.places[name].record
            if annotation not in (Any, record):
                wrong, right = inspect.formatannotation(annotation), inspect.formatannotation(record)
                raise TypeError(
                    f"argument {name!r} of system {self.name!r} means {right}, but is annotated with {wrong}"
                )

    def _annotations(self) -> dict[str, Any]:
        if self.arguments:
            return {}
        function = inspect.unwrap(self.equation)
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        # A class that is defined within a function, and that the equation does not use, is known by its name only.
        known = {place.record.__name__: place.record for place in self.places.values()}
        known |= {**function.__globals__, **{name: cell.cell_contents for name, cell in cells}}
        try:
            hints = get_type_hints(self.equation, localns=known)
        except NameError as error:
            raise TypeError(f"an annotation of system {self.name!r} is unknown: {error}") from error
        return {name: hint for name, hint in hints.items() if name in self.arguments_named}

    def __reduce__(self) -> tuple[Any, ...]:
        if self.origin is not None:
            return self.origin
        module, name = self.equation.__module__, self.name
        if getattr(sys.modules.get(module), name, None) is not self:
            raise pickle.PicklingError(f"system {name!r} cannot be pickled: module {module} has none of this name")
        return pkgutil.resolve_name, (f"{module}:{name}",)

    def __deepcopy__(self, memo: Any) -> "System":
        return self

    @property
    def name(self) -> str:
        return self.equation.__name__

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self.equation(*arguments, **named)

    @functools.cached_property
    def places(self) -> dict[str, Place]:
        """What the arguments and the written names mean."""
        read = {name: f"argument {name!r} of system {self.name!r}" for name in self.arguments_named}
        written = {name: f"system {self.name!r} writes {name!r}, which" for name in self.writes}
        return {name: self.kind.find(name, subject) for name, subject in {**written, **read}.items()}

    @functools.cached_property
    def arguments_named(self) -> tuple[str, ...]:
        return self.arguments or _parameters(self.equation)

    def trace(self, **known: float) -> Trace:
        """Return the program of the equation, to the last bit, where some scalars are known."""
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
        trace = Trace({}, {}, {}, [])
        arguments = (known[name] if name in known else self._argument(name, trace) for name in self.arguments_named)
        result = retargeted(equation or self.equation)(*arguments)
        results = (result,) if not isinstance(result, tuple) or is_record(type(result)) else result
        if len(results) != len(self.writes):
            raise TypeError(f"system {self.name!r} writes {', '.join(self.writes)}, but returns {len(results)} values")
        for name, value in zip(self.writes, results, strict=True):
            type_, record = type(value) if is_record(type(value)) else float, self.places[name].record
            if type_ is not record:
                wrong, right = inspect.formatannotation(type_), inspect.formatannotation(record)
                raise TypeError(f"system {self.name!r} writes {wrong} to {name!r}, which is {right}")
            trace.stores.extend((name, place, number) for place, number in enumerate(flatten(value)))
        return trace

    @functools.cached_property
    def adjoint(self) -> Adjoint:
        """The derivatives of the equation, pulled back."""
        with ex.making():
            trace = self.traced({}, self.backward)
            seeds = {ex.symbol(f"bar of {name}[{k}]"): (name, k) for name, k, _ in trace.stores}
            pairs = [(value, seed) for (*_, value), seed in zip(trace.stores, seeds, strict=True)]
            cotangents = ex.pulled_back(pairs, (*trace.inputs, *trace.constants))
            # A row has one cotangent, by whatever names a system reads and writes it.
            places = {self.row(*at): at for at in (*trace.inputs.values(), *seeds.values())}
            inputs: dict[tuple[str, int], Any] = {}
            for symbol, at in trace.inputs.items():
                if symbol in cotangents:
                    key = places[self.row(*at)]
                    inputs[key] = inputs[key] + cotangents[symbol] if key in inputs else cotangents[symbol]
        constants = {name: cotangents[symbol] for symbol, name in trace.constants.items() if symbol in cotangents}
        return Adjoint(trace, seeds, inputs, constants)

    @functools.cached_property
    def slots(self) -> list[str]:
        """Parts whose rows the system is given, in the order of a table."""
        return list(dict.fromkeys(name for name in (*self.arguments_named, *self.writes) if self.places[name].has_rows))

    @functools.cached_property
    def constants_used(self) -> list[str]:
        """Constants that the result depends on."""
        names, stores = self.trace().constants, self.trace().stores
        return [names[number] for number in ex.needed(value for *_, value in stores) if number in names]

    @functools.cached_property
    def noted(self) -> list[tuple[str, int]]:
        """Inputs that the derivatives depend on, by argument and place within it."""
        adjoint = self.adjoint
        used = ex.needed((*adjoint.inputs.values(), *adjoint.constants.values()))
        return [adjoint.trace.inputs[number] for number in used if number in adjoint.trace.inputs]

    def row(self, name: str, k: int) -> tuple[str, str, int]:
        """Return which row an argument's number is: by label, part and place in it, whatever it is called here."""
        place = self.places[name]
        return place.seen, place.part, place.offset + k

    def _argument(self, name: str, trace: Trace) -> Any:
        record = self.places[name].record
        if self.places[name].has_rows:
            inputs = {ex.symbol(f"{name}[{k}]"): (name, k) for k in range(count(record))}
            trace.inputs.update(inputs)
            return built(record, iter(inputs))
        if self.places[name].where == "scalars":
            symbol = ex.symbol(name)
            trace.scalars[symbol] = name
            return symbol
        values = []
        for leaf, hint in constants_of(name, record):
            symbol = ex.symbol(leaf)
            trace.constants[symbol] = leaf
            values.append(symbol != 0.0 if hint is bool else symbol)
        return ex.Cells(*values) if record is ex.Cells else built(record, iter(values))


def _parameters(function: Callable[..., Any]) -> tuple[str, ...]:
    return tuple(inspect.signature(function).parameters)


def system(
    kind: Kind, *writes: str, when: str | None = None, backward: Callable[..., Any] | None = None
) -> Callable[[Callable[..., Any]], System]:
    """Return a decorator that makes a :class:`System` of a function."""
    return lambda equation: System(kind, equation, writes, when, backward)


def setting(kind: Kind, when: str | None = None, **values: Any) -> System:
    """Return a system that sets parts of every unit of a kind to given values: numbers, or records."""
    result = tuple(values.values())

    def set_values() -> Any:
        return result

    origin = functools.partial(setting, kind, when, **values), ()
    return System(kind, set_values, tuple(values), when, origin=origin)


def count(record: Any) -> int:
    """Return how many numbers a part has: a record, or a single number."""
    return len(leaves(record)) if is_record(record) else 1


def built(record: Any, values: Iterator[Any]) -> Any:
    """Return a record, or a single number, of values in the order of its numbers."""
    if not is_record(record):
        return next(values)
    return record(*(built(hint, values) for hint in get_type_hints(record).values()))


def constants_of(name: str, record: Any) -> list[tuple[str, Any]]:
    """Return the numbers of a constant with their types: "name", or "name.leaf" for those of a record or a table."""
    if record is ex.Cells:
        return [(f"{name}.{leaf}", float) for leaf in ex.Cells.LEAVES]
    if not is_record(record):
        return [(name, record)]
    return [(f"{name}.{leaf}", type_) for leaf, type_ in leaves(record).items()]
