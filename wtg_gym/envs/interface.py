"""Common part of the single and the vector environment: construction, spec, actions, and one thread at a time."""

import dataclasses
import functools
import inspect
import numbers
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec

from wtg_gym.envs.batch import BatchSnapshot, EnvBatch
from wtg_gym.envs.rendering import BatchFrames
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.layout import Floats
from wtg_gym.ranges import did_you_mean, require_choice, require_known
from wtg_gym.signals import undivided
from wtg_gym.tasks import TASKS, observation

P = ParamSpec("P")
R = TypeVar("R")

Observation = npt.NDArray[np.float32]
Action = npt.NDArray[np.float32]


class Use:
    """Which thread is within an environment, one at a time. A copy begins unused.

    An interrupt just after :attr:`taken_by` leaves it with a thread that has left; the next call there gives it back.
    """

    def __init__(self) -> None:
        threads: dict[str, int] = {}
        # Methods of the dictionary itself: a call of a Python function would take longer than both together.
        self.taken_by, self.give_back = threads.setdefault, threads.clear

    def __reduce__(self) -> "tuple[type[Use], tuple[()]]":
        return Use, ()


Own = TypeVar("Own", bound="OverBatch")


def one_thread(method: Callable[Concatenate[Own, P], R]) -> Callable[Concatenate[Own, P], R]:
    """Let a method of an environment run whole or not at all, in one thread at a time.

    Compiled code runs without the interpreter's lock: two threads in one environment would mix their numbers silently.
    So the method raises a RuntimeError while another thread is within such a method. After an interrupt it has not
    begun, or has changed all that it changes, and its result is lost.
    """

    @undivided
    @functools.wraps(method)
    def run(self: Own, /, *arguments: P.args, **keywords: P.kwargs) -> R:
        use, thread = self._use, threading.get_ident()
        if use.taken_by("thread", thread) != thread:
            raise in_use(self, method.__name__)
        try:
            return method(self, *arguments, **keywords)
        finally:
            use.give_back()

    return run


def in_use(environment: "OverBatch", method: str) -> RuntimeError:
    """Return the error of a method that was called while another thread was within the environment."""
    return RuntimeError(
        f"{type(environment).__name__}.{method}() was called while another thread uses the same environment; "
        "give every thread an environment of its own, or let a lock keep them apart"
    )


class Snapshot(NamedTuple):
    """Complete state of an environment's episodes."""

    of: str  # class of the environment
    batch: BatchSnapshot
    frames: Any  # what it has drawn so far; None without rendering


class OverBatch:
    """An environment whose episodes are played in a batch."""

    metadata: dict[str, Any]
    _step_limit: int | None = None
    _spec: EnvSpec | None = None

    def _open(
        self, arguments: Mapping[str, Any], render_mode: str | None, num_envs: int = 1, n_threads: int | None = None
    ) -> "tuple[gym.spaces.Box[np.float32], gym.spaces.Box[np.float32]]":
        """Make settings, batch and frames; return the observation space and the action space of one episode.

        A TypeError names an argument that is unknown, a ValueError a value that is not allowed.
        """
        settings = [field.name for field in dataclasses.fields(EnvSettings)]
        if unknown := [name for name in arguments if name not in settings]:
            known = [*settings, *list(inspect.signature(type(self)).parameters)[:-1]]
            # Python's own words come first: TorchRL looks for them to find out which arguments an environment takes.
            raise TypeError(
                f"{type(self).__name__}.__init__() got an unexpected keyword argument {unknown[0]!r}; "
                f"known settings: {', '.join(known)}{did_you_mean(unknown[0], known)}"
            )
        if render_mode is not None:
            require_choice(f"render_mode of {type(self).__name__}", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.settings = EnvSettings(**arguments)
        self._batch = EnvBatch(self.settings, num_envs, n_threads)
        self._use = Use()
        fps = max(1, round(1.0 / self.settings.step_s))
        self.metadata = {**self.metadata, "render_fps": fps}
        self._frames: BatchFrames | None = None
        if render_mode is not None:
            self._frames = BatchFrames(self._batch, opens_window=render_mode == "human", fps=fps)
        bound = np.full(self._batch.n_observation, observation.OBSERVATION_BOUND, dtype=np.float32)
        high = np.ones(self._batch.n_action, dtype=np.float32)
        return gym.spaces.Box(-bound, bound, dtype=np.float32), gym.spaces.Box(-high, high, dtype=np.float32)

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's description of this environment; its `max_episode_steps` follows `duration_s`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        version = self.settings.task.version
        if spec is not None and spec.id in TASKS and TASKS[spec.id].version != version:
            raise ValueError(f"{spec.id} cannot be made with version = {version!r}: leave it out, the id has one")
        if spec is not None and spec.max_episode_steps is None:
            # Empty because the environment is registered without a time limit: it ends episodes itself.
            n_steps = self._batch.n_steps_of_episode
            spec = dataclasses.replace(spec, max_episode_steps=min(self._step_limit or n_steps, n_steps))
        self._spec = spec

    @one_thread
    def snapshot(self) -> Any:
        """Return a copy of every episode's complete state, for :meth:`restore`; the generators are not part of it.

        An environment that renders adds what it has drawn so far.
        """
        frames = None if self._frames is None else self._frames.snapshot()
        return Snapshot(type(self).__name__, self._batch.snapshot(), frames)

    @one_thread
    def restore(self, snapshot: Any) -> None:
        """Go back to a :meth:`snapshot`: what follows is then the same, bit for bit.

        A ValueError refuses what is no snapshot, or that of an environment whose settings, other than suite, split and
        scenario, differ; nothing has changed then.
        """
        name = type(self).__name__
        if not isinstance(snapshot, Snapshot) or snapshot.of != name:
            raise ValueError(f"restore() takes what snapshot() of a {name} returned, got {type(snapshot).__name__}")
        self._batch.restore(snapshot.batch)
        if self._frames is not None:
            self._frames.restore(snapshot.frames)

    @property
    def batch(self) -> EnvBatch:
        """The simulator, observations and costs of every episode."""
        return self._batch

    @property
    def observation_names(self) -> list[str]:
        """Names and units of the entries of one episode's observation."""
        return self._batch.observation_names

    @property
    def action_names(self) -> list[str]:
        """Names of the numbers of one episode's action, such as "wtg0.k"."""
        return self._batch.action_names


def as_actions(actions: Any, shape: tuple[int, ...]) -> Floats:
    """Return actions as floats of a shape; anything but that many real numbers raises a ValueError."""
    if type(actions) is np.ndarray and actions.dtype == np.float32 and actions.shape == shape:
        return actions.astype(np.float64, order="C")
    allowed = f"the action must be real numbers in -1 … 1 of shape {shape}"
    try:
        array = np.asarray(actions)
        if array.dtype.kind == "O" and all(isinstance(value, numbers.Real) for value in array.flat):
            array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{allowed}: {error}") from error
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{allowed}, got {array.dtype} values: {actions!r:.60}")
    if array.shape != shape:
        raise ValueError(f"{allowed}, got shape {array.shape}")
    return np.ascontiguousarray(array, dtype=np.float64)


def check_options(options: dict[str, Any] | None, allowed: Sequence[str]) -> dict[str, Any]:
    """Return the options of `reset`; unknown ones raise a ValueError."""
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(f"reset options must be a dictionary with keys out of {', '.join(allowed)}, got {options!r}")
    require_known("reset options", options or {}, allowed)
    return options or {}


def warn_of_no_render_mode() -> None:
    """Warn that there is nothing to render with."""
    gym.logger.warn('render() draws nothing: the environment was made without a render_mode, such as "rgb_array"')
