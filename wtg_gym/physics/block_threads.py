"""Work on the blocks of a simulator, on several threads where that pays."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

from wtg_gym.signals import undivided

#: A thread is worth its start only for this many blocks.
_BLOCKS_PER_THREAD = 4


class BlockThreads:
    """Threads that work on blocks.

    Args:
        n_blocks: number of blocks.
        n_threads: threads, at most; None for one per processor.
    """

    def __init__(self, n_blocks: int, n_threads: int | None = None) -> None:
        self.n_blocks = n_blocks
        self.n_threads = n_threads
        #: Never more than when this was made, or copied to this machine: what each worker needs was made then.
        self._most = self._wanted()
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0

    @property
    def n_workers(self) -> int:
        """Threads that work on blocks at once."""
        return min(self._most, self._wanted())

    def _wanted(self) -> int:
        return max(1, min(self.n_blocks // _BLOCKS_PER_THREAD, self.n_threads or os.cpu_count() or 1))

    @undivided
    def run(
        self,
        work: Callable[[int, int, int], Any],
        meanwhile: Callable[[], Any] | None = None,
        meanwhile_blocks: int = 0,
    ) -> None:
        """Call `work(first, last, worker)` for ranges that cover all blocks, each with a worker's number of its own.

        Args:
            work: compiled with nogil, so that it releases the interpreter's lock.
            meanwhile: called once, by this thread, while others work.
            meanwhile_blocks: how many blocks take as long as that call.
        """
        n_blocks = self.n_blocks
        n_threads = self.n_workers
        futures, own = [], n_blocks
        if n_threads > 1:
            own = max(0, (n_blocks + meanwhile_blocks) // n_threads - meanwhile_blocks)
            edges = [own + (n_blocks - own) * i // (n_threads - 1) for i in range(n_threads)]
            pool = self._workers(n_threads)
            futures = [pool.submit(work, edges[i], edges[i + 1], i + 1) for i in range(n_threads - 1)]
        # Whatever happens meanwhile, no block may be left a step behind the others.
        try:
            if meanwhile is not None:
                meanwhile()
        finally:
            try:
                work(0, own, 0)
            finally:
                wait(futures)
        for done in futures:
            done.result()

    def _workers(self, n_threads: int) -> ThreadPoolExecutor:
        # A forked process inherits the pool, but not its threads.
        if self._pool is None or self._pool_process != os.getpid():
            self._pool = ThreadPoolExecutor(n_threads, thread_name_prefix="wtg_gym")
            self._pool_process = os.getpid()
        return self._pool

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        # A thread pool cannot be copied.
        return {**self.__dict__, "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._most = self._wanted()
