"""One thread at a time within an environment."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Concatenate, ParamSpec, Protocol, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Use:
    """Whether an environment is in use, by one thread at a time. A copy begins unused."""

    def __init__(self) -> None:
        lock = threading.Lock()
        # Methods of the lock itself: a call of a Python function would take longer than both together.
        self.take, self.give_back = lock.acquire, lock.release

    def __reduce__(self) -> tuple[type[Use], tuple[()]]:
        return Use, ()


class _Used(Protocol):
    _use: Use


S = TypeVar("S", bound=_Used)


def one_thread(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Let a method of an environment raise a RuntimeError while another thread is within such a method.

    Compiled code runs without the interpreter's lock: two threads in one environment would mix their numbers silently.
    """

    @functools.wraps(method)
    def run(self: S, /, *arguments: P.args, **keywords: P.kwargs) -> R:
        use = self._use
        if not use.take(False):
            raise in_use(self, method.__name__)
        try:
            return method(self, *arguments, **keywords)
        finally:
            use.give_back()

    return run


def in_use(environment: object, method: str) -> RuntimeError:
    """Return the error of a method that was called while another thread was within the environment."""
    return RuntimeError(
        f"{type(environment).__name__}.{method}() was called while another thread uses the same environment; "
        "give every thread an environment of its own, or let a lock keep them apart"
    )


__all__ = ["Use", "in_use", "one_thread"]
