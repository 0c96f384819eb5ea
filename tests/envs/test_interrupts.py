"""Changes that signals may not cut in two: an interrupted call has changed every environment or none."""

import contextlib
import copy
import itertools
import multiprocessing
import os
import signal
import threading
import time

import numpy as np
import pytest

from tests.envs.rollouts import bits, started
from tests.interruption import interrupt_before
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.physics.simulator import BlockThreads
from wtg_gym.sb3 import make_sb3_vec_env
from wtg_gym.signals import HeldSignals, undivided

#: Environments that are worth a thread.
N = 64
#: Episodes of ten steps, so that many steps start some.
SHORT = {"version": "v0", "duration_s": 1.0}


def batch(n_threads: int, **arguments) -> GFMWTGVectorEnv:
    env = started(GFMWTGVectorEnv(N * n_threads, n_threads=n_threads, **SHORT, **arguments), seed=0)
    for k in range(4):
        reset_some(env, k)
        step(env, k)
    return env


def monitored(n_threads: int, **more):
    num_envs = N * n_threads if n_threads > 1 else 3
    return started(make_sb3_vec_env(num_envs, seed=0, n_threads=n_threads, **more, **SHORT))


def agents(_: int):
    module = pytest.importorskip("wtg_gym.pettingzoo")
    return started(module.parallel_env(strategy="mppt", on_failure="trip", **SHORT), seed=0)


def step(env, k: int):
    return env.step(np.random.default_rng(k).uniform(-1.0, 1.0, (env.num_envs, 4)).astype(np.float32))


def step_or_reset(env, k: int):
    if hasattr(env, "agents"):
        return env.step({agent: np.full(2, 0.1 * k % 1.0) for agent in env.agents}) if env.agents else env.reset()
    return env.reset() if np.any(env.batch.ended()) else env.step(np.full(4, 0.1 * k % 1.0))


def reset_some(env: GFMWTGVectorEnv, k: int):
    return env.reset(options={"reset_mask": np.random.default_rng(k).random(env.num_envs) < 0.1})


def state(env):
    """Return everything of an environment that a call may change, in a form that compares to the bit."""
    names, native = ("agents", "reset_infos", "episode_returns", "episode_lengths"), env
    for name in ("venv", "vector_env", "env", "single_env"):
        native = vars(native).get(name, native)
    return bits([*native.snapshot().batch[1:], *(getattr(env, name, None) for name in names)])


CASES = {
    "next step": (batch, step),
    "same step": (lambda n: batch(n, autoreset_mode="SameStep"), step),
    "step limit": (lambda n: batch(n, max_episode_steps=2), step),
    "reset": (batch, lambda env, k: env.reset(seed=k if k % 2 else None)),
    "reset of some": (batch, reset_some),
    "Stable-Baselines3": (monitored, step),
    "score": (lambda _: monitored(1, reward="score"), step),
    "single": (lambda _: started(GFMWTGEnv(**SHORT), seed=0), step_or_reset),
    "rendering": (lambda _: started(GFMWTGEnv(render_mode="rgb_array", **SHORT), seed=0), step_or_reset),
    "PettingZoo": (agents, step_or_reset),
}
THREADED = ("next step", "same step", "step limit", "Stable-Baselines3")


@pytest.mark.parametrize(("name", "n_threads"), [(n, 1) for n in CASES] + [(n, k) for n in THREADED for k in (2, 4)])
def test_interrupted_call_is_complete_or_has_not_begun(name, n_threads, monkeypatch):
    # The monitor reports how long an episode took.
    monkeypatch.setattr(time, "time", lambda: 0.0)
    make, call = CASES[name]
    env, rng, n_interrupts, k = make(n_threads), np.random.default_rng(0), 0, 0
    twin = copy.deepcopy(env)
    while n_interrupts < 5:
        k, before = k + 1, state(twin)
        with interrupt_before(0) as instructions:
            expected = call(twin, k)
        try:
            with interrupt_before(int(rng.integers(1, instructions[0], endpoint=True))):
                result = call(env, k)
        except KeyboardInterrupt:
            n_interrupts += 1
            if state(env) == state(twin):
                continue
            assert state(env) == before
            result = call(env, k)
        assert bits(result) == bits(expected)


def staggered(n_threads: int, num_envs: int, version: str = "v0") -> GFMWTGVectorEnv:
    """A batch of which one environment waits for its reset and the others run."""
    settings = {"version": version, "n_threads": n_threads, "duration_s": 3.0, "control_dt": 0.1}
    env = started(GFMWTGVectorEnv(num_envs, **settings), seed=0)
    actions = np.zeros(env.action_space.shape, dtype=np.float32)
    for _ in range(10):
        env.step(actions)
    env.reset(options={"reset_mask": np.arange(num_envs) > 0})
    for _ in range(20):
        env.step(actions)
    return env


def played(n_threads: int, num_envs: int, version: str) -> list[list[np.ndarray]]:
    """What 45 steps of a batch return, with resets between them."""
    env = staggered(n_threads, num_envs, version)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (45, *env.action_space.shape)).astype(np.float32)
    result = [[np.copy(values) for values in env.step(own)[:4]] for own in actions]
    env.close()
    return result


@pytest.mark.parametrize(("n_threads", "version"), [(9, "v0"), (3, "v1")])
def test_resets_while_other_threads_step_change_no_bit(n_threads, version):
    one, many = (bits(played(n, N * n_threads, version)) for n in (1, n_threads))
    assert one == many


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_steps_a_batch_that_has_stepped_on_threads():
    env = staggered(2, 2 * N)
    process = multiprocessing.get_context("fork").Process(target=step, args=(env, 0))
    process.start()
    process.join(60.0)
    assert process.exitcode == 0
    env.close()


def test_a_second_thread_gets_an_error_and_the_first_one_its_numbers(monkeypatch):
    env, alone = (started(GFMWTGVectorEnv(64, n_threads=1, version="v0"), seed=0) for _ in range(2))
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    snapshot = env.snapshot()
    inside, leave = threading.Event(), threading.Event()
    step = env.batch.step

    def slow(*arguments):
        inside.set()
        assert leave.wait(60.0)
        return step(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(env.batch, "step", slow)
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
        assert bits(env.step(action)[:4]) == bits(alone.step(action)[:4])


#: Signals of every system with handlers of the test's own, and one that is left alone.
FIRST, SECOND, IGNORED = signal.SIGINT, signal.SIGTERM, signal.SIGABRT


class FirstError(Exception):
    """What the handler of the first signal raises."""


@pytest.fixture
def handled():
    """Signals handled so far, in their order; the handler of the first one raises a FirstError."""
    numbers: list[int] = []

    def handler(number: int, _: object) -> None:
        numbers.append(number)
        if number == FIRST:
            raise FirstError

    before = {number: signal.signal(number, handler) for number in (FIRST, SECOND)}
    before[IGNORED] = signal.signal(IGNORED, signal.SIG_IGN)
    handlers = [signal.getsignal(number) for number in before]
    yield numbers
    assert [signal.getsignal(number) for number in before] == handlers, "the handlers are put back"
    for number, earlier in before.items():
        signal.signal(number, earlier)


def test_each_handler_runs_once_after_the_outermost_block_and_none_is_lost_where_another_raises(handled):
    complete = False
    with pytest.raises(FirstError), HeldSignals():
        with HeldSignals():
            for number in (FIRST, SECOND, FIRST):
                signal.raise_signal(number)
        assert handled == [] and signal.getsignal(IGNORED) == signal.SIG_IGN
        complete = True
    assert complete and sorted(handled) == sorted([FIRST, SECOND])
    with pytest.raises(FirstError):
        signal.raise_signal(FIRST)


def test_a_signal_before_any_instruction_is_handled_once_and_leaves_every_handler_in_its_place(handled):
    handlers = [signal.getsignal(number) for number in (FIRST, SECOND)]
    entered = undivided(lambda: signal.raise_signal(SECOND))
    for instruction in itertools.count(1):
        handled.clear()
        with contextlib.suppress(FirstError), interrupt_before(instruction) as instructions:
            entered()
        if instructions[0] < instruction:
            break
        assert handled.count(FIRST) == 1 and handled.count(SECOND) <= 1
        assert [signal.getsignal(number) for number in (FIRST, SECOND)] == handlers and not HeldSignals._holds
    assert instruction > 50


def test_what_a_handler_raises_replaces_the_error_of_the_block(handled):
    with pytest.raises(FirstError) as raised, HeldSignals():
        signal.raise_signal(FIRST)
        raise ValueError("of the block")
    assert isinstance(raised.value.__context__, ValueError)


def test_another_thread_neither_holds_nor_releases_signals(handled):
    results = []
    with pytest.raises(FirstError), HeldSignals():
        thread = threading.Thread(target=lambda: results.append(undivided(signal.getsignal)(FIRST)))
        thread.start()
        thread.join()
        signal.raise_signal(FIRST)
        assert results == [signal.getsignal(FIRST)] and not handled


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs signals to a thread")
def test_threads_have_ended_before_what_a_handler_raises_arrives(handled):
    main, ended = threading.get_ident(), []

    def work(first: int, last: int, worker: int) -> None:
        if worker > 0:
            # The main thread has nothing left to do but wait.
            time.sleep(0.05)
            signal.pthread_kill(main, FIRST)
            time.sleep(0.05)
        ended.append(worker)

    threads = BlockThreads(16, 4)
    with pytest.raises(FirstError):
        threads.run(work)
    assert sorted(ended) == [0, 1, 2, 3]
    threads.close()


def test_closing_ends_every_thread_those_of_the_reference_at_100_too():
    before = set(threading.enumerate())
    envs = started(GFMWTGVectorEnv(64, version="v1", n_threads=2, duration_s=30.0), seed=0)
    envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
    assert len(set(threading.enumerate()) - before) == 2
    envs.close()
    assert set(threading.enumerate()) <= before


def test_a_block_may_be_entered_again_within_itself_and_keeps_handlers_that_it_sets(handled):
    held = HeldSignals()
    before = signal.getsignal(SECOND)
    for _ in range(2):
        with held:
            with held:
                signal.raise_signal(SECOND)
            assert handled == []
        assert handled.pop() == SECOND and signal.getsignal(SECOND) == before
    with held:
        signal.signal(SECOND, signal.SIG_IGN)
    assert signal.getsignal(SECOND) == signal.SIG_IGN
    signal.signal(SECOND, before)
