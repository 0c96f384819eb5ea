"""Batches played by other processes, here or on a cluster, through joblib: one word chooses loky, Dask or Ray.

A worker that is lost costs the batches it had in hand: they are played again by another. A worker whose code, packages
or processor could round otherwise than those here is refused.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.circumstances import circumstances
from wtg_gym.evaluation.parcels import Outcome, Play, Played, opened, packed, work
from wtg_gym.extras import install_advice
from wtg_gym.policies import Entry

#: Backends of joblib: the package each of them needs, and the extra of wtg-gym that brings it.
BACKENDS = {"loky": ("joblib", "cluster"), "dask": ("distributed", "cluster"), "ray": ("ray", "rllib")}
_LARGEST_JOBS = 10_000
#: Workers may be lost this often in a row without a batch finished in between.
_ATTEMPTS = 3
#: Time for a scheduler to answer [s].
_CONNECT_S = 15
#: A loky worker without anything to do ends after this time [s].
_IDLE_S = 5
#: Ray's results come a round at a time: so many batches per worker, that waiting for the last one costs little.
_ROUND = 8


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
        if self.backend not in BACKENDS:
            raise ValueError(f"unknown backend {self.backend!r}; allowed are {', '.join(BACKENDS)}")
        if self.address is not None and self.backend == "loky":
            raise ValueError(
                f"an address is for dask and ray, loky has workers on this machine only; got {self.address!r}"
            )
        jobs = self.jobs
        if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or not 2 <= jobs <= _LARGEST_JOBS):
            raise ValueError(f"jobs must be 2 … {_LARGEST_JOBS} (a single one needs no backend), got {jobs!r}")
        if jobs is not None and self.address is not None and self.backend == "dask":
            raise ValueError(f"a Dask cluster at an address uses all of its workers; leave out jobs, got {jobs}")
        package, extra = BACKENDS[self.backend]
        missing = [name for name in ("joblib", package) if importlib.util.find_spec(name) is None]
        if missing:
            raise ValueError(f"backend {self.backend} needs {missing[0]}; {install_advice(extra)}")

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
                packages or processor, or workers are lost again and again.
        """
        wanted, parcels = circumstances(), packed([entry for entry, _ in parts], settings)
        parent = os.getpid() if self.backend == "loky" else None
        calls: dict[int, Any] = {
            index: (work, (index, play, parcels[id(entry)], seeds, wanted, parent), {})
            for index, (entry, seeds) in enumerate(parts)
        }
        outcomes = self._outcomes(calls, [entry.label for entry, _ in parts])
        with contextlib.closing(outcomes):
            for outcome in outcomes:
                yield outcome.part, opened(outcome, wanted)

    def _outcomes(self, calls: dict[int, Any], labels: Sequence[str]) -> Generator[Outcome, None, None]:
        """Yield the outcomes of the calls, in any order; calls that are lost with a worker are made again."""
        n_lost = 0
        with self._started() as made:
            while calls:
                try:
                    for outcome in made(list(calls.values())):
                        n_lost = 0
                        del calls[outcome.part]
                        yield outcome
                # Errors of a policy come as outcomes; this is the error of a lost worker.
                except Exception as error:
                    n_lost += 1
                    if n_lost == _ATTEMPTS:
                        names = ", ".join(dict.fromkeys(labels[index] for index in calls))
                        raise ValueError(
                            f"{self.backend} workers were lost {n_lost} times without a batch finished in between, "
                            f"{type(error).__name__}: {_first_line(error)}; not finished: {names}"
                        ) from error

    @contextlib.contextmanager
    def _started(self) -> Iterator[Callable[[list[Any]], Iterable[Outcome]]]:
        """Start or reach the workers; yield a function that makes calls there, written as joblib's `delayed` does."""
        if self.backend == "loky":
            yield lambda calls: _unordered(calls, backend="loky", n_jobs=self.jobs or -1, idle_worker_timeout=_IDLE_S)
        elif self.backend == "dask":
            with self._dask() as client:
                yield lambda calls: _unordered(calls, backend=_dask_backend(client), n_jobs=-1)
        else:
            with self._ray() as n_jobs:
                yield lambda calls: _in_rounds(calls, n_jobs)

    @contextlib.contextmanager
    def _dask(self) -> Iterator[Any]:
        import distributed

        with contextlib.ExitStack() as stack:
            target: Any = self.address
            if target is None:
                n_workers = self.jobs or os.cpu_count()
                local = distributed.LocalCluster(
                    n_workers=n_workers, threads_per_worker=1, dashboard_address="127.0.0.1:0"
                )
                target = stack.enter_context(local)
            try:
                if self.address is not None:
                    # A client that was made for an address that is none takes half a minute to go.
                    distributed.comm.get_address_host_port(self.address, strict=True)
                client = distributed.Client(target, timeout=_CONNECT_S, set_as_default=False)
            except (OSError, ValueError) as error:
                raise ValueError(f"no Dask scheduler answers at {self.address}: {_first_line(error)}") from error
            yield stack.enter_context(client)

    @contextlib.contextmanager
    def _ray(self) -> Iterator[int]:
        import ray
        from ray.util.joblib import register_ray

        register_ray()
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        options: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
        if self.address is None:
            options.update(num_cpus=self.jobs or os.cpu_count(), include_dashboard=False)
        try:
            ray.init(self.address or "local", **options)
        # Ray ends the process where a cluster that it remembers is gone.
        except (ConnectionError, ValueError, SystemExit) as error:
            raise ValueError(f"no Ray cluster answers at {self.address}: {_first_line(error)}") from error
        try:
            n_cpus = int(ray.cluster_resources().get("CPU", 0))
            n_jobs = self.jobs or n_cpus
            if not 2 <= n_jobs <= n_cpus:
                raise ValueError(f"a Ray worker needs a CPU, and two of them at least: {n_jobs} jobs, {n_cpus} CPUs")
            yield n_jobs
        finally:
            ray.shutdown()


def _first_line(error: BaseException) -> str:
    # An exit has a number for its reason, if any.
    return type(error).__name__ if isinstance(error, SystemExit) else str(error).strip().partition("\n")[0]


# --- joblib ----------------------------------------------------------------------------------------------------------


def _unordered(calls: list[Any], *, backend: Any, n_jobs: int, **options: Any) -> Iterator[Outcome]:
    """Make the calls, and yield the results in the order of their ends."""
    import joblib

    with joblib.parallel_config(backend=backend, **options):
        parallel = joblib.Parallel(n_jobs=n_jobs, batch_size=1, return_as="generator_unordered")
    results = parallel(calls)
    try:
        # Not `yield from`, which would close the results itself, and warn.
        for result in results:  # noqa: UP028
            yield result
    finally:
        with warnings.catch_warnings():
            # The warning of unfinished calls, which are unfinished on purpose.
            warnings.simplefilter("ignore")
            results.close()


def _in_rounds(calls: list[Any], n_jobs: int) -> Iterator[Outcome]:
    """Make the calls on Ray in rounds, as its backend gives results back together only: a lost worker costs a round."""
    import joblib

    with joblib.parallel_config(backend="ray", ray_remote_args={"num_cpus": 1}):
        parallel = joblib.Parallel(n_jobs=n_jobs, batch_size=1)
    with parallel:
        for first in range(0, len(calls), _ROUND * n_jobs):
            yield from parallel(calls[first : first + _ROUND * n_jobs])


def _dask_backend(client: Any) -> Any:
    from joblib._dask import DaskDistributedBackend

    class Backend(DaskDistributedBackend):  # type: ignore[misc]
        """joblib's own leaves out the callback where Dask gives a call up, and would wait for ever."""

        def effective_n_jobs(self, n_jobs: int) -> int:
            # With a single one joblib would make the calls here.
            return max(2, int(super().effective_n_jobs(n_jobs)))

        def submit(self, func: Any, callback: Any = None) -> Any:
            future = super().submit(func, callback)
            future.add_done_callback(lambda done: done.exception() is None or callback(done.exception()))
            return future

        def retrieve_result_callback(self, out: Any) -> Any:
            if isinstance(out, BaseException):
                raise ConnectionError(f"{type(out).__name__}: {out}") from out
            return super().retrieve_result_callback(out)

    return Backend(client=client)
