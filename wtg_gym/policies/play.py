"""Playing a policy: its actions are asked for and checked step by step, for many scenarios side by side."""

import contextlib
import dataclasses
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import printable
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies.entry import Entry, Policy
from wtg_gym.policies.policy_process import NotIsolatedError, OnnxPolicy, PolicyError


@contextlib.contextmanager
def started_batch(
    entry: Entry, settings: EnvSettings, episodes: Sequence[Scenario] | Sequence[int], n_threads: int | None = None
) -> Iterator[tuple[EnvBatch, Sequence[Scenario]]]:
    """Start one environment per scenario, or seed of the settings' suite, with an entry's own law and modes.

    Yields the batch and its scenarios. A scenario without an equilibrium under the law is a PolicyError.
    """
    entry_settings = dataclasses.replace(settings, **entry.env_arguments, reward="cost")
    with contextlib.closing(EnvBatch(entry_settings, len(episodes), n_threads)) as batch:
        drawn = not isinstance(episodes[0], Scenario)
        scenarios: Any = batch.scenarios(cast(Sequence[int], episodes)) if drawn else episodes
        try:
            batch.start(range(len(episodes)), scenarios)
        except ValueError as error:
            raise PolicyError(f"entry {entry.label!r}: {error}") from error
        yield batch, scenarios


def play(entry: Entry, batch: EnvBatch) -> Iterator[tuple[npt.NDArray[np.bool_], npt.NDArray[np.float64]]]:
    """Play the started episodes to their ends; yield which environments made a step, (num_envs,), and its actions.

    The process of an :class:`OnnxPolicy` is a new one. Actions (num_envs, n_action) are zero once an episode is over. A
    policy that raises, ends, takes too long or returns no action is a PolicyError.
    """
    running = np.ones(batch.num_envs, dtype=np.bool_)
    state: Any = None
    step = 0
    with entry.policy if isinstance(entry.policy, OnnxPolicy) else contextlib.nullcontext():
        while running.any():
            actions = np.zeros((batch.num_envs, batch.n_action))
            if entry.policy is not None:
                actions, state = answer(entry, batch, state, step, running)
            batch.step(actions)
            yield running, actions
            running = ~np.logical_or(*batch.ended())
            step += 1


def answer(
    entry: Entry, batch: EnvBatch, state: Any, step: int, running: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.float64], Any]:
    """Return the policy's checked actions (num_envs, n_action) in a step, and its next recurrent state."""
    # For a policy of one group, each is an environment: local observations are those of one group after the other.
    n_parts = batch.n_wtg if entry.per_group else 1
    policy, shape = cast(Policy, entry.policy), (batch.num_envs * n_parts, batch.n_action // n_parts)
    seen, start = batch.observations.reshape(shape[0], -1).copy(), np.full(shape[0], step == 0)
    try:
        answer = policy.predict(seen, state=state, episode_start=start, deterministic=True)
    except NotIsolatedError:
        raise
    except (Exception, SystemExit) as error:
        reason = str(error) if isinstance(error, PolicyError) else f"predict() raised {_described(error)}"
        raise PolicyError(f"entry {entry.label!r}, step {step}: {reason}") from error
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise _complaint(entry, step, "predict() must return (actions, state)", type(answer).__name__)
    try:
        actions = np.asarray(answer[0])
    # A tensor with gradients raises a RuntimeError, other libraries' arrays raise other errors.
    except Exception as error:
        raise _complaint(entry, step, "actions must be an array of numbers", _described(error)) from error
    if actions.dtype.kind not in "biuf":
        raise _complaint(entry, step, "actions must be an array of numbers", f"one of {actions.dtype}")
    if actions.shape != shape:
        raise _complaint(entry, step, f"actions need shape {shape} (environments, values)", f"shape {actions.shape}")
    actions = actions.astype(np.float64).reshape(batch.num_envs, batch.n_action)
    # The action of an episode that is over has no effect.
    actions[~running] = 0.0
    for env in np.flatnonzero(~np.isfinite(actions).all(axis=1))[:1]:
        scenario = f"{actions[env].tolist()} in the scenario of seed {batch.scenario_seeds[env]}"
        raise _complaint(entry, step, f"actions of shape {actions.shape} must be finite, -1 … 1", scenario)
    return actions, answer[1]


def _complaint(entry: Entry, step: int, expected: str, got: str) -> PolicyError:
    return PolicyError(f"entry {entry.label!r}, step {step}: {expected}, got {got}")


def _described(error: BaseException) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    message = printable(" ".join(str(error).split())[:200])
    return f"{type(error).__name__}: {message} ({Path(place.filename).name}:{place.lineno})"
