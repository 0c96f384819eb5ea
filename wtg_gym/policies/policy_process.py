"""Starts the process that plays a policy, and holds it to limits of memory and time.

The scenarios, the simulation and the score stay here, so a policy can neither see the scenario nor forge a result.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from typing import IO, Any, cast

from wtg_gym.files import printable
from wtg_gym.policies import onnx_worker
from wtg_gym.policies.onnx_worker import ACTIONS, LENGTH

#: Address space [bytes] and processor time [s] of the process; it plays a batch of scenarios and then ends.
MEMORY_BYTES = 4 * 2**30
CPU_S = 600
#: How long a policy is waited for [s]: until it is loaded and for the first step, which opens the sessions of its
#: scenarios; for any other step of all of them; and in all.
LOAD_S = 60.0
STEP_S = 10.0
TOTAL_S = 1800.0
#: How often the waiting is looked at [s].
_WATCH_S = 0.2
_SCRIPT = onnx_worker.__file__
#: Longest message that the process may send [bytes].
_LONGEST_MESSAGE = 65_536
#: Most states and most values of an input or output, more than any policy of this benchmark needs.
MOST_STATES, WIDEST = 16, 65_536
#: Has malloc fill memory with one byte and keep no caches, so that no call finds what another one left there.
_MALLOC = "glibc.malloc.tcache_count=0:glibc.malloc.perturb=165"
_SIGNALS = {
    "SIGXCPU": f"more than {CPU_S} s of processor time",
    "SIGFPE": "an error of arithmetic, such as the division of whole numbers by zero",
}


class PolicyError(ValueError):
    """A policy, or the law of an entry, cannot be played; the message says why."""


class NotIsolatedError(PolicyError):
    """This system cannot start or isolate the process of a policy; the policy did not fail."""


class PolicyProcess:
    """A process with one policy; it ends with this one, and must be closed.

    Args:
        content: the .onnx file.
        isolated: refuse to play where this system cannot isolate the process; else that is a warning.

    Raises:
        NotIsolatedError: this system cannot start the process, or cannot isolate it and `isolated` is set.
        PolicyError: onnxruntime cannot load the file as a policy.
    """

    def __init__(self, content: bytes, *, isolated: bool) -> None:
        #: Limits that this system does not enforce.
        self.missing: list[str] = []
        #: Widths of the observations, the actions, and each state.
        self.widths: list[int] = []
        self._began, self._deadline, self._waited_s = 0.0, float("inf"), 0.0
        self._timed_out = self._has_answered = False
        self._process = _start(weak=not isolated)
        try:
            threading.Thread(target=self._watch, daemon=True).start()
            self._open(content, isolated)
        except BaseException:
            self.close()
            raise

    def _open(self, content: bytes, isolated: bool) -> None:
        self._begin(LOAD_S)
        try:
            self.missing = [_plain(text) for text in self._message().get("missing", [])]
        except PolicyError as error:
            # It has not seen the policy yet.
            raise NotIsolatedError(f"this system cannot start the process of a policy: {error}") from error
        if self.missing and isolated:
            raise NotIsolatedError(f"this system cannot isolate the policy's process: {'; '.join(self.missing)}")
        self._write(LENGTH.pack(len(content)) + content)
        message = self._message()
        self._end()
        if self.missing:
            warnings.warn(f"policies are not isolated on this system: {'; '.join(self.missing)}", stacklevel=2)
        if "widths" not in message:
            raise PolicyError(f"onnxruntime cannot load the policy: {_plain(message.get('error'))}")
        widths = message["widths"]
        if (
            not isinstance(widths, list)
            or not 2 <= len(widths) <= 2 + MOST_STATES
            or not all(type(width) is int and 1 <= width <= WIDEST for width in widths)
        ):
            raise PolicyError(
                f"a policy may have up to {MOST_STATES} states, and each of its inputs and outputs 1 … {WIDEST} values"
            )
        self.widths = widths

    def ask(self, request: bytes, sizes: list[int], *, starts: bool) -> list[bytes]:
        """Send observations and states; return as many bytes of actions and next states as `sizes` say.

        Sessions are opened first in the first step, and where episodes start.

        Raises:
            PolicyError: the process ended, took too long, or the policy cannot answer.
        """
        self._begin(LOAD_S if starts or not self._has_answered else STEP_S)
        self._write(request)
        if self._read(1) != ACTIONS:
            raise PolicyError(f"the policy cannot answer: {_plain(self._message().get('error'))}")
        data = [self._read(size) for size in sizes]
        self._end()
        self._has_answered = True
        return data

    def _message(self) -> dict[str, Any]:
        size = LENGTH.unpack(self._read(LENGTH.size))[0]
        if size > _LONGEST_MESSAGE:
            raise PolicyError(f"the policy's process sent {size} bytes, allowed are {_LONGEST_MESSAGE}")
        try:
            message = json.loads(self._read(size))
        except (ValueError, RecursionError) as error:
            raise PolicyError("the policy's process sent a message that is no JSON") from error
        if not isinstance(message, dict):
            raise PolicyError("the policy's process sent a message that is no object")
        return message

    def _read(self, size: int) -> bytes:
        data = cast(IO[bytes], self._process.stdout).read(size)
        if len(data) < size:
            raise self._ended()
        return data

    def _write(self, data: bytes) -> None:
        stream = cast(IO[bytes], self._process.stdin)
        try:
            stream.write(data)
            stream.flush()
        except OSError as error:
            raise self._ended() from error

    def _begin(self, seconds: float) -> None:
        """Have the process killed if its next answer takes too long [s]; only waiting counts for the total."""
        self._began = time.monotonic()
        self._deadline = self._began + min(seconds, max(0.0, TOTAL_S - self._waited_s))

    def _end(self) -> None:
        self._deadline = float("inf")
        self._waited_s += time.monotonic() - self._began

    def _watch(self) -> None:
        while self._process.poll() is None:
            if time.monotonic() > self._deadline:
                self._timed_out = True
                self._process.kill()
            time.sleep(_WATCH_S)

    def _ended(self) -> PolicyError:
        """Return the error that says how the process ended."""
        # It has closed its end: its exit code follows in a moment.
        try:
            code = self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        if self._timed_out:
            limits = f"{LOAD_S:g} s to load or for the first step, {STEP_S:g} s for a step, or {TOTAL_S:g} s in all"
            return PolicyError(f"the policy took longer than {limits}")
        how = f"exit code {code}"
        if code < 0:
            name = signal.Signals(-code).name
            how = f"{name}: {_SIGNALS.get(name, f'a fault, or more than {MEMORY_BYTES // 2**20} MiB of memory')}"
        return PolicyError(f"the policy's process ended with {how}")

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            # Closing the stream writes the rest of its buffer, which has no reader any more.
            with contextlib.suppress(OSError):
                cast(IO[bytes], stream).close()


def _start(*, weak: bool) -> subprocess.Popen[bytes]:
    wanted = {"weak": weak, "memory_bytes": MEMORY_BYTES, "cpu_s": CPU_S}
    environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "GLIBC_TUNABLES": _MALLOC}
    # onnxruntime would keep a file and a thread to report its use.
    environment["ORT_DISABLE_TELEMETRY"] = "1"
    if os.name == "nt":
        # Without it Windows finds no random numbers, and Python does not start.
        environment["SYSTEMROOT"] = os.environ.get("SYSTEMROOT", "")
    # -P: nothing is imported from the script's folder or the working one; -B: nothing is written beside the sources.
    return subprocess.Popen(
        [sys.executable, "-P", "-B", _SCRIPT, json.dumps(wanted)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd="/",
        env=environment,
    )


def _plain(text: Any) -> str:
    """Return a text of the process as one printable line without the signs that end a block of code."""
    return printable(str(text)[:400]).replace("`", "'")
