"""Facts about evaluations that other processes play: the same bytes, whatever happens to a process.

Those of Ray are skipped where it is not installed: `make test-rllib`.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wtg_gym.evaluation import Entry, OnnxPolicy, PolicyError, Results, Workers, evaluate, load_entries, workers

pytest.importorskip("joblib", reason="the extra 'cluster' is not installed here")
with contextlib.suppress(ImportError):
    import distributed

ROOT = Path(__file__).resolve().parents[2]
#: Three batches an entry, two of them of the same size.
SHORT: dict[str, Any] = {"seeds": (20_002, 20_000, 20_005, 20_001, 20_007), "duration_s": 2.0, "batch": 2}
BACKENDS = [
    pytest.param(name, marks=pytest.mark.skipif(importlib.util.find_spec(package) is None, reason=f"{name} is missing"))
    for name, (package, _) in workers.BACKENDS.items()
]
needs_dask = pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask is missing")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed with signals")


class Linear:
    """A policy in Python: a fixed multiple of the frequency deviation on every action."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> Any:
        self.act()
        return np.repeat(-3.0 * observation[:, :1], 4, axis=1), state

    def act(self) -> None:
        """What it does besides."""


class Mortal(Linear):
    """The same, but it kills its process, once where a file is to remember that, else always."""

    def __init__(self, driver: int, marker: Path | None) -> None:
        self.driver, self.marker = driver, marker

    def act(self) -> None:
        # What plays here, to compare with, must live.
        if os.getpid() == self.driver:
            return
        with contextlib.suppress(FileExistsError):
            if self.marker is not None:
                self.marker.touch(exist_ok=False)
            os.kill(os.getpid(), signal.SIGKILL)


class Complaint(Exception):
    """An error that only this file knows."""


class Failing(Linear):
    def act(self) -> None:
        raise Complaint("no action from me")


def entries() -> list[Entry]:
    (tip_speed,) = load_entries("tip-speed-feedback")
    (learned,) = load_entries(ROOT / "agents/policies/ppo-k-0")
    return [Entry(name="deloaded-5", strategy="deloaded-5"), tip_speed, learned]


@pytest.fixture(scope="module")
def here() -> Results:
    return evaluate(entries(), "standard", "test", **SHORT)


@pytest.fixture(scope="module", params=BACKENDS)
def two_workers(request: pytest.FixtureRequest) -> Iterator[Workers]:
    """Two workers, those of Dask in one cluster for all tests."""
    if request.param != "dask":
        yield Workers(request.param, jobs=2)
        return
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        yield Workers("dask", cluster.scheduler_address)


def written(results: Results, folder: Path) -> list[bytes]:
    return [path.read_bytes() for path in results.write(folder)]


@pytest.mark.parametrize("backend", BACKENDS)
def test_workers_give_the_same_bytes(backend: str, here: Results, tmp_path: Path) -> None:
    done: list[int] = []
    there = evaluate(
        entries(),
        "standard",
        "test",
        workers=Workers(backend, jobs=2),
        on_progress=lambda name, count, total: done.append(count),
        **SHORT,
    )
    assert there == here
    assert written(there, tmp_path / "a") == written(here, tmp_path / "b")
    assert len(done) == 15 and done == sorted(done) and done[-1] == 25


def test_killed_worker_changes_nothing(two_workers: Workers, tmp_path: Path) -> None:
    marker = tmp_path / "killed"
    mortal = Entry(name="mortal", policy=Mortal(os.getpid(), marker))
    everyone = [*entries(), mortal]
    there = evaluate(everyone, "standard", "test", workers=two_workers, **SHORT)
    assert marker.exists()
    assert there == evaluate(everyone, "standard", "test", **SHORT)


_KILLS_ITS_PARENT = """
import os, signal, threading
from wtg_gym.evaluation import Entry, Workers, evaluate

class Policy:
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        os.kill(os.getppid(), signal.SIGKILL)
        threading.Event().wait()

if __name__ == "__main__":
    evaluate([Entry(name="a", policy=Policy())], "standard", "test", seeds=[20000], workers=Workers("loky", jobs=2))
"""


def test_loky_workers_end_with_the_process_that_started_them() -> None:
    # Its output ends when the last worker has ended, which inherited it.
    done = subprocess.run([sys.executable, "-c", _KILLS_ITS_PARENT], capture_output=True, timeout=120)
    assert done.returncode == -signal.SIGKILL


def test_error_of_a_policy_comes_through_and_is_not_tried_again(two_workers: Workers) -> None:
    failing = Entry(name="failing", policy=Failing())
    text = "entry 'failing', step 0: predict.. raised Complaint: no action from me .test_workers.py:"
    with pytest.raises(PolicyError, match=text):
        evaluate([failing], "standard", "test", workers=two_workers, **SHORT)
    results = evaluate([*entries(), failing], "standard", "test", workers=two_workers, keep_going=True, **SHORT)
    assert [entry["name"] for entry in results.failed] == ["failing"]
    assert results.episodes == evaluate(entries(), "standard", "test", **SHORT).episodes


@pytest.mark.parametrize("backend", ["loky", pytest.param("dask", marks=needs_dask)])
def test_workers_that_always_die_are_given_up(backend: str) -> None:
    mortal = Entry(name="mortal", policy=Mortal(os.getpid(), None))
    # One batch: each attempt costs the worker that plays it, and the other one need not load anything.
    one_batch = {**SHORT, "batch": len(SHORT["seeds"])}
    text = f"{backend} workers were lost 3 times without .*not finished: .*mortal"
    with contextlib.ExitStack() as stack:
        if backend == "dask":
            # Dask itself would try three times more, each time.
            stack.enter_context(
                importlib.import_module("dask").config.set({"distributed.scheduler.allowed-failures": 0})
            )
        stack.enter_context(pytest.raises(ValueError, match=text))
        evaluate([mortal], "standard", "test", workers=Workers(backend, jobs=2), **one_batch)


def test_finished_batches_are_kept_and_not_played_again(tmp_path: Path) -> None:
    class Stopped(Exception):
        pass

    def stop(name: str, done: int, total: int) -> None:
        if done == total:
            raise Stopped

    arguments: dict[str, Any] = {"workers": Workers("loky", jobs=2), "partial": tmp_path, **SHORT}
    with pytest.raises(Stopped):
        evaluate([Entry(name="a", policy=Linear(), fingerprint="1")], "standard", "test", on_progress=stop, **arguments)
    assert len(list(tmp_path.iterdir())) == 9
    # It passes for the same policy, and would complain if it were asked.
    again = evaluate([Entry(name="a", policy=Failing(), fingerprint="1")], "standard", "test", **arguments)
    assert again == evaluate([Entry(name="a", policy=Linear(), fingerprint="1")], "standard", "test", **SHORT)
    assert list(tmp_path.iterdir()) == []


def test_policy_that_cannot_travel_is_named_before_anything_runs() -> None:
    policy = Linear()
    policy.lock = threading.Lock()  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=r"entry 'tied' cannot be sent to other processes: .*pickle"):
        evaluate([Entry(name="tied", policy=policy)], "standard", "test", workers=Workers("loky", jobs=2), **SHORT)


def test_pickled_onnx_policy_answers_the_same() -> None:
    import cloudpickle

    policy = OnnxPolicy(ROOT / "agents/policies/ppo-k-0/policy.onnx")
    copied = cloudpickle.loads(cloudpickle.dumps(policy))
    observations = np.random.default_rng(0).normal(size=(5, policy.widths[0])).astype(np.float32)
    assert copied.sha256 == policy.sha256
    assert np.array_equal(copied.predict(observations)[0], policy.predict(observations)[0])


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("threads",), "unknown backend 'threads'; allowed are loky, dask, ray"),
        (("loky", "tcp://head:8786"), "loky has workers on this machine only"),
        (("loky", None, 1), "jobs must be 2 … 10000"),
        (("loky", None, 0), "jobs must be 2 … 10000"),
        (("loky", None, 2.0), "jobs must be 2 … 10000"),
    ],
)
def test_wrong_workers_are_refused(arguments: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Workers(*arguments)


def test_threads_and_workers_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="one thread"):
        evaluate([], "standard", "test", workers=Workers("loky"), n_threads=2, **SHORT)


def test_missing_package_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name != "joblib" else True)
    with pytest.raises(ValueError, match=r"dask needs distributed; in a checkout: pip install '\.\[cluster\]'"):
        Workers("dask")
    with pytest.raises(ValueError, match=r"ray needs ray; in a checkout: pip install '\.\[rllib\]'"):
        Workers("ray")


@needs_dask
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere", "smoke://a:1"])
def test_scheduler_that_does_not_answer_is_named(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_CONNECT_S", 1)
    with pytest.raises(ValueError, match=f"no Dask scheduler answers at {address}"):
        evaluate([], "standard", "test", workers=Workers("dask", address), **SHORT)


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="ray is missing")
def test_ray_cluster_that_does_not_answer_is_named() -> None:
    with pytest.raises(ValueError, match="no Ray cluster answers at auto"):
        evaluate([], "standard", "test", workers=Workers("ray", "auto"), **SHORT)


@contextlib.contextmanager
def dask_cluster(folder: Path, path: Path, **more: str) -> Iterator[str]:
    """A scheduler and a worker from the command line, the worker with the wtg_gym that lies in a folder."""
    file, logs = folder / "scheduler.json", folder / "log"
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    environment = {**os.environ, "PYTHONPATH": str(path), **more}
    with contextlib.ExitStack() as stack, logs.open("w") as log:
        commands = {
            "scheduler": [*common, "--host", "127.0.0.1", "--port", "0"],
            "worker": [*common, "--nthreads", "1", "--no-nanny"],
        }
        for kind, options in commands.items():
            command = [sys.executable, "-m", "dask", kind, *options]
            process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
            stack.callback(process.wait)
            stack.callback(process.kill)
            until = time.monotonic() + 100.0
            while not file.exists():
                assert process.poll() is None and time.monotonic() < until, logs.read_text()
                time.sleep(0.01)
        yield json.loads(file.read_text())["address"]


@needs_dask
def test_cluster_at_an_address_gives_the_same_bytes(here: Results, tmp_path: Path) -> None:
    with dask_cluster(tmp_path, ROOT) as address:
        assert evaluate(entries(), "standard", "test", workers=Workers("dask", address), **SHORT) == here


@needs_dask
def test_worker_with_other_code_is_refused(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "wtg_gym", tmp_path / "other/wtg_gym")
    with (tmp_path / "other/wtg_gym/physics/dynamics.py").open("a") as file:
        file.write("# Edited.\n")
    with (
        # It is to play nothing, and so need not compile the other code.
        dask_cluster(tmp_path, tmp_path / "other", NUMBA_DISABLE_JIT="1") as address,
        pytest.raises(ValueError, match=r"worker \S+:\d+ could give other numbers: source code is \w+, here \w+$"),
    ):
        evaluate(entries(), "standard", "test", workers=Workers("dask", address), **SHORT)
