"""The process that plays a policy can do nothing but answer, and ends in time whatever it does."""

import errno
import gc
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from onnx import helper

from tests.submissions.models import WEIGHTS, M, N, after, constant, hidden, make_bytes, model, nodes_of, worker
from wtg_gym.evaluation import Entry, OnnxPolicy, PolicyError, evaluate
from wtg_gym.policies import locked_worker, policy_process
from wtg_gym.policies.locked_worker import row_by_row
from wtg_gym.policies.policy_process import NotIsolatedError, PolicyProcess

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="isolation is complete on Linux only")
ROOT = Path(__file__).resolve().parents[2]
ONES = np.ones((3, N), dtype=np.float32)
LIES = [
    "sink.write(b'\\xff\\xff\\xff\\xff'); sink.flush()",
    "worker._send(sink, {'widths': [20, 10**12]})",
    "worker._send(sink, {'widths': [20, True]})",
    "worker._send(sink, {'widths': [20, 4] + [1] * 17})",
    "worker._send(sink, {'widths': 'x'})",
    "sink.write(b'\\x04\\x00\\x00\\x00nope'); sink.flush()",
    "sink.write(b'\\x00\\x40\\x00\\x00' + b'[' * 16384); sink.flush()",
    "import os; os.kill(os.getpid(), 9)",
    "raise SystemExit(0)",
    "worker._send(sink, {'widths': [20, 4]}); sink.write(b'\\x01\\x00'); sink.flush()",
    "worker._send(sink, {'widths': [20, 4]}); sink.write(b'\\x00abc'); sink.flush()",
]
BOUNDS = [
    ("MEMORY_BYTES", 2**30, "bytearray(3 * 2**30)", "the policy's process ended with exit code 1"),
    ("CPU_S", 3, "while True: pass", r"ended with SIGXCPU: more than .* s of processor time"),
]
UNLOCKED = "worker.lock = lambda source, sink: 'no filter: the kernel refuses'"
FAILED_START = ("sys.exit(1)", "cannot start the process of a policy: .* ended with exit code 1")
WEAK = [(UNLOCKED, "cannot isolate .*the kernel refuses"), FAILED_START]
COMMAND = ("worker._send(sink, {'error': 'a\\x1b[2J\\n```\\nb'})", r"cannot load the policy: a\\x1b\[2J\\n'''\\nb$")


def opened(content: bytes | None = None) -> OnnxPolicy:
    return OnnxPolicy(make_bytes() if content is None else content, isolated=True)


def pid_of(policy: OnnxPolicy) -> int:
    assert policy.widths
    return policy._processes[0]._process.pid


def gone(pid: int) -> bool:
    for _ in range(100):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return True
        if state == "Z":
            return True
        time.sleep(0.1)
    return False


@pytest.mark.parametrize("name", ["sac-k+tau-0", "dagger-v1-0", "evolution-v1-0"])
def test_answers_are_those_of_onnxruntime_for_one_scenario_whatever_is_beside_it(name):
    import onnxruntime

    content = (ROOT / "agents/policies" / name / "policy.onnx").read_bytes()
    assert locked_worker._Served(content)._shared is not None
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    with opened(content) as policy:
        rng, (n_observation, _, *widths) = np.random.default_rng(0), policy.widths
        observations = rng.uniform(-5, 5, (50, n_observation)).astype(np.float32)
        states = tuple(rng.uniform(-1, 1, (50, width)).astype(np.float32) for width in widths)
        answers, following = policy.predict(observations, states, np.zeros(50, bool), deterministic=True)
        order = rng.permutation(50)[:37]
        reordered, others = policy.predict(observations[order], tuple(state[order] for state in states))
    assert answers.dtype == np.float32 and np.array_equal(answers[order], reordered)
    assert (following is None) == (not widths)
    assert all(np.array_equal(a[order], b) for a, b in zip(following or (), others or (), strict=True))
    for row in range(50):
        values = {f"state_{index}": state[row : row + 1] for index, state in enumerate(states)}
        values["observation"] = observations[row : row + 1]
        assert session.run(["action"], values)[0][0] == pytest.approx(answers[row], abs=1e-6)


AXES = {"zero": [0], "one": [1], "none": np.array([], np.int64)}
LSTM = "; y, h, c = LSTM<hidden_size = 20>(s, W, R); x = Squeeze(h, zero)"
WEIGHTS_OF_LSTM = {**AXES, "W": np.ones((1, 4 * N, N)), "R": np.ones((1, 4 * N, N))}
#: From the observation to what is multiplied by `weights`, and constants besides.
TREATS_APART = {
    "columns": ("x = Gather<axis = 1>(observation, back)", {"back": np.arange(N)[::-1]}),
    "parts": ("a, b = Split<axis = 1>(observation); x = Concat<axis = -1>(b, a)", {}),
    "selection": ("x = Slice(observation, low, high, one)", {"low": [0], "high": [N], "one": [1]}),
    "arithmetic": ("a = Sub(observation, mean); b = Div(a, two); x = Tanh(b)", {"mean": np.ones((1, N)), "two": 2.0}),
    "LSTM": ("s = Unsqueeze(observation, zero)" + LSTM, WEIGHTS_OF_LSTM),
}
BACK = "g = Abs(observation); r = Slice(g, low, high, axis, low); x = Add(observation, r)"
PLACES = {"places": np.arange(16.0 * N).reshape(16, N)}
MIXES = {
    "reversed": (BACK, {"low": [-1], "high": [-(2**40)], "axis": [0]}),
    "gathered": ("x = Gather<axis = 0>(observation, back)", {"back": np.arange(16)[::-1]}),
    "softmax": ("x = Softmax<axis = 0>(observation)", {}),
    "products": ("t = Transpose(observation); p = MatMul(observation, t); x = MatMul(p, observation)", {}),
    "pairs": ("a = Unsqueeze(observation, zero); b = Unsqueeze(observation, one); x = Sub(a, b)", AXES),
    "stacked": ("x = Concat<axis = 0>(observation, observation)", {}),
    "numbers of places": ("x = Add(observation, places)", PLACES),
    "biases of places": ("x = Gemm(observation, square, places)", {"square": np.eye(N), **PLACES}),
    "sequence": ("s = Unsqueeze(observation, one)" + LSTM, WEIGHTS_OF_LSTM),
    "no sequence": ("u = Unsqueeze(observation, zero); s = Slice(u, zero, zero, zero)" + LSTM, WEIGHTS_OF_LSTM),
    "lengths": (
        "s = Unsqueeze(observation, zero); y, h, c = LSTM<hidden_size = 20>(s, W, R, , n); x = Squeeze(h, zero)",
        {"n": np.arange(16, dtype=np.int32), **WEIGHTS_OF_LSTM},
    ),
    "random": ("r = RandomNormal<shape = [1, 20]>(); x = Add(observation, r)", {}),
    "number of rows": ("n = Shape(observation); f = Cast<to = 1>(n); s = ReduceMax(f); x = Mul(observation, s)", {}),
    # Readers differ in what these mean.
    "a name twice": ("x = Tanh(observation); x = Tanh(x)", {}),
    "a name before its definition": ("x = Add(observation, r); r = Abs(observation)", {}),
    "no axes": ("u = Unsqueeze(observation, one); v = Squeeze(u, none); x = Squeeze(v, one)", AXES),
}


@pytest.mark.parametrize("name", [*TREATS_APART, *MIXES])
def test_rows_share_a_call_only_where_no_node_mixes_them(name):
    text, constants = (TREATS_APART | MIXES)[name]
    nodes = nodes_of(f"{text}; action = MatMul(x, weights)")
    content = model(nodes, constants=[WEIGHTS, *(constant(key, value) for key, value in constants.items())])
    assert (row_by_row(content.SerializeToString()) is not None) == (name in TREATS_APART)


def test_what_only_another_reader_sees_is_not_run_for_many_rows():
    assert row_by_row(make_bytes()) is not None
    visible, content = make_bytes(), model(nodes_of("axis = Constant<value_ints = [1]>(); action = Clip(observation)"))
    content.graph.node[0].attribute[0].name = "value"
    content.graph.node[0].attribute[0].t.CopyFrom(constant("", [0]))
    assert row_by_row(content.SerializeToString()) is None
    for imports in ([("", 17), ("ai.onnx", 13)], [("", 10)]):
        content = model()
        del content.opset_import[:]
        content.opset_import.extend(helper.make_opsetid(*each) for each in imports)
        assert row_by_row(content.SerializeToString()) is None
    assert row_by_row(visible + hidden(after("action = Tanh(linear)"))) in (None, row_by_row(visible))


def test_process_has_bounds_few_rights_and_none_of_our_environment():
    with opened() as policy:
        pid = pid_of(policy)
        assert policy.not_isolated == ()
        told = Path(f"/proc/{pid}/limits").read_text()
        for name, soft, hard in (
            ("Max address space", policy_process.MEMORY_BYTES, policy_process.MEMORY_BYTES),
            ("Max cpu time", policy_process.CPU_S, policy_process.CPU_S + 5),
            ("Max core file size", 0, 0),
        ):
            line = next(line for line in told.splitlines() if line.startswith(name))
            assert line[len(name) :].split()[:2] == [str(soft), str(hard)]
        status = Path(f"/proc/{pid}/status").read_text()
        assert "NoNewPrivs:\t1" in status and "Seccomp:\t2" in status and "Threads:\t1" in status
        names = {item.split(b"=")[0] for item in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0") if item}
        # The C library cuts its own variable where it reads it.
        names -= {b"glibc.malloc.perturb"}
        assert names == {b"OPENBLAS_NUM_THREADS", b"OMP_NUM_THREADS", b"ORT_DISABLE_TELEMETRY", b"GLIBC_TUNABLES"}
        assert os.readlink(f"/proc/{pid}/cwd") == "/"
        opened_files = {os.readlink(path) for path in Path(f"/proc/{pid}/fd").iterdir()}
        assert all(target == "/dev/null" or target.startswith("pipe:") for target in opened_files)
    assert gone(pid)


def test_every_batch_has_a_process_of_its_own():
    policy = opened()
    with policy:
        first = pid_of(policy)
        assert policy.predict(ONES)[0].shape == (3, M)
    assert gone(first)
    # Without `with`, it runs until the last reference to it is gone.
    second = pid_of(policy)
    policy.predict(ONES)
    assert second == pid_of(policy) != first
    del policy
    gc.collect()
    assert gone(second)


def test_process_that_stops_answering_is_killed_in_time(monkeypatch):
    for limit, message in (("STEP_S", r"took longer than .* 0\.5 s for a step"), ("TOTAL_S", r"s in all")):
        with opened() as policy:
            pid, now = pid_of(policy), time.monotonic
            with monkeypatch.context() as patch:
                # Time counts only while the policy is waited for.
                patch.setattr(time, "monotonic", lambda now=now: now() + 2 * policy_process.TOTAL_S)
                assert policy.predict(ONES)[0].shape == (3, M)
                patch.setattr(policy_process, limit, 0.5)
                os.kill(pid, signal.SIGSTOP)
                with pytest.raises(PolicyError, match=message):
                    policy.predict(ONES)
            assert gone(pid)


def test_process_outlives_an_interruption_and_one_that_dies_is_named_and_followed_by_another():
    with opened() as policy:
        os.kill(pid_of(policy), signal.SIGINT)
        assert policy.predict(ONES)[0].shape == (3, M)
        os.kill(pid_of(policy), signal.SIGSEGV)
        with pytest.raises(PolicyError, match="ended with SIGSEGV: a fault, or more than 4096 MiB of memory"):
            policy.predict(ONES)
        assert policy.predict(ONES)[0].shape == (3, M)


def test_process_ends_with_the_one_that_started_it(tmp_path):
    program = (
        "import sys, time; from tests.evaluation.test_policy_process import *; "
        "policy = opened(); print(pid_of(policy), flush=True); time.sleep(60)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment)
    pid = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert gone(pid)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def instead(monkeypatch, tmp_path_factory):
    """Run code in the process before it begins; it may put something in the place of the functions of `worker`."""

    def patch(code: str) -> None:
        script = tmp_path_factory.mktemp("script") / "script.py"
        monkeypatch.setattr(policy_process, "_SCRIPT", worker(script, code))

    return patch


@pytest.mark.parametrize(("limit", "value", "code", "said"), BOUNDS)
def test_memory_and_processor_time_are_bounded(limit, value, code, said, monkeypatch, instead):
    monkeypatch.setattr(policy_process, limit, value)
    instead(f"def serve(*given):\n    {code}\nworker._serve = serve")
    with pytest.raises(PolicyError, match=said):
        opened().predict(ONES)


def test_kernel_without_a_filter_is_a_warning_where_that_is_allowed(instead):
    instead(UNLOCKED)
    weak = OnnxPolicy(make_bytes())
    with pytest.warns(UserWarning, match="policies are not isolated on this system: no filter"), weak:
        assert weak.not_isolated == ("no filter: the kernel refuses",)
        assert weak.predict(ONES)[0].shape == (3, M)


@pytest.mark.parametrize(("code", "said"), WEAK)
def test_system_that_cannot_isolate_is_no_failure_of_an_entry(code, said, instead):
    instead(code)
    arguments = {"seeds": [20_000], "duration_s": 1.0, "keep_going": True}
    with pytest.raises(NotIsolatedError, match=said):
        evaluate([Entry(name="a", policy=opened())], "standard", "test", **arguments)


#: Attacks by code that stands in for onnxruntime; `trace` is a folder of the test, `parent` its process, `file` an open
#: file. None does harm where the kernel would let it.
ACTS = {
    "read a file": "open('/etc/passwd').read()",
    "read a file by its number": "os.read(9, 1)",
    "list a folder": "os.listdir(trace)",
    "look for a file": "os.stat('/etc/passwd')",
    "read another process": "os.open(f'/proc/{parent}/mem', os.O_RDONLY)",
    "write its own memory": "os.open('/proc/self/mem', os.O_RDWR)",
    "make a file": "open(trace + '/made', 'w')",
    "write to a file that is open": "os.write(file, b'x')",
    "empty a file": "os.truncate(trace + '/kept', 0)",
    "remove a file": "os.unlink(trace + '/kept')",
    "make a link": "os.symlink('/etc/passwd', trace + '/link')",
    "make a folder": "os.mkdir(trace + '/folder')",
    "change a file's rights": "os.chmod(trace + '/kept', 0o777)",
    "go elsewhere": "os.chdir('/tmp')",
    "mount": "libc.mount(b'none', trace.encode(), b'no file system', 0, None)",
    "make a file in memory": "os.memfd_create('x')",
    "reach the network": "socket.socket(socket.AF_INET, socket.SOCK_STREAM)",
    "reach a local socket": "socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)",
    "ask the kernel by a socket": "socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)",
    "duplicate what is open": "os.dup(0)",
    "start a process": "os.fork() or os._exit(0)",
    "start a program": "os.execv('/bin/none', ['none'])",
    "end another process": "os.kill(parent, 0)",
    "trace another process": "libc.ptrace(1, parent, None, None)",
    "read another process's memory": "libc.process_vm_readv(parent, None, 0, None, 0, 0)",
    "raise its limits": "libc.prlimit(0, 0, None, None)",
    "outlive its parent": "libc.prctl(1, 0)",
    "become another user": "os.setuid(0)",
    "leave its namespaces": "libc.unshare(0x10000000)",
    "queue calls past the filter": "libc.syscall(425, 1, None)",
    "call as on other machines": "libc.syscall(0x40000000 + 2, b'/etc/passwd', 0)",
}


def test_process_can_do_nothing_but_compute_and_answer(instead, tmp_path):
    """The kernel refuses each act with EPERM, from within the process, after it has read the policy."""
    (tmp_path / "kept").write_text("content")
    instead(f"""
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
    worker._send(sink, {{'widths': [1, 1], 'found': found}})
worker._serve = serve""")
    heard = []
    hear = PolicyProcess._message
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PolicyProcess, "_message", lambda process: heard.append(hear(process)) or heard[-1])
        with opened() as policy:
            assert policy.widths == (1, 1)
    assert {act: heard[-1]["found"][code] for act, code in ACTS.items()} == dict.fromkeys(ACTS, errno.EPERM)
    assert [path.name for path in tmp_path.iterdir()] == ["kept"] and (tmp_path / "kept").read_text() == "content"


@pytest.mark.parametrize(("attack", "said"), [*((lie, None) for lie in LIES), COMMAND])
def test_lies_of_the_process_are_errors_and_what_it_says_is_no_command(attack, said, instead):
    instead(f"def serve(content, source, sink):\n    {attack}\nworker._serve = serve")
    with pytest.raises(PolicyError, match=said), opened() as policy:
        policy.predict(ONES)
