"""Policies as ONNX files, which onnxruntime plays each scenario apart, in a process of its own with limits.

A policy's graph has the batch as the first axis of everything: inputs `observation` (batch, n_observation) and, for a
policy with memory, `state_0`, `state_1`, … (batch, n); outputs `action` (batch, n_action) and as many `next_state_0`, …
of the same widths. All are float32, all states are zero at the start of an episode. The batch is 1, or 16 for a graph
that treats every row apart, so no row depends on another one. Scenarios, simulation and score stay here: a policy can
neither see nor forge them.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import numpy.typing as npt

from wtg_gym.files import printable, read_bytes, sha256
from wtg_gym.policies import locked_worker
from wtg_gym.policies.locked_worker import ACTIONS, LENGTH

Floats = npt.NDArray[np.float32]
#: The recurrent states, (num_envs, n) each.
States = tuple[Floats, ...]

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
_SCRIPT = locked_worker.__file__
#: Longest message that the process may send [bytes].
_LONGEST_MESSAGE = 65_536
#: Most states and most values of an input or output, more than any policy of this benchmark needs.
MOST_STATES, WIDEST = 16, 65_536
#: Has malloc fill memory with one byte and keep no caches, so that no call finds what another one left there.
_MALLOC = "glibc.malloc.tcache_count=0:glibc.malloc.perturb=165"
#: Most episodes side by side: each may have its own session, and more of them than the processor's cache holds take
#: three times as long a step.
_MOST_EPISODES = 64
#: Bytes of files that many sessions hold; the memory of the process is eight times as large.
_MEMORY_OF_FILES = 2**29
_SIGNALS = {
    "SIGXCPU": f"more than {CPU_S} s of processor time",
    "SIGFPE": "an error of arithmetic, such as the division of whole numbers by zero",
}


class PolicyError(ValueError):
    """A policy, or the law of an entry, cannot be played; the message says why."""


class NotIsolatedError(PolicyError):
    """This system cannot start or isolate the process of a policy; the policy did not fail."""


class OnnxPolicy:
    """A policy in an .onnx file. Its process starts with the first observation; end it with :meth:`close`.

    As a context manager it begins with a new process, and ends it. It travels to other processes as its bytes. A
    ValueError says that the file cannot be read.

    Args:
        file: the path of the file, weights included, or its content.
        isolated: refuse to play where this system cannot isolate the process, as Linux can; else that is a warning.
    """

    def __init__(self, file: str | Path | bytes, *, isolated: bool = False) -> None:
        self.__setstate__((file if isinstance(file, bytes) else read_bytes(Path(file), "policy"), isolated))

    def __getstate__(self) -> tuple[bytes, bool]:
        return self._content, self._isolated

    def __setstate__(self, state: tuple[bytes, bool]) -> None:
        self._content, self._isolated = state
        #: sha256 of the file.
        self.sha256 = sha256(self._content)
        #: The process that plays it, while there is one.
        self._processes: list[PolicyProcess] = []
        weakref.finalize(self, _close_all, self._processes)

    @property
    def most_episodes(self) -> int:
        """How many episodes it plays at a time: each may need a session, so the memory of the file, of its own."""
        return min(_MOST_EPISODES, max(1, _MEMORY_OF_FILES // len(self._content)))

    def predict(
        self, observation: Any, state: States | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats, States | None]:
        """Return (actions (num_envs, n_action), next states) for observations (num_envs, n_observation).

        The state is None at the beginning, and zero where an episode starts, (num_envs,) bool. A NotIsolatedError says
        that this system cannot isolate the process, though `isolated` is set, another PolicyError that the file is no
        policy, that shapes do not fit, or that the process ended or took too long.
        """
        n_observation, n_action, *widths = self.widths
        observations = np.ascontiguousarray(observation, dtype=np.float32)
        if observations.ndim != 2 or observations.shape[1] != n_observation:
            raise PolicyError(
                f"the policy takes observations of shape (num_envs, {n_observation}), got {observations.shape}: was it "
                "trained with another action_mode, observation_mode or groups?"
            )
        num_envs = len(observations)
        expected = [(num_envs, width) for width in widths]
        states = tuple(np.zeros(shape, dtype=np.float32) for shape in expected) if state is None else state
        if [values.shape for values in states] != expected:
            raise PolicyError(f"the policy has states of shapes {expected}, got {[values.shape for values in states]}")
        starts = np.zeros(num_envs, np.bool_) if episode_start is None else np.asarray(episode_start, dtype=np.bool_)
        states = tuple(np.where(starts[:, None], np.float32(0.0), values) for values in states)
        try:
            request = [LENGTH.pack(num_envs), *(values.tobytes() for values in (starts, observations, *states))]
            sizes = [4 * num_envs * width for width in (n_action, *widths)]
            answers = self._running().ask(b"".join(request), sizes, starts=bool(starts.any()))
        except BaseException:
            # The rest of an answer that was not read to its end would be taken for the next one.
            self.close()
            raise
        action, *following = (np.frombuffer(data, dtype=np.float32).reshape(num_envs, -1).copy() for data in answers)
        return action, tuple(following) if following else None

    def _running(self) -> "PolicyProcess":
        if not self._processes:
            self._processes.append(PolicyProcess(self._content, isolated=self._isolated))
        return self._processes[0]

    @property
    def widths(self) -> tuple[int, ...]:
        """Widths of the observations, the actions, and each state; errors as those of :meth:`predict`."""
        return tuple(self._running().widths)

    @property
    def not_isolated(self) -> tuple[str, ...]:
        """Limits that this system does not enforce; empty where it isolates. Errors as of :meth:`predict`."""
        return tuple(self._running().missing)

    def close(self) -> None:
        """End the process; the next observation starts another one."""
        _close_all(self._processes)

    def __enter__(self) -> "OnnxPolicy":
        self.close()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _close_all(processes: "list[PolicyProcess]") -> None:
    while processes:
        processes.pop().close()


class PolicyProcess:
    """A process with one policy, the content of an .onnx file; it ends with this one, and must be closed.

    A NotIsolatedError says that this system cannot start the process, or cannot isolate it and `isolated` is set,
    another PolicyError that onnxruntime cannot load the file as a policy.
    """

    def __init__(self, content: bytes, *, isolated: bool) -> None:
        #: Limits that this system does not enforce.
        self.missing: list[str] = []
        #: Widths of the observations, the actions, and each state.
        self.widths: list[int] = []
        self._deadline, self._waited_s = float("inf"), 0.0
        self._timed_out = self._has_answered = False
        self._process = _start(weak=not isolated)
        try:
            threading.Thread(target=self._watch, daemon=True).start()
            self._open(content, isolated)
        except BaseException:
            self.close()
            raise

    def _open(self, content: bytes, isolated: bool) -> None:
        with self._within(LOAD_S):
            try:
                self.missing = [_plain(text) for text in self._message().get("missing", [])]
            except PolicyError as error:
                # It has not seen the policy yet.
                raise NotIsolatedError(f"this system cannot start the process of a policy: {error}") from error
            if self.missing and isolated:
                raise NotIsolatedError(f"this system cannot isolate the policy's process: {'; '.join(self.missing)}")
            self._write(LENGTH.pack(len(content)) + content)
            message = self._message()
        if self.missing:
            warnings.warn(f"policies are not isolated on this system: {'; '.join(self.missing)}", stacklevel=2)
        if "widths" not in message:
            raise PolicyError(f"onnxruntime cannot load the policy: {_plain(message.get('error'))}")
        widths = message["widths"]
        fits = isinstance(widths, list) and 2 <= len(widths) <= 2 + MOST_STATES
        if not fits or not all(type(width) is int and 1 <= width <= WIDEST for width in widths):
            raise PolicyError(
                f"a policy may have up to {MOST_STATES} states, and each of its inputs and outputs 1 … {WIDEST} values"
            )
        self.widths = widths

    def ask(self, request: bytes, sizes: list[int], *, starts: bool) -> list[bytes]:
        """Send observations and states; return as many bytes of actions and next states as `sizes` say.

        Sessions are opened in the first step and where episodes start. A policy that cannot answer is a PolicyError.
        """
        with self._within(LOAD_S if starts or not self._has_answered else STEP_S):
            self._write(request)
            if self._read(1) != ACTIONS:
                raise PolicyError(f"the policy cannot answer: {_plain(self._message().get('error'))}")
            data = [self._read(size) for size in sizes]
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

    @contextlib.contextmanager
    def _within(self, seconds: float) -> Iterator[None]:
        """Have the process killed if its answer takes too long [s]; only waiting counts for the total."""
        began = time.monotonic()
        self._deadline = began + min(seconds, max(0.0, TOTAL_S - self._waited_s))
        yield
        self._deadline = float("inf")
        self._waited_s += time.monotonic() - began

    def _watch(self) -> None:
        while self._process.poll() is None:
            if time.monotonic() > self._deadline:
                self._timed_out = True
                self._process.kill()
            time.sleep(_WATCH_S)

    def _ended(self) -> PolicyError:
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
