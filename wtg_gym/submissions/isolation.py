"""A policy in a process of its own: it gets observations and gives actions, and can do nothing else.

The scenarios, the simulation and the score stay here, so a policy can neither see what is played nor forge a result.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast

import numpy as np

import wtg_gym
from wtg_gym.evaluation.onnx_policy import Floats, States
from wtg_gym.files import sha256
from wtg_gym.submissions import limits
from wtg_gym.submissions.worker import ACTIONS, LENGTH

#: Longest message that the process may send [bytes].
_LONGEST_MESSAGE = 65_536
WEAK_OPTION = "--weak-isolation"
_START = "import sys; sys.path.insert(0, sys.argv.pop(1)); from wtg_gym.submissions.worker import main; main()"


class SubmissionError(ValueError):
    """A submission cannot be played; the message says why."""


class NotIsolatedError(SubmissionError):
    """This system cannot isolate a process."""


class IsolatedPolicy:
    """A policy file that is looked at, loaded and asked in a process of its own; close it after use.

    The process can reach no file, no network and no other process, and is bounded in memory and time. It ends with this
    one.

    Args:
        content: the .onnx file.
        n_observation: width of its observations.
        n_action: width of its actions.
        weak: go on where this system cannot isolate the process completely; `missing` then says what is not isolated.

    Raises:
        NotIsolatedError: this system cannot, and `weak` is not set.
        SubmissionError: the process ended or took too long before the file was looked at.
    """

    def __init__(self, content: bytes, n_observation: int, n_action: int, *, weak: bool = False) -> None:
        self.sha256 = sha256(content)
        self.n_observation, self.n_action = n_observation, n_action
        #: What was found in the file: check, whether it passed, what it said.
        self.checks: list[tuple[str, bool, str]] = []
        #: What this system would not take away from the process.
        self.missing: list[str] = []
        #: Why the policy is not loaded; empty where it is.
        self.error = "the file is refused"
        self._widths: list[int] = []
        self._waited_s = 0.0
        self._timed_out = False
        self._process = self._start(weak)
        try:
            self._open(content, weak)
        except BaseException:
            self.close()
            raise

    def _start(self, weak: bool) -> subprocess.Popen[bytes]:
        wanted = {
            "n_observation": self.n_observation,
            "n_action": self.n_action,
            "weak": weak,
            "memory_bytes": limits.MEMORY_BYTES,
            "cpu_s": limits.CPU_S,
        }
        environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        if os.name == "nt":
            # Without it Windows finds no random numbers, and Python does not start.
            environment["SYSTEMROOT"] = os.environ.get("SYSTEMROOT", "")
        package = str(Path(wtg_gym.__file__).resolve().parent.parent)
        # -P: nothing is imported from the working folder; -B: nothing is written beside the sources.
        command = [sys.executable, "-P", "-B", "-c", _START, package, json.dumps(wanted)]
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd="/",
            env=environment,
        )

    def _open(self, content: bytes, weak: bool) -> None:
        with self._wait(limits.LOAD_S):
            self.missing = [_plain(text) for text in self._message().get("missing", [])]
        if self.missing and not weak:
            raise NotIsolatedError(
                f"this system cannot isolate the policy's process: {'; '.join(self.missing)}. "
                f"{WEAK_OPTION} plays it all the same: do so with policies of people you trust"
            )
        with self._wait(limits.LOAD_S):
            self._write(LENGTH.pack(len(content)) + content)
            self.checks = _as_checks(self._message().get("checks"))
        if not all(passed for _, passed, _ in self.checks):
            return
        try:
            with self._wait(limits.LOAD_S):
                loaded = self._message()
            self.error = "" if "states" in loaded else _plain(loaded.get("error"))
        except SubmissionError as error:
            self.error = str(error)
        else:
            widths = loaded.get("states", [])
            if not isinstance(widths, list) or not all(isinstance(width, int) and width > 0 for width in widths):
                raise SubmissionError("the policy's process sent widths of states that are none")
            if len(widths) > limits.STATES or sum(widths) > limits.VALUES_PER_LANE:
                raise SubmissionError("the policy's process sent widths of states that are too large")
            self._widths = widths

    def predict(
        self, observation: Any, state: States | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats, States | None]:
        """Return (actions (n_lanes, n_action), next states), as :meth:`OnnxPolicy.predict` does.

        Raises:
            SubmissionError: the process ended, took too long, or the policy cannot answer.
        """
        if self.error:
            raise SubmissionError(f"the policy is not loaded: {self.error}")
        observations = np.ascontiguousarray(observation, dtype="<f4")
        n_lanes = observations.shape[0]
        if observations.shape != (n_lanes, self.n_observation):
            raise SubmissionError(f"observations must be (lanes, {self.n_observation}), got {observations.shape}")
        expected = [(n_lanes, width) for width in self._widths]
        states = tuple(np.zeros(shape, dtype="<f4") for shape in expected) if state is None else state
        if [values.shape for values in states] != expected:
            raise SubmissionError(f"states must be of shapes {expected}, got {[values.shape for values in states]}")
        if episode_start is not None:
            running = ~np.asarray(episode_start, dtype=np.bool_)[:, None]
            states = tuple(np.where(running, values, np.float32(0.0)) for values in states)
        parts = [LENGTH.pack(n_lanes), observations.tobytes(), *(np.asarray(s, "<f4").tobytes() for s in states)]
        answers = self._ask(b"".join(parts), [(n_lanes, self.n_action), *expected])
        return answers[0], tuple(answers[1:]) if len(answers) > 1 else None

    def _ask(self, request: bytes, shapes: list[tuple[int, int]]) -> list[Floats]:
        with self._wait(limits.CALL_S):
            self._write(request)
            if self._read(1) != ACTIONS:
                self.error = _plain(self._message().get("error"))[:400]
                raise SubmissionError(f"the policy cannot answer: {self.error}")
            data = [self._read(4 * rows * columns) for rows, columns in shapes]
        return [np.frombuffer(d, dtype="<f4").reshape(s).astype(np.float32) for d, s in zip(data, shapes, strict=True)]

    def _message(self) -> dict[str, Any]:
        size = LENGTH.unpack(self._read(LENGTH.size))[0]
        if size > _LONGEST_MESSAGE:
            raise SubmissionError(f"the policy's process sent {size} bytes, allowed are {_LONGEST_MESSAGE}")
        try:
            message = json.loads(self._read(size))
        except (ValueError, RecursionError) as error:
            raise SubmissionError("the policy's process sent a message that is no JSON") from error
        if not isinstance(message, dict):
            raise SubmissionError("the policy's process sent a message that is no object")
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
        except (BrokenPipeError, OSError) as error:
            raise self._ended() from error

    @contextlib.contextmanager
    def _wait(self, seconds: float) -> Iterator[None]:
        """Kill the process if what is done within takes too long [s]; only this time counts for the whole."""
        began = time.monotonic()
        timer = threading.Timer(min(seconds, max(0.0, limits.TOTAL_S - self._waited_s)), self._kill)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self._waited_s += time.monotonic() - began

    def _kill(self) -> None:
        self._timed_out = True
        self._process.kill()

    def _ended(self) -> SubmissionError:
        """Return the error that says how the process ended, once it has."""
        # It has closed its end: a moment for it to exit by itself tells how.
        try:
            code = self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        if self._timed_out:
            self.error = (
                f"it took longer than {limits.LOAD_S:g} s to load, {limits.CALL_S:g} s for a step, or "
                f"{limits.TOTAL_S:g} s in all"
            )
        else:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            self.error = (
                f"its process ended with {how}: more than {limits.MEMORY_BYTES // 2**20} MiB of memory or "
                f"{limits.CPU_S} s of processor time, or a fault"
            )
        return SubmissionError(self.error)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            # What was still to be written has no reader any more.
            with contextlib.suppress(OSError):
                cast(IO[bytes], stream).close()

    def __enter__(self) -> IsolatedPolicy:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _as_checks(given: Any) -> list[tuple[str, bool, str]]:
    if isinstance(given, list) and given and all(isinstance(row, list) and len(row) == 3 for row in given):
        return [(_plain(name)[:80], passed is True, _plain(reason)[:1500]) for name, passed, reason in given]
    raise SubmissionError("the policy's process sent a list of checks that is none")


def _plain(text: Any) -> str:
    """Return what the process says as one line that is no command to a terminal and ends no block of code."""
    return "".join(sign if sign.isprintable() and sign != "`" else "?" for sign in str(text))


__all__ = ["IsolatedPolicy", "NotIsolatedError", "SubmissionError"]
