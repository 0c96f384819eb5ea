"""Counts the arithmetic of a control interval: the kernels run as plain Python on numbers that count.

Needs NUMBA_DISABLE_JIT=1, so that the functions are those of the source; :func:`count_operations` counts in a process
of its own.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from wtg_gym.physics.elementary import fma


@dataclass
class Counts:
    """Operations as the source writes them; a compiler may leave out some of them.

    Adds include subtractions; comparisons include minimum, maximum and the choice between two values. Signs, rounding
    to whole numbers and arithmetic that does not depend on the lane (indices, the step's times) are not counted. A
    fused multiply-add counts as a multiply and an add.
    """

    adds: int = 0
    multiplies: int = 0
    divisions: int = 0
    roots: int = 0
    powers: int = 0
    comparisons: int = 0
    loads: int = 0
    stores: int = 0

    @property
    def flops(self) -> int:
        """Floating-point operations: adds, multiplies, divisions, roots and powers; comparisons stay out."""
        return self.adds + self.multiplies + self.divisions + self.roots + self.powers

    @property
    def bytes(self) -> int:
        """Bytes read from and written to the lanes' rows."""
        return 8 * (self.loads + self.stores)


#: The present counts.
_counts = Counts()


class Counted:
    """A floating-point number whose arithmetic is counted."""

    # Numbers of numpy leave mixed arithmetic to this class.
    __array_ufunc__ = None
    __slots__ = ("_loaded", "_value")

    def __init__(self, value: float, *, loaded: bool = False) -> None:
        self._value, self._loaded = float(value), loaded

    @property
    def value(self) -> float:
        """The number; the first look at one from the rows counts as a load."""
        _counts.loads += self._loaded
        self._loaded = False
        return self._value

    def __float__(self) -> float:
        return self.value

    def __int__(self) -> int:
        return int(self.value)

    def __round__(self) -> int:
        return round(self.value)

    def __floor__(self) -> Counted:
        return Counted(math.floor(self.value))

    def __ceil__(self) -> Counted:
        return Counted(math.ceil(self.value))

    def __neg__(self) -> Counted:
        return Counted(-self.value)

    def __abs__(self) -> Counted:
        return Counted(abs(self.value))

    def __pow__(self, exponent: int) -> Counted:
        _counts.multiplies += exponent - 1
        return Counted(self.value**exponent)

    def __rpow__(self, base: float) -> Counted:
        _counts.powers += 1
        return Counted(base**self.value)


def _add_operator(name: str, kind: str) -> None:
    """Give :class:`Counted` an operator, and its reflection, that count as `kind`."""
    operate = getattr(float, f"__{name}__")

    def forward(self: Counted, other: Any) -> Any:
        setattr(_counts, kind, getattr(_counts, kind) + 1)
        result = operate(self.value, float(other))
        return result if isinstance(result, bool) else Counted(result)

    setattr(Counted, f"__{name}__", forward)
    if kind != "comparisons":
        setattr(Counted, f"__r{name}__", lambda self, other: forward(Counted(other), self))


for _name, _kind in (("add", "adds"), ("sub", "adds"), ("mul", "multiplies"), ("truediv", "divisions")):
    _add_operator(_name, _kind)
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    _add_operator(_name, "comparisons")


def counted(values: Any) -> Any:
    """Return an array, a number or a named tuple with its floating-point numbers counted; anything else as it is."""
    if isinstance(values, (float, np.floating)):
        return Counted(float(values))
    if isinstance(values, tuple) and hasattr(values, "_make"):
        return values._make(counted(value) for value in values)
    if not isinstance(values, np.ndarray) or values.dtype != np.float64:
        return values
    array = np.empty(values.shape, dtype=object)
    for index, value in np.ndenumerate(values):
        array[index] = Counted(value)
    return array


class Rows:
    """The rows of one lane, which count their loads and stores."""

    def __init__(self, values: np.ndarray) -> None:
        self._values = values.copy()
        self.shape = values.shape

    def __getitem__(self, index: int) -> Counted:
        # A record is loaded whole, and a compiler leaves out what is not used.
        return Counted(self._values[index], loaded=True)

    def __setitem__(self, index: int, value: Any) -> None:
        _counts.stores += 1
        self._values[index] = float(value)


def count(work: Callable[[], Any]) -> Counts:
    """Return the counts of one call of a function."""
    global _counts
    before, _counts = _counts, Counts()
    try:
        work()
        return _counts
    finally:
        _counts = before


def _sqrt(value: Any) -> Counted:
    _counts.roots += 1
    return Counted(math.sqrt(value))


def _fused(a: Any, b: Any, c: Any) -> Any:
    if not any(isinstance(value, Counted) for value in (a, b, c)):
        return fma(a, b, c)
    _counts.multiplies += 1
    _counts.adds += 1
    return Counted(fma(float(a), float(b), float(c)))


def _zeros(*arguments: Any, **more: Any) -> Any:
    return counted(np.zeros(*arguments, **more))


def instrument() -> None:
    """Let the modules of the kernels count roots, scratch arrays and conversions, which are no operators."""
    replaced = {
        "math": SimpleNamespace(**{**vars(math), "sqrt": _sqrt}),
        "np": SimpleNamespace(**{**vars(np), "zeros": _zeros, "empty": _zeros}),
        "fma": _fused,
    }
    for name, module in list(sys.modules.items()):
        if name.startswith(("wtg_gym.physics.", "wtg_gym.envs.")):
            for own in replaced.keys() & vars(module).keys():
                setattr(module, own, replaced[own])
    # It would turn a counted number into a plain one.
    vars(sys.modules["wtg_gym.envs.task"])["float"] = lambda value: value


def _count_here() -> dict[str, Counts]:
    """Count the default plant's right-hand side, control interval and environment step, of one lane."""
    from wtg_gym.envs.lanes import TaskLanes
    from wtg_gym.envs.settings import EnvSettings
    from wtg_gym.envs.task import step_blocks
    from wtg_gym.physics.dynamics import derivatives
    from wtg_gym.physics.integration import advance_interval
    from wtg_gym.physics.scenario import Scenario

    lanes = TaskLanes(EnvSettings(version="v0", duration_s=2.0))
    scenario = Scenario(name="calm", wind_speed=np.full((lanes.n_wtg, 1), 10.0), duration_s=2.0)
    lanes.start([0], [scenario])
    simulator = lanes.simulator
    instrument()
    plant, data, task = simulator.plant, counted(simulator.data), lanes.task
    actions, noise_y = counted(np.full((1, lanes.n_action), 0.1)), counted(np.zeros(1))

    def rows() -> Any:
        return Rows(simulator.blocks[0])

    def step() -> None:
        step_blocks([rows()], 0, 1, plant, data, task, actions, lanes.outputs, simulator.lanes)  # type: ignore[arg-type]

    return {
        "right-hand side": count(lambda: derivatives(rows(), plant.constants[0], 0.5, simulator.lanes)),
        "control interval": count(lambda: advance_interval(rows(), 0, plant, data, noise_y, simulator.lanes)),
        "environment step": count(step),
    }


def print_counts() -> None:
    """Count in this process, and print the counts as JSON."""
    print(json.dumps({name: dataclasses.asdict(counts) for name, counts in _count_here().items()}))


def count_operations() -> dict[str, Counts]:
    """Return the counts of the right-hand side, a control interval and an environment step, of one lane.

    Raises:
        RuntimeError: the process that counts has failed; the message is its last line.
    """
    done = subprocess.run(
        [sys.executable, "-c", f"from {__name__} import print_counts; print_counts()"],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"counting failed: {done.stderr.strip().splitlines()[-1]}")
    return {name: Counts(**values) for name, values in json.loads(done.stdout).items()}
