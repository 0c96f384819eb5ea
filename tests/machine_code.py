"""Programs run from Python, as compiled functions run them."""

import ctypes
from collections.abc import Sequence

import numpy as np

from wtg_gym.systems.programs import Code
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.systems import SCALARS


def run_routine(routine: Routine, arrays: Sequence[np.ndarray], code: Code) -> None:
    """Run a routine of its own program on arrays (n_rows, width) in C order, with scalars of zero."""
    address = routine.address(routine.program, arrays[0].shape[1])
    types = [ctypes.c_void_p] * (len(arrays) + 2) + [ctypes.c_double] * len(SCALARS)
    data = [array.ctypes.data for array in (*arrays, code.rows, code.constants)]
    ctypes.CFUNCTYPE(None, *types)(address)(*data, *[0.0] * len(SCALARS))
