"""The process in which a stranger's policy is looked at and played: it computes, and can do nothing else.

Started by :mod:`wtg_gym.submissions.isolation`. It loads the libraries, has the kernel take everything else away, and
only then reads the policy from stdin, looks at it, loads it and answers observations with actions; a message is JSON
with its length before it, arrays are float32 without anything around them. It never learns which scenario is played,
and its answers are all that comes out of it.
"""

from __future__ import annotations

import ctypes
import json
import os
import struct
import sys
from collections.abc import Callable
from typing import Any, BinaryIO

from wtg_gym.submissions.lockdown import lock

_PR_SET_PDEATHSIG, _SIGKILL = 1, 9
#: Before a message: its length; before observations: the number of lanes.
LENGTH = struct.Struct("<I")
ACTIONS, COMPLAINT = b"\x00", b"\x01"


def main() -> None:
    """Serve one policy, until stdin ends."""
    wanted = json.loads(sys.argv[1])
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # What a library prints must not end up among the answers.
    os.dup2(2, 1)
    missing = [_limit(wanted)]
    # What the libraries open, they must have opened before.
    inspect = _rehearse()
    missing = [text for text in (*missing, lock(source.fileno(), sink.fileno())) if text]
    _send(sink, {"missing": missing})
    if missing and not wanted["weak"]:
        return
    content = _read(source, LENGTH.unpack(_read(source, LENGTH.size))[0])
    checks = inspect(content, wanted["n_observation"], wanted["n_action"])
    _send(sink, {"checks": checks})
    if all(passed for _, passed, _ in checks):
        _serve(content, source, sink)


def _limit(wanted: dict[str, Any]) -> str:
    """Bound memory and time, and end with the process that started this one; return what this system would not do."""
    if sys.platform != "linux":
        return f"limits of memory and time: {sys.platform} does not enforce them"
    import resource

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, _SIGKILL)
    for name, value in (("RLIMIT_AS", wanted["memory_bytes"]), ("RLIMIT_CPU", wanted["cpu_s"]), ("RLIMIT_CORE", 0)):
        try:
            resource.setrlimit(getattr(resource, name), (value, value))
        except (OSError, ValueError) as error:
            return f"limits of memory and time: {name} {error}"
    return ""


def _rehearse() -> Callable[[bytes, int, int], list[tuple[str, bool, str]]]:
    """Look at a policy of our own, load it and ask it once; return what looks at a file."""
    import numpy as np

    from wtg_gym.submissions.graph import example, inspect

    content = example()
    inspect(content, 1, 1)
    _load(content).run(None, {"observation": np.zeros((1, 1), dtype=np.float32)})
    return inspect


def _load(content: bytes) -> Any:
    from wtg_gym.onnx_session import open_session

    return open_session(content)


def _serve(content: bytes, source: BinaryIO, sink: BinaryIO) -> None:
    import numpy as np

    try:
        session = _load(content)
        widths = {value.name: int(value.shape[1]) for value in session.get_inputs()}
        outputs = {value.name: int(value.shape[1]) for value in session.get_outputs()}
    except Exception as error:
        _send(sink, {"error": f"onnxruntime cannot load it: {_text(error)}"})
        return
    n_states = len(widths) - 1
    inputs = ["observation", *(f"state_{index}" for index in range(n_states))]
    names = ["action", *(f"next_state_{index}" for index in range(n_states))]
    _send(sink, {"states": [widths[name] for name in inputs[1:]]})
    while head := source.read(LENGTH.size):
        n_lanes = LENGTH.unpack(head)[0]
        feed = {
            name: np.frombuffer(_read(source, 4 * n_lanes * widths[name]), dtype="<f4").reshape(n_lanes, widths[name])
            for name in inputs
        }
        try:
            answers = session.run(names, feed)
            for name, answer in zip(names, answers, strict=True):
                if answer.shape != (n_lanes, outputs[name]) or answer.dtype != np.float32:
                    raise ValueError(f"{name} is {answer.dtype} of shape {answer.shape}")
        except Exception as error:
            sink.write(COMPLAINT)
            _send(sink, {"error": _text(error)})
            return
        sink.write(ACTIONS + b"".join(answer.astype("<f4").tobytes() for answer in answers))
        sink.flush()


def _text(error: Exception) -> str:
    return ascii(f"{type(error).__name__}: {error}"[:300])[1:-1]


def _send(sink: BinaryIO, message: dict[str, Any]) -> None:
    data = json.dumps(message).encode()
    sink.write(LENGTH.pack(len(data)) + data)
    sink.flush()


def _read(source: BinaryIO, size: int) -> bytes:
    data = source.read(size)
    if len(data) < size:
        sys.exit(0)
    return data


if __name__ == "__main__":
    main()
