"""The process that plays a policy can do nothing but answer, and ends in time whatever it does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

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


def test_process_has_no_network_few_rights_and_an_empty_environment() -> None:
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        pid = pid_of(policy)
        assert policy.missing == []
        assert os.readlink(f"/proc/{pid}/ns/net") != os.readlink("/proc/self/ns/net")
        network = Path(f"/proc/{pid}/net/dev").read_text().splitlines()[2:]
        assert [line.split(":")[0].strip() for line in network] in (["lo"], [])
        told = Path(f"/proc/{pid}/limits").read_text()
        for name, value in (
            ("Max address space", limits.MEMORY_BYTES),
            ("Max cpu time", limits.CPU_S),
            ("Max file size", 0),
            ("Max open files", limits.OPEN_FILES),
        ):
            line = next(line for line in told.splitlines() if line.startswith(name))
            assert line[len(name) :].split()[:2] == [str(value)] * 2
        assert "NoNewPrivs:\t1" in Path(f"/proc/{pid}/status").read_text()
        names = {item.split(b"=")[0] for item in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0") if item}
        assert names == {b"OPENBLAS_NUM_THREADS", b"OMP_NUM_THREADS"}
        folder = Path(os.readlink(f"/proc/{pid}/cwd"))
        assert folder.name.startswith("wtg-gym-") and list(folder.iterdir()) == []
    assert gone(pid) and not folder.exists()


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
        with pytest.raises(SubmissionError, match=r"longer than 0\.5 s"):
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


def _patched(code: str) -> str:
    """A start of the process in which code runs before it begins."""
    return (
        "import sys; sys.path.insert(0, sys.argv.pop(1)); from wtg_gym.submissions import worker; "
        f"exec({code!r}); worker.main()"
    )


def test_kernel_that_keeps_the_network_needs_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    code = "worker._cut_network = lambda: 'no network: the kernel refuses'"
    monkeypatch.setattr(isolation, "_START", _patched(code))
    with pytest.raises(NotIsolatedError, match=r"cannot isolate .*the kernel refuses\. --weak-isolation plays it"):
        IsolatedPolicy(make_bytes(), N, M)
    with IsolatedPolicy(make_bytes(), N, M, weak=True) as policy:
        assert policy.missing == ["no network: the kernel refuses"]
        assert policy.predict(ONES)[0].shape == (3, M)


@pytest.mark.parametrize("where", ["its own folder", "elsewhere"])
def test_nothing_can_be_written(where: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    attempt = f"open({'here' if where == 'its own folder' else str(trace)!r}, 'w').write('x')"
    monkeypatch.setattr(isolation, "_START", _patched(f"worker._serve = lambda *given: exec({attempt!r})"))
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        assert "its process ended" in policy.error
    assert not trace.exists() or trace.stat().st_size == 0


def test_nothing_can_be_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    code = (
        "import socket\n"
        "def serve(content, source, sink):\n"
        "    try:\n"
        "        socket.create_connection(('127.0.0.1', 1), 5)\n"
        "    except OSError as error:\n"
        "        worker._send(sink, {'error': f'errno {error.errno}'})\n"
        "worker._serve = serve"
    )
    monkeypatch.setattr(isolation, "_START", _patched(code))
    with IsolatedPolicy(make_bytes(), N, M) as policy:
        # Unreachable, not refused: there is no interface to ask on.
        assert policy.error == "errno 101"


@pytest.mark.parametrize(
    "attack",
    [
        "sink.write(b'\\xff\\xff\\xff\\xff'); sink.flush()",
        "worker._send(sink, {'states': [10**12]})",
        "worker._send(sink, {'states': [-1]})",
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


def test_policy_of_any_graph_gives_the_shape_it_said() -> None:
    with IsolatedPolicy(make().SerializeToString(), N, M) as policy:
        for n_lanes in (1, 7, 256):
            assert policy.predict(np.zeros((n_lanes, N)))[0].shape == (n_lanes, M)
        with pytest.raises(SubmissionError, match=r"observations must be \(lanes, 20\)"):
            policy.predict(np.zeros((3, 18)))
