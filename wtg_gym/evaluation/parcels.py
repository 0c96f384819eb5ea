"""The traffic between an evaluation and its workers: an entry goes there, a batch's episodes or an error come back."""

from __future__ import annotations

import contextlib
import functools
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cloudpickle

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.circumstances import circumstances
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.policies import Entry, PolicyError

#: How often a worker looks whether its parent process is still there [s].
_WATCH_S = 1.0

#: The episodes of a batch, or how the entry's policy failed.
Played = list[Episode] | PolicyError
#: Plays one batch: entry, settings, seeds, number of threads.
Play = Callable[[Entry, EnvSettings, Sequence[int], int | None], Played]


class Outcome(NamedTuple):
    """The outcome of a batch: episodes or an error, from which worker, and the circumstances there."""

    part: int
    played: Played
    error: str
    worker: str
    circumstances: dict[str, str]


def packed(entries: Sequence[Entry], settings: EnvSettings) -> dict[int, bytes]:
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


def work(part: int, play: Play, parcel: bytes, seeds: list[int], wanted: dict[str, str], parent: int | None) -> Outcome:
    """Play a batch in a worker; nothing is played where the circumstances are others.

    Args:
        part: number of the batch, for the outcome.
        play: plays it, on one thread.
        parcel: its entry and settings, see :func:`packed`.
        seeds: of its scenarios.
        wanted: the :func:`circumstances` that there must be.
        parent: the process that this worker is to end with; None for none.
    """
    if parent is not None:
        _end_with(parent)
    own, played, error = circumstances(), list[Episode](), ""
    if own == wanted:
        try:
            entry, settings = cloudpickle.loads(parcel)
            return Outcome(part, play(entry, settings, seeds, 1), "", _worker(), own)
        # Loading and playing run code of the policy.
        except Exception as raised:
            error = f"{type(raised).__name__}: {raised}"
    return Outcome(part, played, error, _worker(), own)


def _worker() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"


@functools.cache
def _end_with(parent: int) -> None:
    """Have this worker end once its parent process is gone: it would wait for ever for its result to be read."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def opened(outcome: Outcome, wanted: dict[str, str]) -> Played:
    """Return the episodes of an outcome, or how the policy failed.

    Raises:
        ValueError: the circumstances were others, so that the numbers could be others, or the batch was not played.
    """
    theirs = outcome.circumstances
    differing = [key for key in sorted({*wanted, *theirs}) if wanted.get(key) != theirs.get(key)]
    if differing:
        listed = "; ".join(f"{key} is {theirs.get(key, 'unknown')}, here {wanted.get(key)}" for key in differing)
        raise ValueError(f"worker {outcome.worker} could give other numbers: {listed}")
    if outcome.error:
        raise ValueError(f"worker {outcome.worker} cannot play an entry: {outcome.error}")
    return outcome.played
