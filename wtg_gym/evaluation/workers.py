"""Batches played by other processes: joblib's loky on this machine, or Dask's, here or on a cluster.

A cluster plays the batches of a worker that is lost again. A worker whose code, packages or processor could round
otherwise than those here is refused.
"""

import contextlib
import importlib.util
import os
import socket
import tempfile
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass
from typing import Any

import cloudpickle

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.circumstances import circumstances
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.extras import install_advice
from wtg_gym.files import one_line
from wtg_gym.policies import Entry, PolicyError
from wtg_gym.ranges import require_choice, require_whole

#: Backends, and the package each of them needs.
BACKENDS = {"loky": "joblib", "dask": "distributed"}
_LARGEST_JOBS = 10_000
#: Time for a scheduler to answer [s].
_CONNECT_S = 15

#: The episodes of a batch, or how the entry's policy failed.
Played = list[Episode] | PolicyError
#: A batch: an entry, and the seeds of the scenarios that it plays at once.
Part = tuple[Entry, list[int]]
#: Batches by their index, as soon as each is played.
Playing = Generator[tuple[int, Played], None, None]
#: Plays one batch: entry, settings, seeds, number of threads.
Play = Callable[[Entry, EnvSettings, Sequence[int], int | None], Played]


@dataclass(frozen=True)
class Workers:
    """Processes that play the batches of an evaluation, one batch on one thread at a time.

    Numbers do not depend on who plays a batch. A policy travels pickled, so it must keep what it remembers in the state
    that `predict` returns, and its module must be there on every machine. A ValueError says that the backend is unknown
    or not installed, or cannot have that address or number of jobs.
    """

    backend: str  # "loky" for processes of this machine; "dask" for a cluster, or for one of its own here
    address: str | None = None  # of Dask's scheduler, as in "tcp://host:8786"; None starts workers on this machine
    jobs: int | None = None  # number of workers, 2 or more; None: one per processor, or all that a cluster has

    def __post_init__(self) -> None:
        backend, address, jobs = self.backend, self.address, self.jobs
        require_choice("backend", backend, BACKENDS)
        if address is not None and backend == "loky":
            raise ValueError(f"an address is for dask, loky has workers on this machine only; got {address!r}")
        if jobs is not None:
            require_whole("jobs", jobs, 2, _LARGEST_JOBS)
        if jobs is not None and address is not None:
            raise ValueError(f"a cluster at an address uses all of its workers; leave out jobs, got {jobs}")
        if importlib.util.find_spec(BACKENDS[backend]) is None:
            raise ValueError(f"backend {backend} needs {BACKENDS[backend]}; {install_advice('cluster')}")

    def play(self, play: Play, settings: EnvSettings, parts: Mapping[int, Part]) -> Playing:
        """Yield (index, episodes or the policy's failure) of every part, as soon as it is finished.

        A ValueError says that an entry cannot travel, that the cluster does not answer, or that a worker has other
        code, packages or processor, or is lost for good.
        """
        expected, parcels = circumstances(), dict[int, bytes]()
        for entry, _ in parts.values():
            try:
                # As bytes: objects that Dask spreads out are lost with the worker that has them.
                parcels[id(entry)] = parcels.get(id(entry)) or cloudpickle.dumps((entry, settings))
            # Pickling runs code of the policy.
            except Exception as error:
                raise ValueError(f"entry {entry.label!r} cannot be sent to other processes: {error}") from error
        with contextlib.ExitStack() as stack:
            try:
                submit = stack.enter_context(_submitter(self.backend, self.address, self.jobs or os.cpu_count() or 1))
            except (OSError, ValueError) as error:
                raise ValueError(f"no {self.backend} cluster answers at {self.address}: {one_line(error)}") from error
            indices = {
                submit(_work, play, parcels[id(entry)], seeds, expected): index
                for index, (entry, seeds) in parts.items()
            }
            for future in as_completed(indices):
                try:
                    played = future.result()
                # Errors of policies are results; this is the error of a lost worker.
                except Exception as error:
                    lost = f"a {self.backend} worker was lost, {type(error).__name__}"
                    raise ValueError(f"{lost}: {one_line(error)}") from error
                if isinstance(played, str):
                    raise ValueError(played)
                yield indices[future], played


def _work(play: Play, parcel: bytes, seeds: list[int], expected: dict[str, str]) -> Played | str:
    """Play a batch in a worker, or say why not: where the circumstances are others than those wanted, too."""
    worker, actual = f"worker {socket.gethostname()}:{os.getpid()}", circumstances()
    differing = [key for key in sorted({*expected, *actual}) if expected.get(key) != actual.get(key)]
    if differing:
        listed = "; ".join(f"{key} is {actual.get(key, 'unknown')}, here {expected.get(key)}" for key in differing)
        return f"{worker} could give other numbers: {listed}"
    try:
        entry, settings = cloudpickle.loads(parcel)
        return play(entry, settings, seeds, 1)
    # Loading and playing run code of the policy.
    except Exception as error:
        return f"{worker} cannot play an entry: {type(error).__name__}: {error}"


@contextlib.contextmanager
def _submitter(backend: str, address: str | None, jobs: int) -> Iterator[Callable[..., Future[Any]]]:
    # Not joblib's own interface to Dask (1.6), which waits for ever for a worker that Dask gives up.
    with contextlib.ExitStack() as stack:
        if backend == "loky":
            from joblib.externals.loky import ProcessPoolExecutor

            executor = ProcessPoolExecutor(jobs)
            stack.callback(executor.shutdown, kill_workers=True)
            yield executor.submit
            return
        import distributed

        options: dict[str, Any] = {}
        if address is None:
            # In a folder of its own: pickles are written there, and Dask's usual one is shared by all users.
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            options = {"n_workers": jobs, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
            options["local_directory"] = folder
        else:
            # A client that was made for an address that is none takes half a minute to go.
            distributed.comm.get_address_host_port(address, strict=True)
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False, **options)
        yield stack.enter_context(client).get_executor(pure=False).submit
