"""Commands that are interrupted or killed in their middle, for the tests of what they leave and how they go on."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from typing import Any


def interrupted(function: Callable[..., Any], when: Callable[..., bool] = lambda *_, **__: True) -> Callable[..., Any]:
    """The same function, but a call with arguments of which `when` is true is interrupted, as by Ctrl-C."""

    def call(*arguments: Any, **named: Any) -> Any:
        if when(*arguments, **named):
            raise KeyboardInterrupt
        return function(*arguments, **named)

    return call


def end(process: subprocess.Popen[Any], sign: int, when: Callable[[], bool]) -> str:
    """Send a signal to a running process as soon as `when` is true; return what it said on stderr."""
    until = time.monotonic() + 240.0
    while not when():
        assert process.poll() is None and time.monotonic() < until
        time.sleep(0.001)
    process.send_signal(sign)
    return process.communicate(timeout=100)[1] or ""
