"""Compile for a batch on two processors: the step in a second process, while this one compiles the start of a run."""

from __future__ import annotations

import multiprocessing
import signal
from typing import Any

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task import build_task, new_outputs, start_tasks, step_blocks
from wtg_gym.systems.compiled import cache_folder, is_compiled
from wtg_gym.physics.kernel_data import EVENT_DTYPE, LaneData
from wtg_gym.physics.plant import build_plant
from wtg_gym.physics.simulator import BLOCK_WIDTH, Simulator


def compile_ahead(settings: EnvSettings) -> None:
    """Compile the batched step and the start of a run side by side, if that step is not in the cache of machine code.

    Args:
        settings: of the environment; the numbers of its groups and machines decide what is compiled.
    """
    if cache_folder() is None or is_compiled(step_blocks, *_step_of_nobody(settings)):
        return
    child = multiprocessing.get_context("spawn").Process(target=_compile_step, args=(settings,), daemon=True)
    child.start()
    Simulator(settings.plant()).close()
    child.join()


def _compile_step(settings: EnvSettings) -> None:
    """Compile the step of a batch by a call for no block; only the types of the arrays matter."""
    # An interrupt ends the first process, and this one with it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    arguments = _step_of_nobody(settings)
    blocks, _, _, plant, _, task, _, outputs, lanes = arguments
    start_tasks(blocks, np.zeros(0, dtype=np.int64), plant, task, np.zeros(0), np.zeros((0, 1)), outputs, lanes)
    step_blocks(*arguments)


def _step_of_nobody(settings: EnvSettings) -> tuple[Any, ...]:
    """Return arguments of :func:`step_blocks` for no block, of a batch's types."""
    plant, task, lanes = build_plant(settings.plant()), build_task(settings), (0,) * BLOCK_WIDTH
    series = np.zeros((1, 1, 1)), np.zeros((1, 1)), np.zeros(1, dtype=np.int64)
    data = LaneData(*series, np.zeros((1, 1), dtype=np.complex128), np.zeros((1, 1), dtype=EVENT_DTYPE))
    return np.zeros((1, 1)), 0, 0, plant, data, task, np.zeros((1, 1)), new_outputs(1, 1), lanes
