"""Policies as ONNX files: plain data, no code of anybody's is run.

A policy's graph has the batch as the first axis of everything: inputs `observation` (batch, n_observation) and, for a
policy with memory, `state_0`, `state_1`, … (batch, n); outputs `action` (batch, n_action) and as many `next_state_0`, …
of the same widths. All are float32, all states are zero at the start of an episode.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.files import sha256
from wtg_gym.onnx_session import open_session

Floats = npt.NDArray[np.float32]
#: The recurrent states, (n_lanes, n) each.
States = tuple[Floats, ...]


class OnnxPolicy:
    """A policy that onnxruntime evaluates, on one thread so that its results do not depend on the machine's load.

    Args:
        path: the .onnx file, weights included.

    Raises:
        ImportError: onnxruntime is not installed.
        ValueError: the file cannot be read, or its inputs and outputs are not those of a policy.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            content = Path(path).read_bytes()
        except OSError as error:
            raise ValueError(f"cannot read the policy {path}: {error.strerror}") from error
        self._open(path, content)

    def __getstate__(self) -> tuple[str | Path, bytes]:
        # onnxruntime's session cannot be pickled, what it was opened from can.
        return self._path, self._content

    def __setstate__(self, state: tuple[str | Path, bytes]) -> None:
        self._open(*state)

    def _open(self, path: str | Path, content: bytes) -> None:
        self._path, self._content = Path(path), content
        #: sha256 of the file.
        self.sha256 = sha256(content)
        try:
            self._session = open_session(content)
        except ImportError as error:
            raise ImportError("policies as ONNX files need onnxruntime: pip install 'wtg-gym[agents]'") from error
        # onnxruntime's own exceptions share no other base.
        except Exception as error:
            raise ValueError(f"{path} is no ONNX model that onnxruntime can run: {error}") from error
        inputs, outputs = self._widths(self._session.get_inputs()), self._widths(self._session.get_outputs())
        self._states = [name for name in inputs if name != "observation"]
        states = [f"state_{index}" for index in range(len(self._states))]
        expected_outputs = {"action": outputs.get("action"), **{f"next_{name}": inputs.get(name) for name in states}}
        if set(inputs) != {"observation", *states} or outputs != expected_outputs:
            raise ValueError(
                f"the policy {path} must take observation, state_0, state_1, … and give action, next_state_0, … of the "
                f"states' widths; it takes {inputs} and gives {outputs}"
            )
        self._states = states
        self.n_observation, self.n_action = inputs["observation"], outputs["action"]
        self._state_widths = [inputs[name] for name in states]
        self._outputs = ["action", *(f"next_{name}" for name in states)]

    def _widths(self, values: Any) -> dict[str, int]:
        """Return the width of every input or output, or raise where one is not (batch, width) float32."""
        for value in values:
            shape = value.shape
            fits = len(shape) == 2 and not isinstance(shape[0], int) and isinstance(shape[1], int)
            if value.type != "tensor(float)" or not fits:
                raise ValueError(
                    f"{value.name} of the policy {self._path} must be float32 of shape (batch, n) with any batch, "
                    f"got {value.type} of shape {shape}"
                )
        return {value.name: int(value.shape[1]) for value in values}

    def predict(
        self, observation: Any, state: States | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats, States | None]:
        """Return (actions (n_lanes, n_action), next states) for observations (n_lanes, n_observation).

        Args:
            observation: one row per lane.
            state: what the last call returned; None at the beginning.
            episode_start: lanes whose state is to be zero, (n_lanes,) bool; None for none.
            deterministic: the file holds the deterministic action only; the argument is there for the protocol.

        Raises:
            ValueError: the observations or states are of another shape.
        """
        observations = np.asarray(observation, dtype=np.float32)
        if observations.ndim != 2 or observations.shape[1] != self.n_observation:
            raise ValueError(
                f"the policy {self._path} takes observations of shape (lanes, {self.n_observation}), got "
                f"{observations.shape}: was it trained with another action_mode, observation_mode or groups?"
            )
        n_lanes = observations.shape[0]
        expected = [(n_lanes, width) for width in self._state_widths]
        states = tuple(np.zeros(shape, dtype=np.float32) for shape in expected) if state is None else state
        if [values.shape for values in states] != expected:
            raise ValueError(
                f"the policy {self._path} has states of shapes {expected}, got {[values.shape for values in states]}"
            )
        if episode_start is not None:
            running = ~np.asarray(episode_start, dtype=np.bool_)[:, None]
            states = tuple(np.where(running, values, np.float32(0.0)) for values in states)
        feed = {"observation": observations, **dict(zip(self._states, states, strict=True))}
        action, *following = self._session.run(self._outputs, feed)
        return action, tuple(following) if following else None


__all__ = ["OnnxPolicy"]
