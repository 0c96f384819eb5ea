"""The gate of submissions: every check of a folder, in order, up to the first that it does not pass."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import sha256
from wtg_gym.policies.entry import Entry
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE
from wtg_gym.policies.onnx_policy import Floats, OnnxPolicy
from wtg_gym.policies.play import play, started_lanes
from wtg_gym.policies.policy_process import NotIsolatedError
from wtg_gym.policies.submission_folder import EntryFile, parse_entry, read_files
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import BENCHMARKS, V0

#: All checks in their order.
CHECKS = ("folder", "entry.toml", "loading", "speed", "rollout", "repeated")
PASSED, REFUSED, NOT_REACHED = "passed", "refused", "not reached"
#: How long a policy may take for one scenario's step [s].
ANSWER_S = 1e-3
#: Scenarios that are answered then, as many as a process ever plays: a policy that keeps to its limits here does so
#: wherever it is played later. The fastest of five steps counts, as a busy machine slows down the others.
_TIMED_LANES, _TIMES = 256, 5
_ROLLOUT_LANES = 32


@dataclass(frozen=True)
class Check:
    """One check: its name, "passed", "refused" or "not reached", and the reason or what was found."""

    name: str
    verdict: str
    reason: str = ""


@dataclass
class Report:
    """The gate's report on a folder."""

    folder: Path
    checks: list[Check] = field(default_factory=list)  # every check of :data:`CHECKS`
    entry: EntryFile | None = None  # content of entry.toml; None where it was not read
    content: bytes = b""  # policy.onnx as it was checked; empty where it was not read
    notes: tuple[str, ...] = ()  # what this system could not isolate
    #: Of the rollout, see :func:`rollout`; None where it was not reached.
    actions: Floats | None = field(default=None, compare=False, repr=False)

    @property
    def refusal(self) -> Check | None:
        """Return the check that it did not pass; None if it is accepted."""
        return next((check for check in self.checks if check.verdict == REFUSED), None)

    @property
    def accepted(self) -> bool:
        """Return whether every check was passed."""
        return self.refusal is None

    @property
    def sha256(self) -> str | None:
        """Return that of policy.onnx; None where it was not read."""
        return sha256(self.content) if self.content else None

    def played(self, *, weak: bool = False) -> Entry:
        """Return an accepted submission as an entry; `weak` is as for :func:`check_submission`."""
        assert self.accepted and self.entry is not None
        policy = OnnxPolicy(self.content, isolated=not weak)
        same = ("name", "action_mode", "observation_mode", "environment", "strategy", "description", "training_seed")
        data: dict[str, Any] = {key: getattr(self.entry, key) for key in same}
        return Entry(policy=policy, source=", ".join(self.entry.authors), fingerprint=policy.sha256, **data)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON-ready data."""
        return {
            "folder": str(self.folder),
            "accepted": self.accepted,
            "sha256": self.sha256,
            "entry": None if self.entry is None else dataclasses.asdict(self.entry),
            "checks": [dataclasses.asdict(check) for check in self.checks],
            "not_isolated": list(self.notes),
        }


def check_submission(folder: Path, *, weak: bool = False, rollout_only: bool = False) -> Report:
    """Return the gate's report on a folder; its policy is played in a process of its own.

    Args:
        folder: with entry.toml and policy.onnx.
        weak: go on where this system cannot isolate a process completely.
        rollout_only: leave out the checks of speed and repetition, for a folder that has passed them before.

    Raises:
        NotIsolatedError: this system cannot, and `weak` is not set.
    """
    report = Report(folder)

    def passed(reason: str) -> None:
        report.checks.append(Check(CHECKS[len(report.checks)], PASSED, reason))

    try:
        files = read_files(folder)
        report.content = files[POLICY_FILE]
        passed(", ".join(f"{name} {len(data)} bytes" for name, data in files.items()))
        entry = report.entry = parse_entry(files[ENTRY_FILE])
        seed = f"training seed {entry.training_seed}"
        passed(f"{entry.name}, {seed}, {entry.action_mode}, {entry.observation_mode}")
        policy = OnnxPolicy(report.content, isolated=not weak)
        with policy:
            report.notes = policy.not_isolated
            passed(_check_widths(policy, entry))
            passed("passed before" if rollout_only else check_speed(policy))
        actions = report.actions = rollout(policy, entry)
        passed(f"{_ROLLOUT_LANES} scenarios of the validation split, up to {len(actions)} steps")
        if not rollout_only and not np.array_equal(actions, rollout(policy, entry, backwards=True)):
            raise ValueError("the same scenarios in another order, in another process, give other actions")
        passed("passed before" if rollout_only else "the same actions to the last bit, in another order")
    except NotIsolatedError:
        raise
    except ValueError as error:
        report.checks.append(Check(CHECKS[len(report.checks)], REFUSED, str(error)))
        report.checks += [Check(name, NOT_REACHED) for name in CHECKS[len(report.checks) :]]
    return report


def _check_widths(policy: OnnxPolicy, entry: EntryFile) -> str:
    """Compare a policy's widths with those of the benchmark's plant in its modes."""
    wanted = entry.widths()
    n_observation, n_action, *states = policy.widths
    if (n_observation, n_action) != wanted:
        raise ValueError(
            f"it takes {n_observation} observations and gives {n_action} actions; in its modes there are "
            f"{wanted[0]} and {wanted[1]}"
        )
    return f"onnxruntime runs it, {n_observation} observations, {n_action} actions, states {states}"


def check_speed(policy: OnnxPolicy) -> str:
    """Return in words how long a policy takes for a scenario's step; a ValueError if that is too long."""
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (_TIMED_LANES, policy.widths[0]))
    # Opens the sessions, which is not timed.
    _, state = policy.predict(observations)
    times = []
    for _ in range(_TIMES):
        began = time.perf_counter()
        policy.predict(observations, state, np.zeros(_TIMED_LANES, dtype=np.bool_))
        times.append(time.perf_counter() - began)
    taken_ms, allowed_ms = 1e3 * min(times) / _TIMED_LANES, 1e3 * ANSWER_S
    if taken_ms > allowed_ms:
        raise ValueError(f"more than {allowed_ms:g} ms for an action, in the fastest of {_TIMES} steps")
    return f"{taken_ms:.3f} ms for an action, allowed are {allowed_ms:g}"


def rollout(policy: OnnxPolicy, described: Entry | EntryFile, *, backwards: bool = False) -> Floats:
    """Play validation scenarios of the standard suite in a new process.

    The actions come back within ±1, (steps, lanes, n_action).

    A lane's actions are zero once its episode is over.

    Args:
        policy: the policy.
        described: has its modes, environment and strategy.
        backwards: play the last scenario first; the actions come in the usual order all the same.

    Raises:
        ValueError: an action is not finite, or the policy cannot answer.
    """
    listener = _Listener(policy)
    keys = ("action_mode", "observation_mode", "environment", "strategy")
    entry = Entry(name="the policy", policy=listener, **{key: getattr(described, key) for key in keys})
    settings = EnvSettings(version=BENCHMARKS[described.environment or V0.env_id].version, split="validation")
    order = -1 if backwards else 1
    seeds = get_suite(settings.suite).validation[:_ROLLOUT_LANES][::order]
    with started_lanes(entry, settings, seeds) as (lanes, _), policy:
        for step, running in enumerate(play(entry, lanes)):
            listener.actions[step][~running] = 0.0
    return np.clip(np.stack(listener.actions), -1.0, 1.0)[:, ::order]


class _Listener:
    """Passes a policy's answers on and keeps the actions."""

    def __init__(self, policy: OnnxPolicy) -> None:
        self._policy = policy
        self.actions: list[Floats] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats, Any]:
        """Return the policy's answer."""
        action, state = self._policy.predict(observation, state, episode_start, deterministic)
        self.actions.append(action.copy())
        return action, state
