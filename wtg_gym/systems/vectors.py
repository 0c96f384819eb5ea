"""Traces as machine code: the operations of a system on all lanes of a block at once.

Rows may lie anywhere, and numbers of units are known when the code runs: linked code has both. No loop over lanes is
left for the compiler to find, and none over rows, so that one compilation serves every plant.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from llvmlite import ir
from numba.core import cgutils

from wtg_gym.systems import elementary
from wtg_gym.systems import expressions as ex
from wtg_gym.systems.expressions import retargeted

_DOUBLE, _WHOLE, _BIT = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
#: Operations that are polynomials of others, and what they are applied to.
_POLYNOMIALS = {"sine": elementary.sine_cosine, "cosine": elementary.sine_cosine, "exponential": elementary.exponential}
_COMPARED = {"lt": "<", "le": "<=", "eq": "=="}
_DIRECT = {
    **{"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "neg": "fneg"},
    **{"and": "and_", "or": "or_", "invert": "not_", "select": "select"},
}
_INTRINSIC = {"fma": "fma", "sqrt": "sqrt", "abs": "fabs", "floor": "floor", "ceil": "ceil"}
#: Functions of libm, called for one lane after the other.
_OF_LIBM = {"power": "llvm.pow.f64", "sin": "llvm.sin.f64", "cos": "llvm.cos.f64", "atan2": "atan2", "hypot": "hypot"}


class Lanes:
    """Instructions on numbers that have one value per lane: vectors, or plain numbers for a block of width 1.

    `constants` is a pointer to the constants of the code, tables of cells among them.
    """

    def __init__(self, builder: Any, width: int, constants: Any) -> None:
        self.builder, self.width, self.constants = builder, width, constants
        self.vector = _DOUBLE if width == 1 else ir.VectorType(_DOUBLE, width)
        self.bits = _BIT if width == 1 else ir.VectorType(_BIT, width)

    def constant(self, value: Any) -> Any:
        type_ = self.bits if isinstance(value, bool) else self.vector
        number = bool(value) if isinstance(value, bool) else float(value)
        return ir.Constant(type_, number if self.width == 1 else [number] * self.width)

    def spread(self, value: Any) -> Any:
        """Return a number, the same in all lanes."""
        if self.width == 1:
            return value
        undefined = ir.Constant(self.vector, ir.Undefined)
        first = self.builder.insert_element(undefined, value, _WHOLE(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), self.width), [0] * self.width)
        return self.builder.shuffle_vector(first, undefined, zeros)

    def load(self, pointer: Any) -> Any:
        """Return what lies at a pointer to the first lane's number."""
        return self.builder.load(self._of_lanes(pointer), align=8)

    def store(self, value: Any, pointer: Any) -> None:
        """Write where a pointer to the first lane's number points."""
        self.builder.store(value, self._of_lanes(pointer), align=8)

    def _of_lanes(self, pointer: Any) -> Any:
        return pointer if self.width == 1 else self.builder.bitcast(pointer, self.vector.as_pointer())

    def call(self, name: str, *arguments: Any) -> Any:
        """Return what an intrinsic function of LLVM gives."""
        suffix = "f64" if self.width == 1 else f"v{self.width}f64"
        return self._called(f"llvm.{name}.{suffix}", self.vector, arguments)

    def _called(self, name: str, result: Any, arguments: Sequence[Any]) -> Any:
        signature = ir.FunctionType(result, [argument.type for argument in arguments])
        return self.builder.call(cgutils.get_or_insert_function(self.builder.module, signature, name), arguments)

    def each(self, operate: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a function of plain numbers gives in every lane."""
        if self.width == 1:
            return operate(*arguments)
        result = ir.Constant(self.vector, ir.Undefined)
        for x in range(self.width):
            value = operate(*(self.builder.extract_element(argument, _WHOLE(x)) for argument in arguments))
            result = self.builder.insert_element(result, value, _WHOLE(x))
        return result

    def any_positive(self, value: Any) -> Any:
        """Return whether a number is above zero in any lane."""
        above = self.builder.fcmp_ordered(">", value, self.constant(0.0))
        if self.width == 1:
            return above
        return self._called(f"llvm.vector.reduce.or.v{self.width}i1", _BIT, (above,))

    def program(self, symbols: Mapping[ex.Number, Callable[[], Any]]) -> Callable[[Any], Any]:
        """Return a function that gives numbers of a trace as instructions; `symbols` give the symbols among them."""
        known: dict[Any, Any] = {}

        def instruction(number: Any) -> Any:
            if not isinstance(number, ex.Number):
                return self.constant(number)
            for operand in ex.needed([number]) if number not in known else ():
                if operand in known:
                    continue
                if operand in symbols:
                    known[operand] = symbols[operand]()
                elif operand.operation in _POLYNOMIALS:
                    self._work_out_polynomial(operand, instruction, known)
                else:
                    known[operand] = self._operation(operand.operation, *(instruction(a) for a in operand.arguments))
            return known[number]

        return instruction

    def _work_out_polynomial(self, number: ex.Number, instruction: Callable[[Any], Any], known: dict[Any, Any]) -> None:
        function = _POLYNOMIALS[number.operation]
        key = function, number.arguments[0]
        if key not in known:
            argument = instruction(number.arguments[0])
            with ex.making():
                symbol = ex.symbol("x")
                results = retargeted(function)(symbol)
                results = results if isinstance(results, tuple) else (results,)
                inner = self.program({symbol: lambda: argument})
            known[key] = [inner(result) for result in results]
        known[number] = known[key][1 if number.operation == "cosine" else 0]

    def _operation(self, operation: str, *a: Any) -> Any:
        builder = self.builder
        if operation in _DIRECT:
            return getattr(builder, _DIRECT[operation])(*a)
        if operation in _INTRINSIC:
            return self.call(_INTRINSIC[operation], *a)
        if operation in _COMPARED:
            return builder.fcmp_ordered(_COMPARED[operation], *a)
        if operation == "ne":
            return builder.fcmp_unordered("!=", *a)
        if operation in ("max", "min"):
            return builder.select(builder.fcmp_ordered(">" if operation == "max" else "<", a[1], a[0]), a[1], a[0])
        if operation in _OF_LIBM:
            signature = ir.FunctionType(_DOUBLE, [_DOUBLE] * len(a))
            function = cgutils.get_or_insert_function(builder.module, signature, _OF_LIBM[operation])
            return self.each(lambda *operands: builder.call(function, operands), *a)
        if operation == "noise":
            return self._noise(*a)
        if operation == "cell":
            return self.each(lambda at: builder.load(builder.gep(self.constants, [builder.fptosi(at, _WHOLE)])), *a)
        raise NotImplementedError(operation)

    def _noise(self, seed: Any, step: Any, channel: Any) -> Any:
        """Return :func:`~wtg_gym.systems.elementary.noise`, in whole numbers of 64 bits."""
        builder = self.builder
        integer = _WHOLE if self.width == 1 else ir.VectorType(_WHOLE, self.width)

        def whole(value: int) -> Any:
            return ir.Constant(integer, value if self.width == 1 else [value] * self.width)

        def cut(word: Any) -> Any:
            return builder.and_(word, whole(0xFFFFFFFF))

        def scrambled(word: Any) -> Any:
            for shift, factor in elementary.SCRAMBLING:
                word = builder.xor(word, builder.lshr(word, whole(shift)))
                word = cut(builder.mul(word, whole(factor))) if factor > 1 else word
            return word

        seeds, steps, channels = (builder.fptosi(value, integer) for value in (seed, step, channel))
        key = scrambled(builder.xor(seeds, scrambled(builder.add(steps, whole(1)))))
        total = whole(0)
        for i in range(2):
            place = builder.add(builder.mul(channels, whole(2)), whole(i))
            word = scrambled(cut(builder.add(key, builder.mul(place, whole(elementary.GOLDEN)))))
            total = builder.add(total, builder.add(builder.and_(word, whole(0xFFFF)), builder.lshr(word, whole(16))))
        deviation = builder.fsub(builder.sitofp(total, self.vector), self.constant(elementary.SUM_MEAN))
        return builder.fmul(deviation, self.constant(1.0 / elementary.SUM_DEVIATION))


@contextmanager
def repeated(builder: Any, n: Any) -> Iterator[Any]:
    """Build a loop whose body runs n times; the context's value is the count from 0 on."""
    with accumulated(builder, n, ()) as (count, *_):
        yield count


@contextmanager
def accumulated(builder: Any, n: Any, first: Sequence[Any]) -> Iterator[tuple[Any, list[Any], list[Any]]]:
    """Build such a loop with numbers that change in it, and are `first` before it.

    The context's values are the count, the numbers, also behind the loop, and a list that takes their next values.
    """
    entry = builder.block
    check, body, done = (builder.append_basic_block(name) for name in ("check", "body", "done"))
    builder.branch(check)
    builder.position_at_end(check)
    values, following = [_WHOLE(0), *first], list[Any]()
    count, *numbers = phis = [builder.phi(value.type) for value in values]
    for phi, value in zip(phis, values, strict=True):
        phi.add_incoming(value, entry)
    builder.cbranch(builder.icmp_signed("<", count, n), body, done)
    builder.position_at_end(body)
    yield count, numbers, following
    for phi, value in zip(phis, (builder.add(count, _WHOLE(1)), *following), strict=True):
        phi.add_incoming(value, builder.block)
    builder.branch(check)
    builder.position_at_end(done)
