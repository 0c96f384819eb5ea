"""Facts about changes that signals may not cut in two."""

import contextlib
import itertools
import signal
import threading
import time

import pytest

from tests.interruption import interrupt_before
from wtg_gym.physics.simulator import BlockThreads
from wtg_gym.signals import HeldSignals, undivided

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
