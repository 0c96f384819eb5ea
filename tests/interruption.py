"""Commands and functions that are interrupted in their middle, for the tests of what they leave and how they go on."""

import contextlib
import signal
import sys
from collections.abc import Callable, Iterator
from types import FrameType


def interrupted(function, when: Callable[..., bool] = lambda *_, **__: True):
    """The same function, but a call with arguments of which `when` is true is interrupted, as by Ctrl-C."""

    def call(*arguments, **named):
        if when(*arguments, **named):
            raise KeyboardInterrupt
        return function(*arguments, **named)

    return call


@contextlib.contextmanager
def interrupt_before(instruction: int) -> Iterator[list[int]]:
    """Interrupt this thread, as Ctrl-C does, before an instruction of the functions that it calls in the block.

    Instructions that draw scenarios, thousands for each, do not count. Yields a list of one number, how many there have
    been so far.
    """
    seen = [0]

    def trace(frame: FrameType, event: str, _):
        if "/scenarios/" in frame.f_code.co_filename:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            seen[0] += 1
            if seen[0] == instruction:
                signal.raise_signal(signal.SIGINT)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield seen
    finally:
        sys.settrace(before)
