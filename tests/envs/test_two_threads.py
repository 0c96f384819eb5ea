"""Two threads in one environment are told apart: an error, and no wrong number."""

from __future__ import annotations

import copy
import pickle
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv

MAKE: dict[str, Callable[[], Any]] = {
    "single": GFMWTGEnv,
    "vector": lambda: GFMWTGVectorEnv(64, n_threads=1, version="v0"),
}


def entered(env: Any, monkeypatch: pytest.MonkeyPatch) -> tuple[threading.Thread, threading.Event]:
    """A thread that is within a step of the environment until the event is set."""
    inside, leave = threading.Event(), threading.Event()
    step = env.lanes.step

    def slow(*arguments: Any) -> Any:
        inside.set()
        assert leave.wait(60.0)
        return step(*arguments)

    monkeypatch.setattr(env.lanes, "step", slow)
    thread = threading.Thread(target=env.step, args=(np.zeros(env.action_space.shape, dtype=np.float32),))
    thread.start()
    assert inside.wait(60.0)
    return thread, leave


@pytest.mark.parametrize("kind", MAKE)
def test_a_second_thread_gets_an_error_and_the_first_one_its_numbers(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    env, alone = MAKE[kind](), MAKE[kind]()
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    for each in (env, alone):
        each.reset(seed=0)
    snapshot = env.snapshot()
    with monkeypatch.context() as patch:
        thread, leave = entered(env, patch)
        for call in (lambda: env.step(action), lambda: env.reset(seed=1), env.snapshot, lambda: env.restore(snapshot)):
            with pytest.raises(RuntimeError, match=r"was called while another thread uses the same environment"):
                call()
        leave.set()
        thread.join()
    alone.step(action)
    # The first thread's step counted, the refused calls did not; afterwards the environment is free.
    for _ in range(20):
        for own, expected in zip(env.step(action)[:4], alone.step(action)[:4], strict=True):
            assert np.array_equal(own, expected)


@pytest.mark.parametrize("kind", MAKE)
def test_threads_that_step_at_once_lose_no_step(kind: str) -> None:
    env = MAKE[kind]()
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    done, refused = [0, 0], [0, 0]

    def work(index: int) -> None:
        for _ in range(200):
            try:
                env.step(action)
                done[index] += 1
            except RuntimeError:
                refused[index] += 1

    threads = [threading.Thread(target=work, args=(index,)) for index in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(done) + sum(refused) == 400
    assert env.lanes.info_arrays()["time_s"][0] == pytest.approx(0.1 * sum(done))


@pytest.mark.parametrize("kind", MAKE)
def test_an_error_leaves_the_environment_free(kind: str) -> None:
    env = MAKE[kind]()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros((1, 2, 3)))
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))


@pytest.mark.parametrize("kind", MAKE)
def test_copies_are_used_apart_from_the_original(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env = MAKE[kind]()
    env.reset(seed=0)
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    with monkeypatch.context() as patch:
        thread, leave = entered(env, patch)
        for each in copies:
            each.step(np.zeros(env.action_space.shape, dtype=np.float32))
        leave.set()
        thread.join()
