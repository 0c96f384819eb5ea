"""The equations of the models and of the task: free of branches, the same in every back end, and easy to extend."""

from __future__ import annotations

import importlib
import types
import typing
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

MODULES = {
    "wtg_gym.physics": (
        "elementary",
        "aerodynamics",
        "exciter",
        "governor",
        "machine",
        "pitch",
        "converter",
        "extended_converter",
        "rotor_table",
        "wind_turbine",
    ),
    "wtg_gym.envs": ("cost", "observation"),
}
#: They look for an equilibrium, once per run: with loops and branches.
SEARCHES = {"exciter_start", "machine_start", "turbine_equilibrium", "_pitch_that_captures", "_over_ratios"}
LANES = 7


def is_compiled(value: Any) -> bool:
    return hasattr(value, "py_func")


def equations() -> dict[str, Any]:
    """Every compiled function of the modules that hold equations."""
    found = {}
    for package, names in MODULES.items():
        for name in names:
            module = importlib.import_module(f"{package}.{name}")
            found |= {
                key: value
                for key, value in vars(module).items()
                if is_compiled(value) and value.py_func.__module__ == module.__name__ and key not in SEARCHES
            }
    # Generated from records, and part of the equations that use them.
    generated = ("load_", "store_", "read_", "bounded_")
    return {name: function for name, function in found.items() if not name.startswith(generated)}


EQUATIONS = equations()
NUMPY = {
    "min": np.minimum,
    "max": np.maximum,
    "select": np.where,
    "fma": lambda a, b, c: a * b + c,
    "math": types.SimpleNamespace(sqrt=np.sqrt, floor=np.floor),
}


def over_arrays(function: Any) -> Any:
    """The same source over arrays: an `if` on a state raises, as in any tool that traces a function."""
    source = function.py_func if is_compiled(function) else function
    used = {key: source.__globals__[key] for key in source.__code__.co_names if key in source.__globals__}
    names = {key: over_arrays(value) if is_compiled(value) else value for key, value in used.items()}
    return types.FunctionType(source.__code__, {**names, **NUMPY})


def draw(kind: Any, rng: np.random.Generator, shape: tuple[int, ...]) -> Any:
    """Numbers for an argument of an annotated type: those of records positive and small."""
    if hasattr(kind, "_fields"):
        return kind(*(draw(k, rng, shape) for k in typing.get_type_hints(kind).values()))
    if kind == npt.NDArray[np.float64]:
        return rng.uniform(0.1, 1.5, (3, 4, 16))  # cells of a table
    if kind is bool:
        return bool(rng.integers(2))
    if kind is int:
        return int(rng.integers(1, 9))
    return rng.uniform(0.1, 1.5, shape)


def lane(value: Any, x: int) -> Any:
    if hasattr(value, "_fields"):
        return type(value)(*(lane(v, x) for v in value))
    return float(value[x]) if isinstance(value, np.ndarray) and value.ndim == 1 else value


def numbers(result: Any) -> list[Any]:
    if isinstance(result, tuple):
        return [number for part in result for number in numbers(part)]
    return [result]


@pytest.mark.parametrize("name", sorted(EQUATIONS))
def test_an_equation_can_be_traced_and_gives_the_compiled_numbers(name: str) -> None:
    function = EQUATIONS[name]
    kinds = typing.get_type_hints(function.py_func)
    kinds.pop("return", None)
    rng = np.random.default_rng(0)
    # Constants are the same for all lanes, and so are flags and counts.
    arguments = [draw(kind, rng, (LANES,)) for kind in kinds.values()]
    traced = numbers(over_arrays(function)(*arguments))
    for x in range(LANES):
        compiled = numbers(function(*(lane(argument, x) for argument in arguments)))
        seen = [float(value[x]) if np.ndim(value) else float(value) for value in traced]
        assert seen == pytest.approx([float(value) for value in compiled], rel=1e-10, abs=1e-10)
