"""The process in which a policy is played: it gets observations and gives actions, and can do nothing else.

:mod:`wtg_gym.policies.policy_process` runs this file as a script, so it imports nothing of the package. It loads its
libraries, has the kernel take everything else away, and only then reads the policy and hands it to onnxruntime, which
gets a batch of one. Each scenario has a session of its own, so that nothing goes from one to another. The process
never learns which scenario is played, and its answers are all that comes out of it.
"""

import ctypes
import io
import json
import os
import signal
import struct
import sys
from typing import Any, BinaryIO

#: Before a message, which is JSON: its length. Before observations: the number of scenarios.
LENGTH = struct.Struct("<I")
ACTIONS, COMPLAINT = b"\x00", b"\x01"
#: A policy with one observation, its square is the action; it is played once before the kernel locks the process.
_EXAMPLE = bytes.fromhex(
    "08073a680a2a0a0b6f62736572766174696f6e0a0b6f62736572766174696f6e1206616374696f6e22064d61744d756c"
    "1201675a1d0a0b6f62736572766174696f6e120e0a0c080112080a0208010a02080162180a06616374696f6e120e0a0c"
    "080112080a0208010a02080142040a00100d"
)
_PR_SET_PDEATHSIG = 1


def main() -> None:
    """Serve one policy, until stdin ends."""
    wanted = json.loads(sys.argv[1])
    # Ctrl-C reaches every process of a terminal; the one that started this one ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # The prints of a library must not end up among the answers.
    os.dup2(2, 1)
    missing = [_limit(wanted)]
    # The libraries must have opened their files before.
    _Served(_EXAMPLE).answer(1, io.BytesIO(bytes(1 + 4)))
    missing = [text for text in (*missing, lock(source.fileno(), sink.fileno())) if text]
    _send(sink, {"missing": missing})
    if missing and not wanted["weak"]:
        return
    _serve(_read(source, LENGTH.unpack(_read(source, LENGTH.size))[0]), source, sink)


def _serve(content: bytes, source: BinaryIO, sink: BinaryIO) -> None:
    try:
        served = _Served(content)
    # onnxruntime's exceptions share no other base.
    except Exception as error:
        _send(sink, {"error": _text(error)})
        return
    _send(sink, {"widths": served.widths})
    while head := source.read(LENGTH.size):
        try:
            served.answer(LENGTH.unpack(head)[0], source)
        except Exception as error:
            sink.write(COMPLAINT)
            _send(sink, {"error": _text(error)})
            return
        sink.write(ACTIONS)
        for values in served.outputs:
            sink.write(values.tobytes())
        sink.flush()


def _open_session(content: bytes) -> Any:
    """Return onnxruntime's session of an .onnx file's content: one thread, no log, nothing kept between calls."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # Memory comes from the system, which fills it with one byte, see policy_process: no call sees what another left.
    options.enable_cpu_mem_arena = options.enable_mem_pattern = False
    # Never onnxruntime's own format, whatever the file begins with.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


class _Served:
    """A policy's sessions, each scenario with a row of the arrays that they read and write."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        session = _open_session(content)
        inputs, outputs = _widths(session.get_inputs()), _widths(session.get_outputs())
        self.n_states = len(inputs) - 1
        self._inputs = ["observation", *(f"state_{i}" for i in range(self.n_states))]
        self._outputs = ["action", *(f"next_state_{i}" for i in range(self.n_states))]
        states = {f"next_{name}": inputs.get(name) for name in self._inputs[1:]}
        if set(inputs) != set(self._inputs) or outputs != {"action": outputs.get("action"), **states}:
            raise ValueError(
                "it must take observation, state_0, state_1, ... and give action, next_state_0, ... of like widths; "
                f"it takes {inputs} and gives {outputs}"
            )
        #: Of the observation, the action, and every state.
        self.widths = [inputs["observation"], outputs["action"], *(inputs[name] for name in self._inputs[1:])]
        self._input_rows: list[Any] = []
        self.outputs: list[Any] = []
        self._bound: list[Any] = []

    def answer(self, n_scenarios: int, source: BinaryIO) -> None:
        """Read the observations and states of all scenarios, and ask each one's session; `outputs` hold the answers."""
        import numpy as np
        from onnxruntime import set_seed

        if len(self._bound) != n_scenarios:
            observation, action, *states = self.widths
            self._input_rows = [_rows(n_scenarios, width) for width in (observation, *states)]
            self.outputs = [_rows(n_scenarios, width) for width in (action, *states)]
            self._bound = [None] * n_scenarios
        starts = _read(source, n_scenarios)
        for values in self._input_rows:
            values[:] = np.frombuffer(_read(source, values.nbytes), np.float32).reshape(values.shape)
        for values in self.outputs:
            values.fill(np.nan)
        for index, start in enumerate(starts):
            if self._bound[index] is None or start:
                self._bound[index] = self._bind(index)
            run, binding = self._bound[index]
            # All sessions share one generator of random numbers: no scenario sees how many another one drew.
            set_seed(0)
            run(binding, None)

    def _bind(self, index: int) -> tuple[Any, Any]:
        """Return what runs a session on one scenario's rows, and its argument; onnxruntime checks the shapes."""
        import numpy as np
        import onnxruntime

        # A session's own generators begin alike.
        onnxruntime.set_seed(0)
        session = _open_session(self._content)
        binding = session.io_binding()
        for bind, names, arrays in (
            (binding.bind_input, self._inputs, self._input_rows),
            (binding.bind_output, self._outputs, self.outputs),
        ):
            for name, values in zip(names, arrays, strict=True):
                bind(name, "cpu", 0, np.float32, (1, values.shape[1]), values[index].ctypes.data)
        # Two layers of Python less than session.run_with_iobinding(binding), which does the same.
        return session._sess.run_with_iobinding, binding._iobinding


def _rows(n_scenarios: int, width: int) -> Any:
    """Return an array (n_scenarios, width) whose rows all begin at a multiple of 64 bytes.

    The last bits of a sum depend on where its values begin: a policy could tell the scenarios by it.
    """
    import numpy as np

    n_values = -(-width // 16) * 16
    memory = np.zeros(16 + n_scenarios * n_values, np.float32)
    first = -memory.ctypes.data % 64 // 4
    return memory[first : first + n_scenarios * n_values].reshape(n_scenarios, n_values)[:, :width]


def _widths(values: Any) -> dict[str, int]:
    """Return the width of every input or output; a ValueError where one is not float32 of shape (batch, width)."""
    for value in values:
        shape = value.shape
        fits = len(shape) == 2 and (shape[0] == 1 or not isinstance(shape[0], int)) and isinstance(shape[1], int)
        if value.type != "tensor(float)" or not fits:
            raise ValueError(
                f"{value.name} must be float32 of shape (batch, n) with any batch or one of 1, "
                f"got {value.type} of shape {shape}"
            )
    return {value.name: int(value.shape[1]) for value in values}


def _text(error: Exception) -> str:
    return ascii(f"{type(error).__name__}: {error}"[:400])[1:-1]


def _send(sink: BinaryIO, message: dict[str, Any]) -> None:
    data = json.dumps(message).encode()
    sink.write(LENGTH.pack(len(data)) + data)
    sink.flush()


def _read(source: BinaryIO, size: int) -> bytes:
    data = source.read(size)
    if len(data) < size:
        sys.exit(0)
    return data


def _limit(wanted: dict[str, Any]) -> str:
    """Limit memory and time, and end with the parent process; return the limits that this system does not enforce."""
    if sys.platform != "linux":
        return f"limits of memory and time: {sys.platform} does not enforce them"
    import resource

    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
    memory, cpu_s = wanted["memory_bytes"], wanted["cpu_s"]
    # The soft limit of time ends the process with a signal that says so.
    for name, soft, hard in (("AS", memory, memory), ("CPU", cpu_s, cpu_s + 5), ("CORE", 0, 0)):
        try:
            resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (soft, hard))
        except (OSError, ValueError) as error:
            return f"limits of memory and time: RLIMIT_{name} {error}"
    return ""


#: How the kernel calls a kind of processor, and the number of `seccomp` there.
_MACHINES = {"x86_64": (0xC000_003E, 317), "aarch64": (0xC000_00B7, 277)}
#: What is allowed, with its number on each.
_ALLOWED = (
    "brk 12 214, clock_gettime 228 113, clock_nanosleep 230 115, exit 60 93, exit_group 231 94, futex 202 98, "
    "getpid 39 172, getrandom 318 278, madvise 28 233, mprotect 10 226, mremap 25 216, munmap 11 215, "
    "restart_syscall 219 128, rt_sigaction 13 134, rt_sigprocmask 14 135, rt_sigreturn 15 139, "
    "sched_getaffinity 204 123, sched_yield 24 124"
)
_READ, _WRITE, _MMAP = (0, 63), (1, 64), (9, 222)
_MAP_ANONYMOUS = 0x20
#: An instruction of classic BPF, code, lines to skip if true, if false, and value; and a program, their number and
#: address.
_INSTRUCTION, _PROGRAM = struct.Struct("=HBBI"), struct.Struct("HP")
#: Codes: load a word of the call's description, compare it, test its bits, return a verdict.
_LOAD, _EQUAL, _ANY_BIT, _RETURN = 0x20, 0x15, 0x45, 0x06
#: Where the call's number, the kind of processor, and the lower halves of its first and fourth argument stand.
_NUMBER, _MACHINE, _FIRST, _FOURTH = 0, 4, 16, 40
_ALLOW, _REFUSE, _KILL = 0x7FFF_0000, 0x0005_0000 | 1, 0x8000_0000
_SET_MODE_FILTER, _ALL_THREADS = 1, 1
#: Leaves the processor's speculation on, which a filter turns off by default; a policy then takes 1.6 times as long.
#: All that speculation could show to a policy is the memory of its own process.
_SPECULATION = 4
_PR_SET_NO_NEW_PRIVS = 38


def lock(source: int, sink: int) -> str:
    """Take from this process all but computing, reading `source` and writing `sink`; return what is not enforced."""
    machine = os.uname().machine if sys.platform == "linux" else sys.platform
    if machine not in _MACHINES or sys.maxsize < 2**32:
        return f"no filter of system calls: there is none for {machine}"
    column = list(_MACHINES).index(machine)
    machine_id, seccomp = _MACHINES[machine]
    lines = [_INSTRUCTION.pack(*line) for line in _filter(machine_id, column, source, sink)]
    instructions = ctypes.create_string_buffer(b"".join(lines))
    program = _PROGRAM.pack(len(lines), ctypes.addressof(instructions))
    libc = ctypes.CDLL(None, use_errno=True)
    # Without it only root may set a filter; no program can give the process more rights any more.
    libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    flags = _ALL_THREADS | _SPECULATION
    if libc.syscall(seccomp, _SET_MODE_FILTER, flags, program) != 0:
        return f"no filter of system calls: the kernel refuses it ({os.strerror(ctypes.get_errno())})"
    return ""


def _filter(machine_id: int, column: int, source: int, sink: int) -> list[tuple[int, int, int, int]]:
    """Return the filter as the values of :data:`_INSTRUCTION`."""
    lines = [(_LOAD, 0, 0, _MACHINE), (_EQUAL, 1, 0, machine_id), (_RETURN, 0, 0, _KILL), (_LOAD, 0, 0, _NUMBER)]
    # Memory only, never a file seen as memory.
    for numbers, argument, test, value in (
        (_READ, _FIRST, _EQUAL, source),
        (_WRITE, _FIRST, _EQUAL, sink),
        (_MMAP, _FOURTH, _ANY_BIT, _MAP_ANONYMOUS),
    ):
        lines += [(_EQUAL, 0, 4, numbers[column]), (_LOAD, 0, 0, argument), (test, 0, 1, value)]
        lines += [(_RETURN, 0, 0, _ALLOW), (_RETURN, 0, 0, _REFUSE)]
    for call in _ALLOWED.split(", "):
        lines += [(_EQUAL, 0, 1, int(call.split()[1 + column])), (_RETURN, 0, 0, _ALLOW)]
    return [*lines, (_RETURN, 0, 0, _REFUSE)]


if __name__ == "__main__":
    main()
