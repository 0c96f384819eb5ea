"""The gate: every check of a submission, in order, up to the first that it does not pass."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation.entries import ENTRY_FILE, POLICY_FILE, Entry
from wtg_gym.evaluation.onnx_policy import Floats
from wtg_gym.files import sha256
from wtg_gym.submissions.folder import EntryFile, parse_entry, read_files, settings_of
from wtg_gym.submissions.isolation import IsolatedPolicy, NotIsolatedError
from wtg_gym.submissions.probes import PROBES, rollout

_FILE_CHECKS = ("file format", "model", "constants", "operators", "signature", "size")
#: All checks in their order; those of the file are made where nothing of it is run.
CHECKS = ("folder", "entry.toml", *_FILE_CHECKS, "loading", *(name for name, _ in PROBES), "rollout")
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

    def open(self, *, weak: bool = False) -> tuple[Entry, IsolatedPolicy]:
        """Return an accepted submission as an entry, whose policy plays in a process of its own and must be closed."""
        assert self.accepted and self.entry is not None
        policy = IsolatedPolicy(self.content, *_widths(self.entry), weak=weak)
        entry = Entry(
            name=self.entry.name,
            policy=policy,
            action_mode=self.entry.action_mode,
            observation_mode=self.entry.observation_mode,
            description=self.entry.description,
            source=", ".join(self.entry.authors),
            fingerprint=policy.sha256,
            training_seed=self.entry.training_seed,
        )
        return entry, policy


def check_submission(folder: Path, *, weak: bool = False, probes: bool = True) -> Report:
    """Return what the gate says about a folder; nothing of it is run in this process.

    Args:
        folder: with entry.toml and policy.onnx.
        weak: go on where this system cannot isolate a process completely.
        probes: False leaves out the checks on made-up observations, for a folder that has passed them before.

    Raises:
        NotIsolatedError: this system cannot, and `weak` is not set.
    """
    done: list[Check] = []
    entry: EntryFile | None = None
    content: bytes = b""
    policy: _Played = _Played()
    try:
        files = read_files(folder)
        content = files[POLICY_FILE]
        done.append(Check("folder", PASSED, ", ".join(f"{name} {len(data)} bytes" for name, data in files.items())))
        entry = parse_entry(files[ENTRY_FILE])
        seed = f"training seed {entry.training_seed}"
        done.append(Check("entry.toml", PASSED, f"{entry.name}, {seed}, {entry.action_mode}, {entry.observation_mode}"))
        policy = _check_policy(content, entry, weak, probes)
        done += policy.checks
    except NotIsolatedError:
        raise
    except ValueError as error:
        done.append(Check(CHECKS[len(done)], REFUSED, str(error)))
    made = {check.name for check in done}
    if done[-1].verdict == REFUSED:
        done += [Check(name, NOT_REACHED) for name in CHECKS if name not in made]
    return Report(
        folder=folder,
        checks=tuple(done),
        entry=entry,
        sha256=sha256(content) if content else None,
        content=content,
        notes=policy.notes,
        actions=policy.actions,
    )


def _widths(entry: EntryFile) -> tuple[int, int]:
    """Return the widths of observations and actions of the benchmark's plant in an entry's modes."""
    lanes = TaskLanes(settings_of(entry), 1, 1)
    try:
        return lanes.n_observation, lanes.n_action
    finally:
        lanes.simulator.close()


@dataclass
class _Played:
    """What was found out about a policy in its process."""

    checks: list[Check] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    actions: Floats | None = None

    def add(self, name: str, reason: str, *, passed: bool = True) -> bool:
        self.checks.append(Check(name, PASSED if passed else REFUSED, reason))
        return passed


def _check_policy(content: bytes, entry: EntryFile, weak: bool, probes: bool) -> _Played:
    found = _Played()
    try:
        policy = IsolatedPolicy(content, *_widths(entry), weak=weak)
    except NotIsolatedError:
        raise
    except ValueError as error:
        # The process ended while it read the file.
        found.add(_FILE_CHECKS[0], str(error), passed=False)
        return found
    with policy:
        found.notes = tuple(policy.missing)
        if all(found.add(name, reason, passed=passed) for name, passed, reason in policy.checks):
            _play(policy, entry, found, probes)
    return found


def _play(policy: IsolatedPolicy, entry: EntryFile, found: _Played, probes: bool) -> None:
    """Ask a policy that is loaded."""
    if not found.add("loading", policy.error or "onnxruntime runs it", passed=not policy.error):
        return
    name = ""
    try:
        for name, probe in PROBES if probes else ():
            found.add(name, probe(policy))
        name = "rollout"
        found.actions = rollout(policy, entry.action_mode, entry.observation_mode)
        steps, lanes, _ = found.actions.shape
        found.add(name, f"{lanes} scenarios of the validation split, up to {steps} steps")
    except ValueError as error:
        found.add(name, str(error), passed=False)


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
