"""Policies as ONNX files, which onnxruntime plays one scenario at a time, in a process of its own.

A policy's graph has the batch as the first axis of everything: inputs `observation` (batch, n_observation) and, for a
policy with memory, `state_0`, `state_1`, … (batch, n); outputs `action` (batch, n_action) and as many `next_state_0`, …
of the same widths. All are float32, all states are zero at the start of an episode. The batch is always 1, so no graph
sees two scenarios at once.
"""

from __future__ import annotations

import weakref
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.files import read_bytes, sha256
from wtg_gym.policies.onnx_worker import LENGTH
from wtg_gym.policies.policy_process import PolicyError, PolicyProcess

Floats = npt.NDArray[np.float32]
#: The recurrent states, (n_lanes, n) each.
States = tuple[Floats, ...]

#: Most episodes side by side: each has its own session, and more of them than the processor's cache holds take three
#: times as long a step.
_MOST_EPISODES = 64
#: Bytes of files that many sessions hold; the memory of the process is eight times as large.
_MEMORY_OF_FILES = 2**29


class OnnxPolicy:
    """A policy in an .onnx file. Its process starts with the first observation; end it with :meth:`close`.

    As a context manager it begins with a new process, and ends it. It travels to other processes as its bytes.

    Args:
        file: the path of the file, weights included, or its content.
        isolated: refuse to play where this system cannot isolate the process, as Linux can; else that is a warning.

    Raises:
        ValueError: the file cannot be read.
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
        """Return (actions (n_lanes, n_action), next states) for observations (n_lanes, n_observation).

        Args:
            observation: one row per lane.
            state: the states that the last call returned; None at the beginning.
            episode_start: lanes where an episode starts, (n_lanes,) bool: their state is zero, and their session a new
                one; None for none.
            deterministic: the file holds the deterministic action only; the argument is there for the protocol.

        Raises:
            NotIsolatedError: this system cannot isolate the process, and `isolated` was set.
            PolicyError: the file is no policy, the observations or states are of another shape, the process ended or
                took too long, or the answer is of another form.
        """
        n_observation, n_action, *widths = self.widths
        observations = np.ascontiguousarray(observation, dtype=np.float32)
        if observations.ndim != 2 or observations.shape[1] != n_observation:
            raise PolicyError(
                f"the policy takes observations of shape (lanes, {n_observation}), got {observations.shape}: was it "
                "trained with another action_mode, observation_mode or groups?"
            )
        n_lanes = len(observations)
        expected = [(n_lanes, width) for width in widths]
        states = tuple(np.zeros(shape, dtype=np.float32) for shape in expected) if state is None else state
        if [values.shape for values in states] != expected:
            raise PolicyError(f"the policy has states of shapes {expected}, got {[values.shape for values in states]}")
        starts = np.zeros(n_lanes, np.bool_) if episode_start is None else np.asarray(episode_start, dtype=np.bool_)
        states = tuple(np.where(starts[:, None], np.float32(0.0), values) for values in states)
        try:
            action, *following = self._answers([starts, observations, *states], [n_action, *widths])
        except BaseException:
            # The rest of an answer that was not read to its end would be taken for the next one.
            self.close()
            raise
        return action, tuple(following) if following else None

    def _answers(self, given: list[npt.NDArray[Any]], widths: list[int]) -> list[Floats]:
        """Return arrays (n_lanes, width) for the arrays given, the starts first."""
        process, n_lanes = self._running(), len(given[0])
        request = b"".join((LENGTH.pack(n_lanes), *(values.tobytes() for values in given)))
        answers = process.ask(request, [4 * n_lanes * width for width in widths], starts=bool(given[0].any()))
        return [
            np.frombuffer(data, dtype=np.float32).reshape(n_lanes, width).copy()
            for data, width in zip(answers, widths, strict=True)
        ]

    def _running(self) -> PolicyProcess:
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

    def __enter__(self) -> OnnxPolicy:
        self.close()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _close_all(processes: list[PolicyProcess]) -> None:
    while processes:
        processes.pop().close()
