"""The gate: every check of a submission, in order, up to the first that it does not pass."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation.entries import ENTRY_FILE, POLICY_FILE, Entry
from wtg_gym.evaluation.onnx_policy import Floats, OnnxPolicy
from wtg_gym.evaluation.policy_process import NotIsolatedError
from wtg_gym.files import sha256
from wtg_gym.submissions.folder import EntryFile, parse_entry, read_files, settings_of
from wtg_gym.submissions.probes import check_speed, rollout

#: All checks in their order.
CHECKS = ("folder", "entry.toml", "loading", "speed", "rollout", "repeated")
PASSED, REFUSED, NOT_REACHED = "passed", "refused", "not reached"


@dataclass(frozen=True)
class Check:
    """One check: its name, "passed", "refused" or "not reached", and what was found."""

    name: str
    verdict: str
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class Report:
    """What the gate says about a folder.

    Args:
        folder: the folder.
        checks: every check of :data:`CHECKS`.
        entry: what entry.toml says; None where it was not read.
        sha256: of policy.onnx; None where it was not read.
        content: policy.onnx as it was checked.
        notes: what this system could not isolate.
        actions: of the rollout, see :func:`wtg_gym.submissions.probes.rollout`; None where it was not reached.
    """

    folder: Path
    checks: tuple[Check, ...]
    entry: EntryFile | None
    sha256: str | None
    content: bytes
    notes: tuple[str, ...] = ()
    actions: Floats | None = field(default=None, compare=False, repr=False)

    @property
    def refusal(self) -> Check | None:
        """Return the check that it did not pass; None if it is accepted."""
        return next((check for check in self.checks if check.verdict == REFUSED), None)

    @property
    def accepted(self) -> bool:
        """Return whether every check was passed."""
        return self.refusal is None

    def played(self, *, weak: bool = False) -> Entry:
        """Return an accepted submission as an entry; `weak` is as for :func:`check_submission`."""
        assert self.accepted and self.entry is not None
        policy = OnnxPolicy(self.content, isolated=not weak)
        return Entry(
            name=self.entry.name,
            policy=policy,
            action_mode=self.entry.action_mode,
            observation_mode=self.entry.observation_mode,
            description=self.entry.description,
            source=", ".join(self.entry.authors),
            fingerprint=policy.sha256,
            training_seed=self.entry.training_seed,
        )


def check_submission(folder: Path, *, weak: bool = False, rollout_only: bool = False) -> Report:
    """Return what the gate says about a folder; its policy is played in a process of its own.

    Args:
        folder: with entry.toml and policy.onnx.
        weak: go on where this system cannot isolate a process completely.
        rollout_only: leave out the checks of speed and repetition, for a folder that has passed them before.

    Raises:
        NotIsolatedError: this system cannot, and `weak` is not set.
    """
    found = _Found()
    try:
        files = read_files(folder)
        found.content = files[POLICY_FILE]
        found.add("folder", ", ".join(f"{name} {len(data)} bytes" for name, data in files.items()))
        entry = found.entry = parse_entry(files[ENTRY_FILE])
        seed = f"training seed {entry.training_seed}"
        found.add("entry.toml", f"{entry.name}, {seed}, {entry.action_mode}, {entry.observation_mode}")
        _play(OnnxPolicy(found.content, isolated=not weak), entry, found, rollout_only)
    except NotIsolatedError:
        raise
    except ValueError as error:
        found.checks.append(Check(CHECKS[len(found.checks)], REFUSED, str(error)))
        found.checks += [Check(name, NOT_REACHED) for name in CHECKS[len(found.checks) :]]
    return Report(
        folder=folder,
        checks=tuple(found.checks),
        entry=found.entry,
        sha256=sha256(found.content) if found.content else None,
        content=found.content,
        notes=found.notes,
        actions=found.actions,
    )


@dataclass
class _Found:
    """What was found out about a folder so far."""

    checks: list[Check] = field(default_factory=list)
    content: bytes = b""
    entry: EntryFile | None = None
    notes: tuple[str, ...] = ()
    actions: Floats | None = None

    def add(self, name: str, reason: str) -> None:
        self.checks.append(Check(name, PASSED, reason))


def _play(policy: OnnxPolicy, entry: EntryFile, found: _Found, rollout_only: bool) -> None:
    """Ask a policy; a ValueError says what is wrong with it."""
    modes = entry.action_mode, entry.observation_mode
    with policy:
        found.notes = policy.not_isolated
        wanted, (n_observation, n_action, *states) = _widths(entry), policy.widths
        if (n_observation, n_action) != wanted:
            raise ValueError(
                f"it takes {n_observation} observations and gives {n_action} actions; in its modes there are "
                f"{wanted[0]} and {wanted[1]}"
            )
        found.add("loading", f"onnxruntime runs it, {n_observation} observations, {n_action} actions, states {states}")
        found.add("speed", "passed before" if rollout_only else check_speed(policy))
    actions = found.actions = rollout(policy, *modes)
    n_steps, n_lanes, _ = actions.shape
    found.add("rollout", f"{n_lanes} scenarios of the validation split, up to {n_steps} steps")
    if not rollout_only and not np.array_equal(actions, rollout(policy, *modes, backwards=True)):
        raise ValueError("the same scenarios in another order, in another process, give other actions")
    found.add("repeated", "passed before" if rollout_only else "the same actions to the last bit, in another order")


def _widths(entry: EntryFile) -> tuple[int, int]:
    """Return the widths of observations and actions of the benchmark's plant in an entry's modes."""
    lanes = TaskLanes(settings_of(entry), 1, 1)
    try:
        return lanes.n_observation, lanes.n_action
    finally:
        lanes.simulator.close()


def as_json(report: Report) -> dict[str, object]:
    """Return a report as JSON-ready data."""
    return {
        "folder": str(report.folder),
        "accepted": report.accepted,
        "sha256": report.sha256,
        "entry": None if report.entry is None else dataclasses.asdict(report.entry),
        "checks": [dataclasses.asdict(check) for check in report.checks],
        "not_isolated": list(report.notes),
    }


__all__ = ["CHECKS", "NOT_REACHED", "PASSED", "REFUSED", "Check", "Report", "as_json", "check_submission"]
