"""Changes that no signal cuts in two: handlers, such as that of Ctrl-C, wait until a change is complete."""

import functools
import threading

# The functions of `signal` itself convert to and from enums, which takes as long as the step of an environment.
from _signal import getsignal, signal, valid_signals  # type: ignore[import-not-found]
from collections.abc import Callable
from types import FrameType
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
Handler = Callable[[int, FrameType | None], Any]

#: All but the real-time signals, half of them all, which stop no program.
_SIGNALS = tuple(number for number in valid_signals() if number < 32)


class HeldSignals:
    """Let the handlers of signals wait until a `with` block has ended.

    Python runs handlers between two instructions of the main thread. What they raise, such as the KeyboardInterrupt of
    Ctrl-C, would leave a change half made. After the block each handler whose signal has arrived runs once. Within
    another such block, and in other threads, where handlers never run, the block changes nothing.
    """

    #: Whether handlers wait now.
    _holds = False

    def __init__(self) -> None:
        self._handlers: dict[int, Handler] = {}
        self._depth = 0

    def __enter__(self) -> None:
        self._depth += 1
        if HeldSignals._holds or threading.get_ident() != threading.main_thread().ident:
            return
        self._arrived: dict[int, FrameType | None] = {}
        self._handlers = {number: handler for number in _SIGNALS if callable(handler := getsignal(number))}
        try:
            for number in self._handlers:
                signal(number, self._note)
            HeldSignals._holds = bool(self._handlers)
        except BaseException:
            # The handler of a signal that was not held yet has raised.
            self.__exit__()
            raise

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._handlers and self._depth == 0:
            HeldSignals._holds = False
            self._release()
            self._handlers = {}

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._arrived[number] = frame

    def _release(self) -> None:
        """Put handlers back, but where the block has set others, and run all whose signal came, even if some raise."""
        try:
            for number, handler in self._handlers.items():
                if getsignal(number) == self._note:
                    signal(number, handler)
            while self._arrived:
                number, frame = self._arrived.popitem()
                self._handlers[number](number, frame)
        except BaseException:
            self._release()
            raise


def undivided(function: Callable[P, R]) -> Callable[P, R]:
    """Let the handlers of signals wait until a function has returned, see :class:`HeldSignals`.

    So an interrupt leaves the function not begun, or complete with its result lost.
    """

    @functools.wraps(function)
    def run(*arguments: P.args, **keywords: P.kwargs) -> R:
        with HeldSignals():
            return function(*arguments, **keywords)

    return run
