"""The gate of submissions: every check of a folder, in order, up to the first that it does not pass."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import sha256
from wtg_gym.physics.tracking_law import get_law
from wtg_gym.policies.entry import Entry, Policy
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE, entry_arguments, load_entries, policy_folders, policy_name
from wtg_gym.policies.names import BASELINES, plain_name
from wtg_gym.policies.onnx_policy import OnnxPolicy
from wtg_gym.policies.play import play, started_lanes
from wtg_gym.policies.policy_process import NotIsolatedError
from wtg_gym.policies.submission_folder import EntryFile, parse_submission, read_files
from wtg_gym.tasks import TASKS, V1
from wtg_gym.tasks.episode import ACTION_MODES

Floats = npt.NDArray[np.float64]
#: All checks in their order.
CHECKS = ("folder", "entry.toml", "loading", "speed", "rollout", "repeated")
PASSED, REFUSED, NOT_REACHED = "passed", "refused", "not reached"
#: How long a policy may take for one scenario's step [s].
ANSWER_S = 1e-3
#: Scenarios that are answered then, as many as a process ever plays: a policy that keeps to its limits here does so
#: wherever it is played later. The fastest of five steps counts, as a busy machine slows down the others.
_TIMED_LANES, _TIMES = 256, 5
_ROLLOUT_LANES = 32
#: Two policies whose actions, [-1, 1], differ by no more than this (root mean square over the rollout) are copies. The
#: shipped training seeds that are most alike differ by more than three times as much.
COPY_TOLERANCE = 5e-3


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
    shipped: bool = False  # whether the package has the same folder among its policies
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
        return Entry(policy=policy, fingerprint=policy.sha256, **entry_arguments(dataclasses.asdict(self.entry)))

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
        name = folder.resolve().name
        others = policy_folders()
        report.shipped = any(each.name == name and _holds(each, files) for each in others)
        if report.shipped:
            # Itself, and the seeds of its row.
            others = [each for each in others if policy_name(each) != policy_name(folder)]
        _check_not_found("the folder's name", name, others)
        report.content = files[POLICY_FILE]
        passed(", ".join(f"{name} {len(data)} bytes" for name, data in files.items()))
        entry = report.entry = parse_submission(files[ENTRY_FILE])
        _check_not_found("name", entry.name, others)
        seed = f"training seed {entry.training_seed}"
        passed(f"{entry.name}, {seed}, {entry.action_mode}, {entry.observation_mode}")
        policy = OnnxPolicy(report.content, isolated=not weak)
        with policy:
            report.notes = policy.not_isolated
            passed(_check_widths(policy, entry))
            passed("passed before" if rollout_only else check_speed(policy))
        actions = report.actions = rollout(policy, entry)
        _check_no_baseline(actions, entry)
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


def _holds(folder: Path, files: Mapping[str, bytes]) -> bool:
    """Return whether a folder holds the same entry and policy."""
    own = ((folder / name, files[name]) for name in (ENTRY_FILE, POLICY_FILE))
    return all(path.is_file() and path.read_bytes() == content for path, content in own)


def _check_not_found(what: str, name: str, folders: Sequence[Path]) -> None:
    """Refuse a name by which, or by what looks like it, one of the package's policies is found."""
    for folder in folders:
        for known in (folder.name, policy_name(folder)):
            if known is not None and plain_name(known) == plain_name(name):
                raise ValueError(
                    f"{what} must not be, or look like, that of the policy {known} in agents/policies/{folder.name}, "
                    f"which comes with the package; got {name}"
                )


def _check_no_baseline(actions: Floats, entry: EntryFile) -> None:
    """Refuse a policy that plays as a baseline does on the same law: the law itself, or a feedback made by hand."""
    known = {entry.strategy: (np.zeros_like(actions), entry.action_mode)}
    for baseline in load_entries(BASELINES, task=TASKS[entry.environment]):
        if baseline.policy is not None and baseline.law == get_law(entry.strategy):
            known[baseline.name] = _rollout_of(baseline, _ROLLOUT_LANES), baseline.action_mode
    for name, (others, mode) in known.items():
        if action_difference(actions, others, entry.action_mode, mode) <= COPY_TOLERANCE:
            raise ValueError(
                f"it plays as the baseline {name}: its actions differ from those by no more than {COPY_TOLERANCE:g} "
                f"(root mean square) in {actions.shape[1]} scenarios"
            )


@functools.cache
def _rollout_of(baseline: Entry, n_lanes: int) -> Floats:
    """Return the actions of a baseline's policy in the gate's scenarios."""
    assert baseline.policy is not None and n_lanes == _ROLLOUT_LANES
    return rollout(baseline.policy, baseline)


def action_difference(one: Floats, other: Floats, mode: str, other_mode: str) -> float:
    """Return the root mean square of the difference of two rollouts' actions, (steps, lanes, n_action).

    It is over the steps that both have and what either of them modulates; an action that one has not is zero.
    """
    steps = min(len(one), len(other))
    used = np.logical_or(ACTION_MODES[mode], ACTION_MODES[other_mode])
    difference = _on_k_and_tau(one[:steps], mode) - _on_k_and_tau(other[:steps], other_mode)
    return float(np.sqrt(np.mean(np.square(difference[..., used]))))


def _on_k_and_tau(actions: Floats, mode: str) -> Floats:
    """Return actions (steps, lanes, n_action) of a mode as those on k and τ of each group, (…, n_wtg, 2)."""
    modulated = np.flatnonzero(ACTION_MODES[mode])
    own = actions.reshape(*actions.shape[:2], -1, len(modulated))
    both = np.zeros((*own.shape[:3], 2))
    both[..., modulated] = own
    return both


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


def rollout(policy: Policy, described: Entry | EntryFile, *, backwards: bool = False) -> Floats:
    """Return a policy's actions in validation scenarios of the standard suite, within ±1, (steps, lanes, n_action).

    An :class:`OnnxPolicy` plays in a new process. A lane's actions are zero once its episode is over. `backwards` plays
    the last scenario first; the actions come in the usual order all the same. An action that is not finite, or a policy
    that cannot answer, is a ValueError.
    """
    keys = ("action_mode", "observation_mode", "per_group", "environment", "strategy")
    entry = Entry(name="the policy", policy=policy, **{key: getattr(described, key) for key in keys})
    settings = EnvSettings(version=TASKS[described.environment or V1.env_id].version, split="validation")
    order = -1 if backwards else 1
    seeds = settings.resolved_suite.validation[:_ROLLOUT_LANES][::order]
    actions: list[Floats] = []
    with started_lanes(entry, settings, seeds) as (lanes, _):
        for _step in play(entry, lanes, actions):
            pass
    return np.clip(np.stack(actions), -1.0, 1.0)[:, ::order]
