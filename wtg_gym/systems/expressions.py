"""Numbers that remember how they came about, and their derivatives in reverse.

A :class:`Number` is an operation on other numbers. Equal operations on equal numbers are the same number, and what only
depends on constants is worked out at once, so that a program of numbers holds nothing twice.
"""

import math
import operator
import threading
import types
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from wtg_gym.systems import elementary
from wtg_gym.systems import expressions as ex

#: Numbers are known to all threads.
_LOCK = threading.RLock()


class Number:
    """A number of a program: an operation and what it is applied to."""

    #: Constants of a plant are numpy's: they leave arithmetic to this class.
    __array_ufunc__ = None
    __slots__ = ("arguments", "operation", "order")
    _made: "dict[tuple[Any, ...], Number]" = {}  # noqa: RUF012

    def __init__(self, operation: str, arguments: tuple[Any, ...], order: int) -> None:
        self.operation, self.arguments, self.order = operation, arguments, order

    def __hash__(self) -> int:
        return id(self)

    def __bool__(self) -> bool:
        raise TypeError("a traced number is neither true nor false: equations say `select` instead of branching")


def _add_operator(name: str, operation: str, *, swapped: bool = False) -> None:
    """Give :class:`Number` an operator that is an operation, of its operands in the other order if `swapped`."""

    def operate(self: Number, *other: Any) -> Any:
        return number(operation, *other, self) if swapped else number(operation, self, *other)

    setattr(Number, f"__{name}__", operate)


for _name, _operation in (("add", "add"), ("sub", "sub"), ("mul", "mul"), ("truediv", "div")):
    _add_operator(_name, _operation)
    _add_operator(f"r{_name}", _operation, swapped=True)
for _name in ("neg", "abs", "lt", "le", "eq", "ne", "and", "or", "invert"):
    _add_operator(_name, _name)
for _name in ("and", "or"):
    _add_operator(f"r{_name}", _name)
for _name, _operation in (("rpow", "power"), ("gt", "lt"), ("ge", "le")):
    _add_operator(_name, _operation, swapped=True)
_add_operator("pow", "power")


def _plain(value: Any) -> Any:
    if isinstance(value, Number):
        return value
    return bool(value) if type(value).__name__ in ("bool", "bool_") else float(value)


def number(operation: str, *arguments: Any) -> Any:
    """Return an operation's result: a plain number where all arguments are, or where it follows from them."""
    operands = arguments if operation == "symbol" else tuple(_plain(argument) for argument in arguments)
    if operation != "symbol" and not any(isinstance(argument, Number) for argument in operands):
        return _CONSTANT[operation](*operands)
    known = None if operation == "symbol" else _simplified(operation, operands)
    if known is not None:
        return known
    key = (operation, *(_key(a) for a in operands))
    if key not in Number._made:
        Number._made[key] = Number(operation, operands, len(Number._made))
    return Number._made[key]


def _key(value: Any) -> tuple[Any, ...]:
    if isinstance(value, Number):
        return (id(value),)
    return (value,) if isinstance(value, str) else (value, math.copysign(1.0, value))


#: Whether a product with 0 is 0, and a sum with 0 is the other term, also of infinity and NaN, as in cotangents. The
#: bits of zeros and of numbers that are not finite may differ then.
_simplifies_zeros = False


@contextmanager
def making() -> Iterator[None]:
    """Make programs in one thread at a time, from no numbers: those of programs before would change their order."""
    with _LOCK:
        Number._made.clear()
        yield


@contextmanager
def simplifying_zeros() -> Iterator[None]:
    """Simplify products and sums with zeros within a program that is being made."""
    global _simplifies_zeros
    before, _simplifies_zeros = _simplifies_zeros, True
    try:
        yield
    finally:
        _simplifies_zeros = before


def symbol(name: str) -> Any:
    """Return a number that is known when the program runs."""
    return number("symbol", name)


def _is(value: Any, constant: float) -> bool:
    return not isinstance(value, Number) and value == constant


def _simplified(operation: str, operands: tuple[Any, ...]) -> Any:
    """Return what an operation comes to without being worked out; None where it must be."""
    first, second = operands[0], operands[1] if len(operands) > 1 else None
    zeros = _simplifies_zeros
    if operation == "mul" and zeros and (_is(first, 0.0) or _is(second, 0.0)):
        return 0.0
    if operation == "mul" and (_is(first, 1.0) or _is(second, 1.0)):
        return second if _is(first, 1.0) else first
    if operation == "add" and zeros and (_is(first, 0.0) or _is(second, 0.0)):
        return second if _is(first, 0.0) else first
    if operation == "sub" and _is(second, 0.0):
        return first
    if operation == "div" and ((zeros and _is(first, 0.0)) or _is(second, 1.0)):
        return first
    if operation == "select" and not isinstance(first, Number):
        return second if first else operands[2]
    if operation == "select" and second is operands[2]:
        return second
    return None


def _function_of(name: str) -> Callable[..., Any]:
    return lambda *arguments: number(name, *arguments)


select, smallest, largest, absolute = map(_function_of, ("select", "min", "max", "abs"))
square_root, exponential, floor, ceil = map(_function_of, ("sqrt", "exponential", "floor", "ceil"))
#: A random number, which follows nothing.
noise = _function_of("noise")
#: As libm has them; no derivative is known. :func:`sine_cosine` is what equations of motion use.
sine_of_libm, cosine_of_libm, arc_tangent, hypotenuse = map(_function_of, ("sin", "cos", "atan2", "hypot"))


def multiply_add(a: Any, b: Any, c: Any) -> Any:
    """Return a·b + c."""
    nothing = _simplifies_zeros and (_is(_plain(a), 0.0) or _is(_plain(b), 0.0))
    return c if nothing else number("fma", a, b, c)


def is_finite(a: Any) -> Any:
    return absolute(a) < math.inf


class Cells:
    """A table (n, m, 16) from a place on among the numbers that a program reads; which cell it is has no slope."""

    #: Its numbers, in their order.
    LEAVES = ("first", "n", "m")

    def __init__(self, first: Any, n: Any, m: Any) -> None:
        self.first, self.shape = first, (n, m, 16)

    def __getitem__(self, place: tuple[Any, Any, int]) -> Any:
        i, j, k = place
        return number("cell", self.first + ((i * self.shape[1] + j) * 16.0 + k))


def sine_cosine(angle: Any) -> tuple[Any, Any]:
    return number("sine", angle), number("cosine", angle)


_CONSTANT: dict[str, Callable[..., Any]] = {
    **{name: getattr(operator, name) for name in ("add", "sub", "mul", "neg", "abs", "lt", "le", "eq", "ne")},
    **{"div": operator.truediv, "power": operator.pow, "min": min, "max": max},
    **{"and": operator.and_, "or": operator.or_, "invert": operator.not_},
    **{name: getattr(math, name) for name in ("sqrt", "atan2", "hypot", "sin", "cos", "floor", "ceil")},
    **{name: getattr(elementary, name) for name in ("noise", "exponential", "select", "fma")},
    "sine": lambda a: elementary.sine_cosine(a)[0],
    "cosine": lambda a: elementary.sine_cosine(a)[1],
}


def _of_select(g: Any, _: Any, condition: Any, *__: Any) -> tuple[Any, ...]:
    return None, select(condition, g, 0.0), select(condition, 0.0, g)


def _of_quotient(g: Any, y: Any, _: Any, b: Any) -> tuple[Any, ...]:
    # A quotient by zero is one that a `select` leaves out: nothing may come back from it, not even 0/0.
    return select(b == 0.0, 0.0, g / b), select(b == 0.0, 0.0, -(g / b) * y)


#: The cotangents of the arguments, given that of the result, the result and the arguments; None for none.
_REVERSE: dict[str, Callable[..., tuple[Any, ...]]] = {
    "add": lambda g, y, a, b: (g, g),
    "sub": lambda g, y, a, b: (g, -g),
    "mul": lambda g, y, a, b: (g * b, g * a),
    "div": _of_quotient,
    "power": lambda g, y, a, b: (None, g * y * math.log(a)),
    "neg": lambda g, y, a: (-g,),
    "abs": lambda g, y, a: (select(a < 0.0, -g, g),),
    # Where both are equal: as if the first were chosen, like the functions themselves.
    "min": lambda g, y, a, b: (select(b < a, 0.0, g), select(b < a, g, 0.0)),
    "max": lambda g, y, a, b: (select(a < b, 0.0, g), select(a < b, g, 0.0)),
    "sqrt": lambda g, y, a: (select(y == 0.0, 0.0, 0.5 * g / y),),
    # It stays where it is below -40.
    "exponential": lambda g, y, a: (select(a < -40.0, 0.0, g * y),),
    "sine": lambda g, y, a: (g * sine_cosine(a)[1],),
    "cosine": lambda g, y, a: (-(g * sine_cosine(a)[0]),),
    "select": _of_select,
    "fma": lambda g, y, a, b, c: (g * b, g * a, g),
}


def needed(values: Iterable[Any]) -> list[Number]:
    """Return the numbers that some values depend on, and themselves, each after those that it depends on."""
    # In the order of a dictionary: that of a set differs from process to process, and with it what code is kept under.
    reached: dict[Number, None] = {}
    open_ = [value for value in values if isinstance(value, Number)]
    while open_:
        number = open_.pop()
        if number not in reached:
            reached[number] = None
            open_ += [a for a in number.arguments if isinstance(a, Number)]
    return sorted(reached, key=lambda number: number.order)


def pulled_back(outputs: Sequence[tuple[Any, Any]], sources: Iterable[Any]) -> dict[Number, Any]:
    """Return the cotangents of wanted symbols that have one, given pairs of an output and its cotangent."""
    symbols = set(sources)
    values = needed(value for value, _ in outputs)
    depends: set[Number] = set()
    for number in values:
        if number in symbols or (
            number.operation in _REVERSE and any(a in depends for a in number.arguments if isinstance(a, Number))
        ):
            depends.add(number)
    cotangents: dict[Number, Any] = {}

    def add(value: Any, cotangent: Any) -> None:
        if isinstance(value, Number) and cotangent is not None and value in depends:
            cotangents[value] = cotangent + cotangents[value] if value in cotangents else cotangent

    with simplifying_zeros():
        for value, cotangent in outputs:
            add(value, cotangent)
        for number in reversed(values):
            if number in cotangents and number.operation != "symbol":
                parts = _REVERSE[number.operation](cotangents[number], number, *number.arguments)
                for operand, part in zip(number.arguments, parts, strict=True):
                    add(operand, part)
    return {symbol: cotangents[symbol] for symbol in symbols if symbol in cotangents}


#: Meanings of names in equations while they are traced.
ARITHMETIC: dict[str, Any] = {
    "min": ex.smallest,
    "max": ex.largest,
    "abs": ex.absolute,
    "select": ex.select,
    "fma": ex.multiply_add,
    "sine_cosine": ex.sine_cosine,
    "exponential": ex.exponential,
    "noise": ex.noise,
    "math": SimpleNamespace(
        sqrt=ex.square_root,
        floor=ex.floor,
        ceil=ex.ceil,
        isfinite=ex.is_finite,
        sin=ex.sine_of_libm,
        cos=ex.cosine_of_libm,
        atan2=ex.arc_tangent,
        hypot=ex.hypotenuse,
        inf=math.inf,
        pi=math.pi,
    ),
    # Whole numbers are floats in rows: they stay what they are.
    "np": SimpleNamespace(int64=lambda value: value),
}


def retargeted(function: Any, done: dict[Any, Any] | None = None) -> Callable[..., Any]:
    """Return a function's source as a function whose names, and its callees', have the meanings of `ARITHMETIC`."""
    done = {} if done is None else done
    source = getattr(function, "py_func", function)
    if source in done:
        earlier: Callable[..., Any] = done[source]
        return earlier
    names = dict(source.__globals__)
    cells = tuple(types.CellType(cell.cell_contents) for cell in source.__closure__ or ())
    copy = types.FunctionType(source.__code__, names, source.__name__, source.__defaults__, cells)
    copy.__kwdefaults__ = source.__kwdefaults__
    done[source] = copy

    def converted(value: Any) -> Any:
        if isinstance(getattr(value, "py_func", value), types.FunctionType):
            return retargeted(value, done)
        if isinstance(value, types.ModuleType):
            return _Retargeted(value, converted)
        return tuple(map(converted, value)) if type(value) is tuple else value

    for cell in cells:
        cell.cell_contents = converted(cell.cell_contents)
    for name in _names_in(source.__code__):
        if name in ARITHMETIC or name in names:
            names[name] = ARITHMETIC[name] if name in ARITHMETIC else converted(names[name])
    return copy


class _Retargeted:
    """A module whose functions are retargeted."""

    def __init__(self, module: types.ModuleType, converted: Callable[[Any], Any]) -> None:
        self._module, self._converted = module, converted

    def __getattr__(self, name: str) -> Any:
        known = self._module is elementary and name in ARITHMETIC
        return ARITHMETIC[name] if known else self._converted(getattr(self._module, name))


def _names_in(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names_in(constant)
