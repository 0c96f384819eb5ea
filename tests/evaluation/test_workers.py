"""Facts about evaluations that other processes play: the same bytes, whatever happens to a process."""

import contextlib
import functools
import importlib.util
import os
import signal
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from wtg_gym.evaluation import Entry, Workers, evaluate, load_entries, workers
from wtg_gym.evaluation.circumstances import circumstances

ROOT = Path(__file__).resolve().parents[2]
#: Three batches an entry, two of them of the same size.
SHORT = {"seeds": (20_002, 20_000, 20_005, 20_001, 20_007), "duration_s": 2.0, "batch": 2}

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed with signals")

pytest.importorskip("joblib", reason="the extra 'cluster' is not installed here")


class Linear:
    """A policy in Python: a fixed multiple of the frequency deviation on every action."""

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = False):
        self.act()
        return np.repeat(-3.0 * observation[:, :1], 4, axis=1), state

    def act(self) -> None:
        """What it does besides."""


class Mortal(Linear):
    """The same, but it kills its process once, which a file remembers."""

    def __init__(self, marker: Path) -> None:
        self.driver, self.marker = os.getpid(), marker

    def act(self) -> None:
        # What plays here, to compare with, must live.
        if os.getpid() != self.driver:
            with contextlib.suppress(FileExistsError):
                self.marker.touch(exist_ok=False)
                os.kill(os.getpid(), signal.SIGKILL)


class Failing(Linear):
    def act(self) -> None:
        raise ZeroDivisionError("no action from me")


@pytest.mark.parametrize("backend", workers.BACKENDS)
def test_workers_give_the_same_bytes_and_failures(backend, tmp_path):
    entries = [*load_entries("tip-speed-feedback"), *load_entries(ROOT / "agents/policies/ppo-k-0")]
    entries.append(Entry(name="failing", policy=Failing()))
    if backend != "loky":
        # A cluster plays the batches of a lost worker again.
        entries.append(Entry(name="mortal", policy=Mortal(tmp_path / "killed")))
    done: list[int] = []
    elsewhere = {"workers": Workers(backend, jobs=2), "on_progress": lambda _, count, __: done.append(count)}
    play = functools.partial(evaluate, entries, "standard", "test", keep_going=True, **SHORT)
    there, here = play(**elsewhere), play()
    assert there == here and (tmp_path / "killed").exists() == (backend != "loky")
    for one, other in zip(there.write(tmp_path / "a"), here.write(tmp_path / "b"), strict=True):
        assert one.read_bytes() == other.read_bytes()
    assert done == sorted(done) and done[-1] == 5 * (len(entries) + 2)
    (failed,) = there.failed
    assert "predict() raised ZeroDivisionError: no action from me (test_workers.py:" in failed["reason"]


def test_killed_worker_of_loky_is_named_and_the_run_goes_on_from_its_finished_batches(tmp_path):
    # The anchors first: the batches of what comes after them are lost with the worker.
    arguments = {"partial": tmp_path / "partial", **SHORT}
    evaluate([], "standard", "test", **arguments)
    mortal = Entry(name="mortal", policy=Mortal(tmp_path / "killed"), fingerprint="1")
    with pytest.raises(ValueError, match="a loky worker was lost"):
        evaluate([mortal], "standard", "test", workers=Workers("loky", jobs=2), **arguments)
    again = evaluate([mortal], "standard", "test", workers=Workers("loky", jobs=2), **arguments)
    # It passes for the same policy, and would complain if it were asked.
    assert evaluate([Entry(name="mortal", policy=Failing(), fingerprint="1")], "standard", "test", **arguments) == again


def test_dask_cluster_at_an_address_plays_names_a_lost_worker_or_is_named(tmp_path, monkeypatch):
    import dask
    import distributed

    arguments = {"seeds": (20_002,), "duration_s": 2.0}
    mortal = Entry(name="mortal", policy=Mortal(tmp_path / "killed"))
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
    ):
        there = Workers("dask", cluster.scheduler_address)
        result, expected = (evaluate([], "standard", "test", workers=where, **arguments) for where in (there, None))
        assert result == expected
        with pytest.raises(ValueError, match="a dask worker was lost, KilledWorker"):
            evaluate([mortal], "standard", "test", workers=there, **arguments)
    assert evaluate([], "standard", "test", workers=Workers("dask", jobs=2), **arguments) == expected
    monkeypatch.setattr(workers, "_CONNECT_S", 1)
    for address in ("tcp://127.0.0.1:1", "nowhere"):
        with pytest.raises(ValueError, match=f"no dask cluster answers at {address}"):
            evaluate([], "standard", "test", workers=Workers("dask", address), **SHORT)


def test_worker_with_other_code_plays_nothing():
    wanted = {**circumstances(), "source code": "another"}
    message = workers._work(lambda *_: pytest.fail("played"), b"", [20_000], wanted)
    assert isinstance(message, str) and "could give other numbers: source code is " in message
    message = workers._work(lambda *_: pytest.fail("played"), b"no pickle", [20_000], circumstances())
    assert isinstance(message, str) and "cannot play an entry: " in message


def test_policy_that_cannot_travel_is_named():
    tied = Linear()
    tied.lock = threading.Lock()
    with pytest.raises(ValueError, match=r"entry 'tied' cannot be sent to other processes: .*pickle"):
        evaluate([Entry(name="tied", policy=tied)], "standard", "test", workers=Workers("loky", jobs=2), **SHORT)


def test_workers_have_one_thread_each_and_their_package(monkeypatch):
    with pytest.raises(ValueError, match="one thread"):
        evaluate([], "standard", "test", workers=Workers("loky"), n_threads=2, **SHORT)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"dask needs distributed; in a checkout: pip install '\.\[cluster\]'"):
        Workers("dask")
