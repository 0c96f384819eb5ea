"""Resets while other threads step: parity, and what a failed preparation leaves."""

from __future__ import annotations

import copy
import functools
import multiprocessing
import os
import pickle

import numpy as np
import numpy.typing as npt
import pytest

from wtg_gym.envs import GFMWTGVectorEnv

N = 1024


def staggered(n_threads: int, version: str = "v0") -> GFMWTGVectorEnv:
    """A batch of 64 blocks of which one lane waits for its reset and the others run."""
    env = GFMWTGVectorEnv(N, version=version, n_threads=n_threads, duration_s=3.0)
    env.reset(seed=0)
    actions = np.zeros(env.action_space.shape, dtype=np.float32)
    for _ in range(10):
        env.step(actions)
    env.reset(options={"reset_mask": np.arange(N) > 0})
    for _ in range(20):
        env.step(actions)
    return env


def played(n_threads: int, version: str) -> list[list[npt.NDArray[np.generic]]]:
    """What 45 steps of a batch return, with resets between them."""
    env = staggered(n_threads, version)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (45, *env.action_space.shape)).astype(np.float32)
    found = [[np.copy(values) for values in env.step(own)[:4]] for own in actions]
    env.close()
    return found


on_one_thread = functools.cache(functools.partial(played, 1))


@pytest.mark.parametrize(("n_threads", "version"), [(2, "v0"), (3, "v0"), (4, "v0"), (9, "v0"), (3, "v1")])
def test_resets_while_other_threads_step_change_no_bit(n_threads: int, version: str) -> None:
    for one, many in zip(on_one_thread(version), played(n_threads, version), strict=True):
        for a, b in zip(one, many, strict=True):
            assert (a == b).all()


def test_a_preparation_that_fails_leaves_no_lane_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    env = staggered(2)
    simulator, actions = env.lanes.simulator, np.zeros((N, 4), dtype=np.float32)
    # No episode is ready: the next step draws one for the waiting lane.
    env._next._ready.clear()
    before = simulator.lane_values("step")

    def refuse(scenarios: object) -> None:
        raise ValueError("scenario 'x' cannot start")

    with monkeypatch.context() as patch:
        patch.setattr(env.lanes, "prepare", refuse)
        with pytest.raises(ValueError, match="cannot start"):
            env.step(actions)
    assert (simulator.lane_values("step")[1:] == before[1:] + simulator.plant.n_substeps).all()
    # The lane that could not start has moved on to the scenario after it.
    env.step(actions)
    assert simulator.lane_values("step")[0] == 0.0
    env.close()


def test_blocks_begin_at_a_cache_line_in_copies_too() -> None:
    env = GFMWTGVectorEnv(33, version="v0")
    for each in (env, copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert each.lanes.simulator.blocks.ctypes.data % 64 == 0


def _step_after_fork(env: GFMWTGVectorEnv) -> None:
    env.step(np.zeros((N, 4), dtype=np.float32))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_steps_a_batch_that_has_stepped_on_threads() -> None:
    env = staggered(2)
    process = multiprocessing.get_context("fork").Process(target=_step_after_fork, args=(env,))
    process.start()
    process.join(60.0)
    assert process.exitcode == 0
    env.close()
