"""The process in which a stranger's policy is looked at and played: no network, bounded memory and time.

Started by :mod:`wtg_gym.submissions.isolation`. It reads the policy from stdin, looks at it, loads it and answers
observations with actions; a message is JSON with its length before it, arrays are float32 without anything around them.
It never learns which scenario is played, and its answers are all that comes out of it.
"""

from __future__ import annotations

import ctypes
import json
import os
import socket
import struct
import sys
from typing import Any, BinaryIO

_CLONE_NEWUSER, _CLONE_NEWNET, _CLONE_NEWIPC = 0x1000_0000, 0x4000_0000, 0x0800_0000
_PR_SET_PDEATHSIG, _PR_SET_NO_NEW_PRIVS, _SIGKILL = 1, 38, 9
#: Before a message: its length; before observations: the number of lanes.
LENGTH = struct.Struct("<I")
ACTIONS, COMPLAINT = b"\x00", b"\x01"


def main() -> None:
    """Serve one policy, until stdin ends."""
    wanted = json.loads(sys.argv[1])
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # What a library prints must not end up among the answers.
    os.dup2(2, 1)
    missing = _isolate(wanted)
    _send(sink, {"missing": missing})
    if missing and not wanted["weak"]:
        return
    content = _read(source, LENGTH.unpack(_read(source, LENGTH.size))[0])
    from wtg_gym.submissions.graph import inspect

    checks = inspect(content, wanted["n_observation"], wanted["n_action"])
    _send(sink, {"checks": checks})
    if all(passed for _, passed, _ in checks):
        _serve(content, source, sink)


def _isolate(wanted: dict[str, Any]) -> list[str]:
    """Take away network, memory, time and files; return what this system would not take away."""
    return [text for text in (_limit(wanted), _cut_network()) if text]


def _limit(wanted: dict[str, Any]) -> str:
    try:
        import resource
    except ImportError:
        return f"limits of memory and time: {sys.platform} has none"
    limits = {
        "RLIMIT_AS": wanted["memory_bytes"],
        "RLIMIT_CPU": wanted["cpu_s"],
        "RLIMIT_NOFILE": wanted["open_files"],
        "RLIMIT_FSIZE": 0,
        "RLIMIT_CORE": 0,
    }
    if sys.platform != "linux":
        return f"limits of memory: {sys.platform} does not enforce them"
    for name, value in limits.items():
        try:
            resource.setrlimit(getattr(resource, name), (value, value))
        except (OSError, ValueError) as error:
            return f"limits of memory and time: {name} {error}"
    return ""


def _cut_network() -> str:
    if sys.platform != "linux":
        return f"no network: {sys.platform} offers no way for a process to give it up"
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_PDEATHSIG, _SIGKILL)
    libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    # With a user namespace anybody may; root may without one, where containers forbid it.
    for flags in (_CLONE_NEWUSER | _CLONE_NEWNET | _CLONE_NEWIPC, _CLONE_NEWNET):
        if libc.unshare(flags) == 0:
            left = [name for _, name in socket.if_nameindex() if name != "lo"]
            return f"no network: {left} are still there" if left else ""
    return f"no network: the kernel refuses a network namespace ({os.strerror(ctypes.get_errno())})"


def _serve(content: bytes, source: BinaryIO, sink: BinaryIO) -> None:
    import numpy as np

    from wtg_gym.onnx_session import open_session

    try:
        session = open_session(content)
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
