"""Threads: resets while others step change no bit, and two threads in one environment are told apart."""

import functools
import multiprocessing
import os
import threading

import numpy as np
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


def played(n_threads: int, version: str) -> list[list[np.ndarray]]:
    """What 45 steps of a batch return, with resets between them."""
    env = staggered(n_threads, version)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (45, *env.action_space.shape)).astype(np.float32)
    found = [[np.copy(values) for values in env.step(own)[:4]] for own in actions]
    env.close()
    return found


on_one_thread = functools.cache(functools.partial(played, 1))


@pytest.mark.parametrize(("n_threads", "version"), [(9, "v0"), (3, "v1")])
def test_resets_while_other_threads_step_change_no_bit(n_threads, version):
    for one, many in zip(on_one_thread(version), played(n_threads, version), strict=True):
        for a, b in zip(one, many, strict=True):
            assert (a == b).all()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_steps_a_batch_that_has_stepped_on_threads():
    env = staggered(2)
    process = multiprocessing.get_context("fork").Process(target=env.step, args=(np.zeros((N, 4), dtype=np.float32),))
    process.start()
    process.join(60.0)
    assert process.exitcode == 0
    env.close()


def test_a_second_thread_gets_an_error_and_the_first_one_its_numbers(monkeypatch):
    env, alone = (GFMWTGVectorEnv(64, n_threads=1, version="v0") for _ in range(2))
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    for each in (env, alone):
        each.reset(seed=0)
    snapshot = env.snapshot()
    inside, leave = threading.Event(), threading.Event()
    step = env.lanes.step

    def slow(*arguments):
        inside.set()
        assert leave.wait(60.0)
        return step(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(env.lanes, "step", slow)
        thread = threading.Thread(target=env.step, args=(action,))
        thread.start()
        assert inside.wait(60.0)
        for call in (lambda: env.step(action), lambda: env.reset(seed=1), env.snapshot, lambda: env.restore(snapshot)):
            with pytest.raises(RuntimeError, match=r"was called while another thread uses the same environment"):
                call()
        leave.set()
        thread.join()
    alone.step(action)
    for _ in range(20):
        for own, expected in zip(env.step(action)[:4], alone.step(action)[:4], strict=True):
            assert np.array_equal(own, expected)
