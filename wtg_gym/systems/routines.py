"""Machine code that is called at an address: routines, which programs are compiled to, and some functions.

A compiled function finds the address in code that is linked to a plant. So a program is compiled once for each width of
blocks, by whatever functions it is called, and again only if its own equations change. Numba would build a function
into each of its callers, and into each of theirs, and compile it there again.
"""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba import typeof, types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from wtg_gym.systems import compiled
from wtg_gym.systems.programs import Program, Whole
from wtg_gym.systems.systems import SCALARS
from wtg_gym.systems.writers import Writer

#: Lanes of a wide block: two vectors of the widest processors.
WIDE = 16
#: Where machine code is in this process, by the key that it is kept under.
_ADDRESSES: dict[bytes, int] = {}
#: Routines that one program has, at most, and functions that are called at an address.
_VARIANTS, _FUNCTIONS = 4, 4
_DOUBLE, _WHOLE = ir.DoubleType(), ir.IntType(64)
_NUMBERS, _WHOLES = _DOUBLE.as_pointer(), _WHOLE.as_pointer()


class Routine:
    """A compiled program.

    `call` is a function for compiled code, of (arrays, code): the code of a plant; then scalars, () for none, and, with
    a tape, the row where the program's notes begin. Arrays (n_rows, width) are those of the block and of scratch; then
    the tape. For the way back they are cotangents (bars) of block and scratch, the tape, the scratch, and cotangents of
    the code's constants: the bars after the program become those before it, and those of the constants are added to.

    `variant` says which of the program's routines it is, 0 … 3; of two that are the same variant, code has one.
    `known` are values of scalars, compiled in: branches that they exclude are left out.
    """

    def __init__(self, program: Program, writer: type[Writer] = Writer, variant: int = 0, **known: float) -> None:
        if not 0 <= variant < _VARIANTS:
            raise ValueError(f"variant of {program.name} must be 0 … {_VARIANTS - 1}, got {variant}")
        self.program, self.variant, self._writer, self._known = program, variant, writer, known
        self.call = _call(_FUNCTIONS + 2 * (program.number * _VARIANTS + variant), writer.n_arrays)

    def address(self, program: Program, width: int) -> int:
        """Return where the machine code of a program for blocks of a width is in this process.

        Compiles on first use. `program` may be extended by user-defined devices.
        """
        n_arrays, purpose = self._writer.n_arrays, self._writer.purpose
        content = (program.digest(back=n_arrays > 2), purpose, width, sorted(self._known.items()), _writers_hash())
        folder = compiled.cache_folder()
        places = compiled.places_for(folder and folder.parent, _processor())
        keys = [compiled.digest_of(repr((content, processor, compiled.VERSIONS)).encode()) for _, processor in places]
        # Threads may ask at once.
        with global_compiler_lock:
            if keys[0] not in _ADDRESSES:
                names = [f"{program.name.lower()}-{key.hex()[:16]}" for key in keys]
                paths = [
                    base and base / "programs" / f"{name}.o" for (base, _), name in zip(places, names, strict=True)
                ]
                codes = (compiled.kept(path, key) for path, key in zip(paths, keys, strict=True))
                name, code = next((pair for pair in zip(names, codes, strict=True) if pair[1]), (names[0], None))
                if code is None:
                    with compiled.reporting(f"{program.name.lower()} ({purpose})"):
                        code = self._compiled(program, name, width)
                    compiled.keep(paths[0], keys[0], code)
                engine = _engine()
                engine.add_object_file(binding.ObjectFileRef.from_data(code))
                engine.finalize_object()
                _ADDRESSES[keys[0]] = engine.get_function_address(name)
            return _ADDRESSES[keys[0]]

    def _compiled(self, program: Program, name: str, width: int) -> bytes:
        n_arrays = self._writer.n_arrays
        module = ir.Module(name)
        module.triple, module.data_layout = _processor()[0], str(_machine().target_data)
        function = ir.Function(module, _signature(n_arrays), name)
        for argument in function.args[: n_arrays + 2]:
            argument.add_attribute("noalias")
        arrays, rest = function.args[:n_arrays], function.args[n_arrays:]
        scalars = dict(zip(SCALARS, rest[2:], strict=True))
        builder = ir.IRBuilder(function.append_basic_block())
        data = (*arrays[:2], *rest[:2], *arrays[2:])
        self._writer(builder, width, data, scalars, program, self._known).write(program.entries)
        builder.ret_void()
        parsed = binding.parse_assembly(str(module))
        passes = binding.create_pass_builder(_machine(), binding.create_pipeline_tuning_options(_LEVEL))
        passes.getModulePassManager().run(parsed, passes)
        code: bytes = _machine().emit_object(parsed)
        return code


#: How much LLVM optimises. What matters is written as vectors already.
_LEVEL = 1


def _processor() -> compiled.Processor:
    """Return triple, name and features of this processor, as numba knows them."""
    processor: compiled.Processor = cpu_target.target_context.codegen().magic_tuple()
    return processor


@functools.cache
def _machine() -> Any:
    triple, cpu, features = _processor()
    target = binding.Target.from_triple(triple)
    return target.create_target_machine(cpu=cpu, features=features, opt=_LEVEL, codemodel="jitdefault", jit=True)


@functools.cache
def _engine() -> Any:
    """Return what owns the machine code of this process."""
    return binding.create_mcjit_compiler(binding.parse_assembly(""), _machine())


@functools.cache
def _writers_hash() -> bytes:
    return compiled.digest_of(*(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py"))))


def _signature(n_arrays: int) -> Any:
    return ir.FunctionType(ir.VoidType(), [*[_NUMBERS] * n_arrays, _WHOLES, _NUMBERS, *[_DOUBLE] * len(SCALARS)])


def _call(place: int, n_arrays: int) -> Callable[..., None]:
    """Return a function for compiled code that calls what linked code has at a place."""

    @intrinsic
    def call(typing_context: Any, arrays: Any, linked: Any, scalars: Any = (), at: Any = 0) -> Any:
        if len(arrays) != n_arrays or any(array.layout != "C" for array in arrays):
            raise TypeError(f"a routine takes {n_arrays} arrays in C order, got {arrays}")
        # Numba gives a default as a value, and other arguments as types.
        scalars = types.Tuple(()) if scalars == () else scalars
        if len(scalars) not in (0, len(SCALARS)) or (n_arrays > 2 and at == 0):
            raise TypeError(f"a routine takes {len(SCALARS)} scalars or (), and, with a tape, the row of its notes")

        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            def data_of(types_: Any, values: Any) -> list[Any]:
                makers = (context.make_array(type_) for type_ in types_)
                return [make(context, builder, builder.extract_value(values, i)).data for i, make in enumerate(makers)]

            of_arrays, of_linked, numbers, first_note = arguments
            first = context.make_array(arrays[0])(context, builder, builder.extract_value(of_arrays, 0))
            width = builder.extract_value(first.shape, 1)
            wide = builder.zext(builder.icmp_signed(">", width, _WHOLE(1)), _WHOLE)
            data, (rows, constants, addresses) = data_of(arrays, of_arrays), data_of(linked, of_linked)
            if n_arrays > 2:
                data[2] = builder.gep(data[2], [builder.mul(first_note, width)])
            address = builder.load(builder.gep(addresses, [builder.add(_WHOLE(place), wide)]))
            function = builder.inttoptr(address, _signature(n_arrays).as_pointer())
            values = [builder.extract_value(numbers, i) for i in range(len(scalars))]
            builder.call(function, [*data, rows, constants, *(values or [_DOUBLE(0.0)] * len(SCALARS))])
            return context.get_dummy_value()

        return types.void(arrays, linked, scalars, types.int64), code

    routine: Callable[..., None] = call
    return routine


class Function:
    """A compiled function that others call at an address, at a place of its own among all such functions.

    `call` is a function for compiled code, of (code, arguments), which are a tuple. The type of its result, where it
    is not given, is found by compiling it, wherever it might be called.
    """

    def __init__(self, function: Any, place: int, result: Any = None) -> None:
        if not 0 <= place < _FUNCTIONS:
            raise ValueError(f"place of {function.__name__} must be 0 … {_FUNCTIONS - 1}, got {place}")
        self.function, self.place = function, place

        @intrinsic
        def call(typing_context: Any, linked: Any, arguments: Any) -> Any:
            argument_types = tuple(types.unliteral(type_) for type_ in arguments)
            returned = result or self._compiled(argument_types).signature.return_type

            def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
                addresses = context.make_array(linked[2])(context, builder, builder.extract_value(values[0], 2)).data
                address = builder.load(builder.gep(addresses, [_WHOLE(place)]))
                type_ = context.call_conv.get_function_type(returned, argument_types)
                called = builder.inttoptr(address, type_.as_pointer())
                converted = [
                    context.cast(builder, builder.extract_value(values[1], i), arguments[i], type_)
                    for i, type_ in enumerate(argument_types)
                ]
                return context.call_conv.call_function(builder, called, returned, argument_types, converted)[1]

            return returned(linked, arguments), code

        self.call: Callable[..., Any] = call

    def _compiled(self, arguments: tuple[Any, ...]) -> Any:
        self.function.compile(arguments)
        return self.function.overloads[arguments]

    def address(self, *arguments: Any) -> int:
        """Return where the machine code for arguments like these is in this process."""
        overload = self._compiled(tuple(map(typeof, arguments)))
        address: int = overload.library.get_pointer_to_function(overload.fndesc.llvm_func_name)
        return address


def addresses_of(
    programs: Sequence[Program], routines: Mapping[int, Iterable[Routine]], functions: Mapping[Function, Any]
) -> Whole:
    """Return addresses in this process, as :class:`~wtg_gym.systems.programs.Code` has them.

    The programs are linked together. Routines that will be called are given by the width of the blocks, functions with
    arguments like those that they will be given.
    """
    addresses = np.zeros(_FUNCTIONS + 2 * _VARIANTS * len(programs), dtype=np.int64)
    for function, arguments in functions.items():
        addresses[function.place] = function.address(*arguments)
    of_programs = addresses[_FUNCTIONS:].reshape(len(programs), _VARIANTS, 2)
    for width, of_width in routines.items():
        for routine in of_width:
            number = routine.program.number
            of_programs[number, routine.variant, int(width > 1)] = routine.address(programs[number], width)
    return addresses
