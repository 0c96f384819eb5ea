"""Batches played by other processes, here or on a cluster: loky's, Dask's or Ray's.

A cluster plays the batches of a worker that is lost again. A worker whose code, packages or processor could round
otherwise than those here is refused.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import socket
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.circumstances import circumstances
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.extras import install_advice
from wtg_gym.policies import Entry, PolicyError

#: Backends: the package each of them needs, and the extra of wtg-gym that brings it.
BACKENDS = {"loky": ("joblib", "cluster"), "dask": ("distributed", "cluster"), "ray": ("ray", "rllib")}
_LARGEST_JOBS = 10_000
#: Time for a scheduler to answer [s].
_CONNECT_S = 15

#: The episodes of a batch, or how the entry's policy failed.
Played = list[Episode] | PolicyError
#: Plays one batch: entry, settings, seeds, number of threads.
Play = Callable[[Entry, EnvSettings, Sequence[int], int | None], Played]
#: Number of a batch, and its episodes, or in words why the worker could not play it.
_Outcome = tuple[int, Played | str]


@dataclass(frozen=True)
class Workers:
    """Processes that play the batches of an evaluation, one batch on one thread at a time.

    Numbers do not depend on who plays a batch. A policy travels pickled, and code of the working folder with it, so it
    must keep what it remembers in the state that `predict` returns.

    Args:
        backend: "loky" for processes of this machine; "dask" or "ray" for a cluster, or for one of their own here.
        address: of Dask's scheduler, as in "tcp://host:8786", or of a Ray cluster, as in "host:6379" or "auto"; None
            starts workers on this machine.
        jobs: number of workers, 2 or more; None for one per processor. A Dask cluster at an address uses all it has.

    Raises:
        ValueError: the backend is unknown or not installed, or it cannot have that address or number of jobs.
    """

    backend: str
    address: str | None = None
    jobs: int | None = None

    def __post_init__(self) -> None:
        backend, address, jobs = self.backend, self.address, self.jobs
        if backend not in BACKENDS:
            raise ValueError(f"unknown backend {backend!r}; allowed are {', '.join(BACKENDS)}")
        if address is not None and backend == "loky":
            raise ValueError(f"an address is for dask and ray, loky has workers on this machine only; got {address!r}")
        if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or not 2 <= jobs <= _LARGEST_JOBS):
            raise ValueError(f"jobs must be 2 … {_LARGEST_JOBS} (a single one needs no backend), got {jobs!r}")
        if jobs is not None and address is not None and backend == "dask":
            raise ValueError(f"a Dask cluster at an address uses all of its workers; leave out jobs, got {jobs}")
        package, extra = BACKENDS[backend]
        if importlib.util.find_spec(package) is None:
            raise ValueError(f"backend {backend} needs {package}; {install_advice(extra)}")

    def play(
        self, play: Play, settings: EnvSettings, parts: Sequence[tuple[Entry, list[int]]]
    ) -> Generator[tuple[int, Played], None, None]:
        """Yield (index, episodes or the policy's failure) of every part as soon as it is finished.

        Args:
            play: plays a batch; a function of this package.
            settings: settings of the environment.
            parts: (entry, seeds) of the batches.

        Raises:
            ValueError: an entry cannot travel or be played there, the cluster does not answer, a worker has other code,
                packages or processor, or is lost for good.
        """
        wanted, parcels = circumstances(), _packed([entry for entry, _ in parts], settings)
        calls = [(index, play, parcels[id(entry)], seeds, wanted) for index, (entry, seeds) in enumerate(parts)]
        make = {"loky": _on_loky, "dask": _on_dask, "ray": _on_ray}[self.backend]
        with contextlib.closing(make(calls, self.address, self.jobs)) as outcomes:
            try:
                for index, played in outcomes:
                    if isinstance(played, str):
                        raise ValueError(played)
                    yield index, played
            except ValueError:
                raise
            # What a policy raises comes as an outcome; this is the error of a worker that is lost.
            except Exception as error:
                raise ValueError(f"a {self.backend} worker was lost, {_in_short(error)}") from error


# --- what travels ----------------------------------------------------------------------------------------------------


def _packed(entries: Sequence[Entry], settings: EnvSettings) -> dict[int, bytes]:
    """Return each entry, together with the settings, as bytes, by the entry's id.

    Bytes, because objects that Dask spreads out by itself are lost with the worker that holds them.

    Raises:
        ValueError: an entry cannot be pickled.
    """
    found: dict[int, bytes] = {}
    with _own_code_by_value():
        for entry in entries:
            if id(entry) not in found:
                try:
                    found[id(entry)] = cloudpickle.dumps((entry, settings))
                # Pickling runs code of the policy.
                except Exception as error:
                    raise ValueError(f"entry {entry.label!r} cannot be sent to other processes: {error}") from error
    return found


@contextlib.contextmanager
def _own_code_by_value() -> Iterator[None]:
    """Let modules of the working folder travel as code: a worker elsewhere could not import them."""
    folder = Path.cwd().resolve()
    own = []
    for name, module in list(sys.modules.items()):
        path = Path(getattr(module, "__file__", None) or "/").resolve()
        # An environment may lie in the working folder, and wtg_gym is what a worker must have of its own.
        if not path.is_relative_to(folder) or "site-packages" in path.parts:
            continue
        if name.partition(".")[0] in ("__main__", "__mp_main__", "wtg_gym"):
            continue
        if name not in cloudpickle.list_registry_pickle_by_value():
            own.append(module)
    for module in own:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)


def _work(index: int, play: Play, parcel: bytes, seeds: list[int], wanted: dict[str, str]) -> _Outcome:
    """Play a batch in a worker; nothing is played where the circumstances are others than those wanted."""
    worker, own = f"worker {socket.gethostname()}:{os.getpid()}", circumstances()
    differing = [key for key in sorted({*wanted, *own}) if wanted.get(key) != own.get(key)]
    if differing:
        listed = "; ".join(f"{key} is {own.get(key, 'unknown')}, here {wanted.get(key)}" for key in differing)
        return index, f"{worker} could give other numbers: {listed}"
    try:
        entry, settings = cloudpickle.loads(parcel)
        return index, play(entry, settings, seeds, 1)
    # Loading and playing run code of the policy.
    except Exception as error:
        return index, f"{worker} cannot play an entry: {type(error).__name__}: {error}"


def _in_short(error: BaseException) -> str:
    return f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"


# --- backends: make the calls of _work, and yield their outcomes as they come ----------------------------------------


def _on_loky(calls: Sequence[Any], address: str | None, jobs: int | None) -> Generator[_Outcome, None, None]:
    from joblib.externals.loky import ProcessPoolExecutor

    executor = ProcessPoolExecutor(jobs or os.cpu_count())
    try:
        for future in as_completed([executor.submit(_work, *call) for call in calls]):
            yield future.result()
    finally:
        executor.shutdown(kill_workers=True)


def _on_dask(calls: Sequence[Any], address: str | None, jobs: int | None) -> Generator[_Outcome, None, None]:
    import distributed

    with contextlib.ExitStack() as stack:
        target: Any = address
        try:
            if address is None:
                options = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
                target = stack.enter_context(distributed.LocalCluster(n_workers=jobs or os.cpu_count(), **options))
            else:
                # A client that was made for an address that is none takes half a minute to go.
                distributed.comm.get_address_host_port(address, strict=True)
            client = stack.enter_context(distributed.Client(target, timeout=_CONNECT_S, set_as_default=False))
        except (OSError, ValueError) as error:
            raise ValueError(f"no Dask scheduler answers at {address}: {_in_short(error)}") from error
        futures = [client.submit(_work, *call, pure=False) for call in calls]
        with client.as_current():
            completed = distributed.as_completed(futures)
        for future in completed:
            yield future.result()


def _on_ray(calls: Sequence[Any], address: str | None, jobs: int | None) -> Generator[_Outcome, None, None]:
    import ray

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    options: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
    if address is None:
        options.update(num_cpus=jobs or os.cpu_count(), include_dashboard=False)
    try:
        ray.init(address or "local", **options)
    # Ray ends the process where a cluster that it remembers is gone.
    except (ConnectionError, ValueError, SystemExit) as error:
        raise ValueError(f"no Ray cluster answers at {address}: {_in_short(error)}") from error
    try:
        play = ray.remote(num_cpus=1)(_work)
        waiting: list[Any] = list(calls)
        running: list[Any] = []
        while waiting or running:
            while waiting and len(running) < (jobs or len(calls)):
                running.append(play.remote(*waiting.pop(0)))
            done, running = ray.wait(running)
            yield from ray.get(done)
    finally:
        ray.shutdown()
