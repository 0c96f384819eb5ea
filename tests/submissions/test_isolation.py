"""The process that plays a policy can do nothing but answer, and ends in time whatever it does."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.submissions.models import M, N, after, make_bytes, node
from tests.submissions.models import model as make
from wtg_gym.evaluation import OnnxPolicy
from wtg_gym.submissions import isolation, limits
from wtg_gym.submissions.isolation import IsolatedPolicy, NotIsolatedError, SubmissionError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="isolation is complete on Linux only")
ROOT = Path(__file__).resolve().parents[2]
ONES = np.ones((3, N), dtype=np.float32)


def pid_of(policy: IsolatedPolicy) -> int:
    return policy._process.pid


def gone(pid: int) -> bool:
    """Whether a process has ended, within ten seconds."""
    for _ in range(100):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return True
        if state == "Z":
            return True
        time.sleep(0.1)
    return False


def test_answers_are_those_of_onnxruntime_here(tmp_path: Path) -> None:
    (tmp_path / "a.onnx").write_bytes(make_bytes())
    observations = np.random.default_rng(0).uniform(-5, 5, (50, N)).astype(np.float32)
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        given, state = policy.predict(observations, None, np.ones(50, bool), deterministic=True)
    expected, _ = OnnxPolicy(tmp_path / "a.onnx").predict(observations)
    assert np.array_equal(given, expected) and given.dtype == np.float32 and state is None


def test_process_has_bounds_few_rights_and_an_empty_environment() -> None:
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        pid = pid_of(policy)
        assert policy.missing == []
        told = Path(f"/proc/{pid}/limits").read_text()
        for name, value in (
            ("Max address space", limits.MEMORY_BYTES),
            ("Max cpu time", limits.CPU_S),
            ("Max core file size", 0),
        ):
            line = next(line for line in told.splitlines() if line.startswith(name))
            assert line[len(name) :].split()[:2] == [str(value)] * 2
        status = Path(f"/proc/{pid}/status").read_text()
        assert "NoNewPrivs:\t1" in status and "Seccomp:\t2" in status and "Threads:\t1" in status
        names = {item.split(b"=")[0] for item in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0") if item}
        assert names == {b"OPENBLAS_NUM_THREADS", b"OMP_NUM_THREADS"}
        assert os.readlink(f"/proc/{pid}/cwd") == "/"
        opened = {os.readlink(path) for path in Path(f"/proc/{pid}/fd").iterdir()}
        assert all(target == "/dev/null" or target.startswith("pipe:") for target in opened)
    assert gone(pid)


def test_refused_file_is_not_loaded() -> None:
    with IsolatedPolicy(after(node("Loop", ["linear"], "action")).SerializeToString(), N, M) as policy:
        assert policy.checks[-1][:2] == ("operators", False)
        with pytest.raises(SubmissionError, match="the file is refused"):
            policy.predict(ONES)
        assert gone(pid_of(policy))


def test_process_that_stops_answering_is_killed_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        monkeypatch.setattr(limits, "CALL_S", 0.5)
        os.kill(pid_of(policy), signal.SIGSTOP)
        with pytest.raises(SubmissionError, match=r"0\.5 s for a step"):
            policy.predict(ONES)
        assert gone(pid_of(policy))


def test_process_that_dies_is_named() -> None:
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        os.kill(pid_of(policy), signal.SIGSEGV)
        with pytest.raises(SubmissionError, match="ended with signal 11"):
            policy.predict(ONES)
        with pytest.raises(SubmissionError, match="not loaded"):
            policy.predict(ONES)


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MEMORY_BYTES", 2**30)
    start = "data = bytearray(3 * 2**30)"
    monkeypatch.setattr(isolation, "_START", _patched(f"worker._serve = lambda *given: exec({start!r})"))
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        assert "its process ended with exit code 1" in policy.error


def test_process_ends_with_the_one_that_started_it(tmp_path: Path) -> None:
    program = (
        "import sys, time; from tests.submissions.models import *; "
        "from wtg_gym.submissions.isolation import IsolatedPolicy; "
        "policy = IsolatedPolicy(make_bytes(), N, M); print(policy._process.pid, flush=True); time.sleep(60)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert gone(pid)
    # Nothing of it is left behind.
    assert not list(tmp_path.iterdir())


def _patched(code: str) -> str:
    """A start of the process in which code runs before it begins."""
    return (
        "import sys; sys.path.insert(0, sys.argv.pop(1)); from wtg_gym.submissions import worker; "
        f"exec({code!r}); worker.main()"
    )


def test_kernel_without_a_filter_needs_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    code = "worker.lock = lambda source, sink: 'no filter: the kernel refuses'"
    monkeypatch.setattr(isolation, "_START", _patched(code))
    with pytest.raises(NotIsolatedError, match=r"cannot isolate .*the kernel refuses\. --weak-isolation plays it"):
        IsolatedPolicy(make_bytes(), N, M)
    with IsolatedPolicy(make_bytes(), N, M, weak=True) as policy:
        assert policy.missing == ["no filter: the kernel refuses"]
        assert policy.predict(ONES)[0].shape == (3, M)


#: What code in the place of onnxruntime would try; `trace` is a folder of the test's, `parent` its process, `file` a
#: file that is open. None does harm where the kernel would let it.
ACTS = {
    "read a file": "open('/etc/passwd').read()",
    "read a file by its number": "os.read(9, 1)",
    "list a folder": "os.listdir(trace)",
    "look for a file": "os.stat('/etc/passwd')",
    "read another process": "os.open(f'/proc/{parent}/mem', os.O_RDONLY)",
    "write its own memory": "os.open('/proc/self/mem', os.O_RDWR)",
    "make a file": "open(trace + '/made', 'w')",
    "write to a file that is open": "os.write(file, b'x')",
    "write to a file as memory": "libc.mmap(None, 4096, 3, 1, file, 0)",
    "empty a file": "os.truncate(trace + '/kept', 0)",
    "remove a file": "os.unlink(trace + '/kept')",
    "rename a file": "os.rename(trace + '/kept', trace + '/moved')",
    "link to a file": "os.link(trace + '/kept', trace + '/linked')",
    "make a link": "os.symlink('/etc/passwd', trace + '/link')",
    "make a folder": "os.mkdir(trace + '/folder')",
    "make a pipe": "os.mkfifo(trace + '/pipe')",
    "change a file's rights": "os.chmod(trace + '/kept', 0o777)",
    "change a file's owner": "os.chown(trace + '/kept', 1, 1)",
    "change a file's time": "os.utime(trace + '/kept')",
    "go elsewhere": "os.chdir('/tmp')",
    "mount": "libc.mount(b'none', trace.encode(), b'no file system', 0, None)",
    "make a file in memory": "os.memfd_create('x')",
    "reach the network": "socket.socket(socket.AF_INET, socket.SOCK_STREAM)",
    "reach the network by datagrams": "socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)",
    "reach a local socket": "socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)",
    "talk to itself by a socket": "socket.socketpair()",
    "ask the kernel by a socket": "socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)",
    "duplicate what is open": "os.dup(0)",
    "start a process": "os.fork() or os._exit(0)",
    "start a program": "os.execv('/bin/none', ['none'])",
    "spawn a program": "os.posix_spawn('/bin/none', ['none'], {})",
    "end another process": "os.kill(parent, 0)",
    "signal its group": "os.killpg(0, 0)",
    "trace another process": "libc.ptrace(1, parent, None, None)",
    "read another process's memory": "libc.process_vm_readv(parent, None, 0, None, 0, 0)",
    "raise its limits": "libc.prlimit(0, 0, None, None)",
    "outlive its parent": "libc.prctl(1, 0)",
    "become another user": "os.setuid(0)",
    "leave its namespaces": "libc.unshare(0x10000000)",
    "queue calls past the filter": "libc.syscall(425, 1, None)",
    "call as on other machines": "libc.syscall(0x40000000 + 2, b'/etc/passwd', 0)",
}


def test_process_can_do_nothing_but_compute_and_answer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The kernel refuses each act with EPERM, from within the process, after it has read the policy."""
    (tmp_path / "kept").write_text("content")
    code = f"""
import ctypes, os, socket
libc, trace, parent = ctypes.CDLL(None, use_errno=True), {str(tmp_path)!r}, {os.getpid()}
libc.mmap.restype, file = ctypes.c_ssize_t, os.open(trace + '/kept', os.O_RDWR)
def serve(content, source, sink):
    found = {{}}
    for act in {list(ACTS.values())!r}:
        try:
            found[act] = ctypes.get_errno() if eval(act) == -1 else 0
        except OSError as error:
            found[act] = error.errno
    worker._send(sink, {{'states': [], 'found': found}})
worker._serve = serve"""
    monkeypatch.setattr(isolation, "_START", _patched(code))
    heard: list[dict[str, Any]] = []
    hear = IsolatedPolicy._message
    monkeypatch.setattr(IsolatedPolicy, "_message", lambda policy: heard.append(hear(policy)) or heard[-1])
    with IsolatedPolicy(make_bytes(), N, M):
        pass
    assert {act: heard[-1]["found"][code] for act, code in ACTS.items()} == dict.fromkeys(ACTS, errno.EPERM)
    assert [path.name for path in tmp_path.iterdir()] == ["kept"] and (tmp_path / "kept").read_text() == "content"


def test_process_starts_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    code = (
        "import threading\n"
        "def serve(content, source, sink):\n"
        "    try:\n"
        "        threading.Thread(target=print).start()\n"
        "    except RuntimeError as error:\n"
        "        worker._send(sink, {'error': str(error)})\n"
        "worker._serve = serve"
    )
    monkeypatch.setattr(isolation, "_START", _patched(code))
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        assert policy.error == "can't start new thread"


def test_time_counts_only_while_the_policy_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        now = time.monotonic
        monkeypatch.setattr(time, "monotonic", lambda: now() + 2 * limits.TOTAL_S)
        assert policy.predict(ONES)[0].shape == (3, M)
        monkeypatch.setattr(limits, "TOTAL_S", policy._waited_s)
        os.kill(pid_of(policy), signal.SIGSTOP)
        with pytest.raises(SubmissionError, match=r"s in all"):
            policy.predict(ONES)


@pytest.mark.parametrize(
    "attack",
    [
        "sink.write(b'\\xff\\xff\\xff\\xff'); sink.flush()",
        "worker._send(sink, {'states': [10**12]})",
        "worker._send(sink, {'states': [-1]})",
        "worker._send(sink, {'states': [100_000] * 3})",
        "worker._send(sink, {'states': 'x'})",
        "worker._send(sink, [1])",
        "sink.write(b'\\x04\\x00\\x00\\x00nope'); sink.flush()",
        "sink.write(b'\\x00\\x40\\x00\\x00' + b'[' * 16384); sink.flush()",
        "import os; os.kill(os.getpid(), 9)",
        "raise SystemExit(0)",
        "worker._send(sink, {'states': []}); sink.write(b'\\x01\\x00'); sink.flush()",
        "worker._send(sink, {'states': []}); sink.write(b'\\x00abc'); sink.flush()",
    ],
)
def test_lies_of_the_process_are_errors(attack: str, monkeypatch: pytest.MonkeyPatch) -> None:
    code = f"def serve(content, source, sink):\n    {attack}\nworker._serve = serve"
    monkeypatch.setattr(isolation, "_START", _patched(code))
    with pytest.raises(SubmissionError), IsolatedPolicy(make_bytes(), N, M) as policy:
        policy.predict(ONES)


def test_what_the_process_says_is_no_command(monkeypatch: pytest.MonkeyPatch) -> None:
    says = "worker._send(sink, {'error': 'a\\x1b[2J\\n```\\nb'})"
    code = f"def serve(content, source, sink):\n    {says}\nworker._serve = serve"
    monkeypatch.setattr(isolation, "_START", _patched(code))
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        assert policy.error == "a?[2J?????b"


def test_policy_of_any_graph_gives_the_shape_it_said() -> None:
    with IsolatedPolicy(make().SerializeToString(), N, M) as policy:
        for n_lanes in (1, 7, 256):
            assert policy.predict(np.zeros((n_lanes, N)))[0].shape == (n_lanes, M)
        with pytest.raises(SubmissionError, match=r"observations must be \(lanes, 20\)"):
            policy.predict(np.zeros((3, 18)))
