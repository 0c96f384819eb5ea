"""The gate of submissions: every check of a folder, up to the first that it does not pass, and of several together."""

import dataclasses
import itertools
import timeit
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import sha256
from wtg_gym.names import plain_name
from wtg_gym.policies import entry_folder
from wtg_gym.policies.entry import Entry, row_conflict
from wtg_gym.policies.play import play, started_batch
from wtg_gym.policies.policy_process import NotIsolatedError, OnnxPolicy
from wtg_gym.tasks import TASKS, V1

#: All checks in their order.
CHECKS = ("folder", "entry.toml", "loading", "speed", "rollout", "repeated")
PASSED, REFUSED, NOT_REACHED = "passed", "refused", "not reached"
#: How long a policy may take for one scenario's step [s].
ANSWER_S = 1e-3
#: Scenarios that are answered then, as many as a process ever plays: a policy that keeps to its limits here does so
#: wherever it is played later. The fastest of five steps counts, as a busy machine slows down the others.
_TIMED_ENVS, _TIMES = 256, 5
_ROLLOUT_ENVS = 32


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
    made: list[Check] = field(default_factory=list)  # the checks up to the first that it does not pass
    entry: Entry | None = None  # with the policy, to be played as it was checked; None where entry.toml was not read
    content: bytes = b""  # policy.onnx as it was checked; empty where it was not read
    notes: tuple[str, ...] = ()  # what this system could not isolate
    shipped: bool = False  # whether the package has the same folder among its policies

    @property
    def checks(self) -> list[Check]:
        """Return every check of :data:`CHECKS`."""
        return [*self.made, *(Check(name, NOT_REACHED) for name in CHECKS[len(self.made) :])]

    @property
    def refusal(self) -> Check | None:
        """Return the check that it did not pass; None if it is accepted."""
        return next((check for check in self.made if check.verdict == REFUSED), None)

    @property
    def accepted(self) -> bool:
        """Return whether every check that was made was passed."""
        return self.refusal is None

    @property
    def sha256(self) -> str | None:
        """Return that of policy.onnx; None where it was not read."""
        return sha256(self.content) if self.content else None

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON-ready data."""
        return {
            "folder": str(self.folder),
            "accepted": self.accepted,
            "sha256": self.sha256,
            "entry": None if self.entry is None else self.entry.to_dict(),
            "checks": [dataclasses.asdict(check) for check in self.checks],
            "not_isolated": list(self.notes),
        }


def read_submission(folder: Path) -> Report:
    """Return the gate's report on the files of a folder and its entry.toml; its policy is not played."""
    return check_submission(folder, CHECKS[:2])


def check_submission(folder: Path, checks: Sequence[str] = CHECKS, *, weak: bool = False) -> Report:
    """Return the gate's report on a folder, of the first so many checks, up to one that is not passed.

    The policy is played in a process of its own. Where this system cannot isolate that process, it is a
    NotIsolatedError; with `weak` it goes on all the same.
    """
    report = Report(folder)
    findings = _findings(report, weak=weak)
    for name in checks:
        try:
            report.made.append(Check(name, PASSED, next(findings)))
        except NotIsolatedError:
            raise
        except ValueError as error:
            report.made.append(Check(name, REFUSED, str(error)))
            break
    return report


def _findings(report: Report, *, weak: bool) -> Iterator[str]:
    """Yield what each of the :data:`CHECKS` finds; the ValueError of one is the reason why it is not passed."""
    files = entry_folder.read_files(report.folder)
    name = report.folder.resolve().name
    others = entry_folder.policy_folders()
    submitted = {file: files[file] for file in (entry_folder.ENTRY_FILE, entry_folder.POLICY_FILE)}
    report.shipped = any(
        other.name == name and {file: (other / file).read_bytes() for file in submitted} == submitted
        for other in others
    )
    if report.shipped:
        # Itself, and the seeds of its row.
        own = entry_folder.policy_name(report.folder)
        others = [other for other in others if entry_folder.policy_name(other) != own]
    _check_not_found("the folder's name", name, others)
    report.content = files[entry_folder.POLICY_FILE]
    yield ", ".join(f"{file} {len(data)} bytes" for file, data in files.items())
    entry = entry_folder.parse_submission(files[entry_folder.ENTRY_FILE])
    policy = OnnxPolicy(report.content, isolated=not weak)
    report.entry = entry = dataclasses.replace(entry, policy=policy, fingerprint=policy.sha256)
    _check_not_found("name", entry.name, others)
    yield f"{entry.label}, {entry.action_mode}, {entry.observation_mode}"
    with policy:
        report.notes = policy.not_isolated
        seen, acts, *states = policy.widths
        if (seen, acts) != (wanted := widths(entry)):
            modes = f"in its modes there are {wanted[0]} and {wanted[1]}"
            raise ValueError(f"it takes {seen} observations and gives {acts} actions; {modes}")
        yield f"onnxruntime runs it, {seen} observations, {acts} actions, states {states}"
        yield check_speed(policy)
    actions = rollout(entry)
    yield f"{_ROLLOUT_ENVS} scenarios of the validation split, up to {len(actions)} steps"
    if not np.array_equal(actions, rollout(entry, backwards=True)):
        raise ValueError("the same scenarios in another order, in another process, give other actions")
    yield "the same actions to the last bit, in another order"


def _check_not_found(what: str, name: str, folders: Sequence[Path]) -> None:
    """Refuse a name by which, or by what looks like it, one of the package's policies is found."""
    for folder in folders:
        for known in (folder.name, entry_folder.policy_name(folder)):
            if known is not None and plain_name(known) == plain_name(name):
                raise ValueError(
                    f"{what} must not be, or look like, that of the policy {known} in agents/policies/{folder.name}, "
                    f"which comes with the package; got {name}"
                )


def widths(entry: Entry) -> tuple[int, int]:
    """Return how many observations and actions an entry's modes and environment have, or one group of it."""
    version = TASKS[entry.environment or V1.env_id].version
    batch = EnvBatch(EnvSettings(version=version, **entry.env_arguments), 1, 1)
    n_parts = batch.n_wtg if entry.per_group else 1
    return batch.n_observation // n_parts, batch.n_action // n_parts


def check_speed(policy: OnnxPolicy) -> str:
    """Return in words how long a policy takes for a scenario's step; a ValueError if that is too long."""
    observations = np.random.default_rng(0).uniform(-1.0, 1.0, (_TIMED_ENVS, policy.widths[0]))
    # Opens the sessions, which is not timed.
    _, state = policy.predict(observations)
    starts = np.zeros(_TIMED_ENVS, dtype=np.bool_)
    times = timeit.repeat(lambda: policy.predict(observations, state, starts), number=1, repeat=_TIMES)
    taken_ms, allowed_ms = 1e3 * min(times) / _TIMED_ENVS, 1e3 * ANSWER_S
    if taken_ms > allowed_ms:
        raise ValueError(f"more than {allowed_ms:g} ms for an action, in the fastest of {_TIMES} steps")
    return f"{taken_ms:.3f} ms for an action, allowed are {allowed_ms:g}"


def rollout(entry: Entry, *, backwards: bool = False) -> npt.NDArray[np.float64]:
    """Return the actions of an entry's policy in validation scenarios, within ±1, (steps, environments, n_action).

    They are zero once an episode is over. `backwards` plays the last scenario first, and returns the usual order. A
    policy that cannot answer, or not by finite actions, is a ValueError.
    """
    settings = EnvSettings(version=TASKS[entry.environment or V1.env_id].version, split="validation")
    order = -1 if backwards else 1
    seeds = settings.resolved_suite.validation[:_ROLLOUT_ENVS][::order]
    with started_batch(entry, settings, seeds) as (batch, _):
        actions = [taken for _, taken in play(entry, batch)]
    return np.clip(np.stack(actions), -1.0, 1.0)[:, ::order]


@dataclass(frozen=True)
class Conflict:
    """Submissions that cannot all be accepted: their folders, and why."""

    folders: tuple[Path, ...]
    reason: str


def conflicts(reports: Sequence[Report], beside: Sequence[Report] = ()) -> list[Conflict]:
    """Return the conflicts of accepted submissions with each other and with entries that are there, `beside`."""
    conflicts_found = [
        Conflict((report.folder, other.folder), _why_not_both(report, other, taken=False))
        for report, other in itertools.combinations(reports, 2)
    ]
    for new in reports:
        # One reason is enough, however many seeds have the name.
        reason = next(filter(None, (_why_not_both(new, old, taken=True) for old in beside)), "")
        conflicts_found.append(Conflict((new.folder,), reason))
    return [conflict for conflict in conflicts_found if conflict.reason]


def _why_not_both(report: Report, other: Report, *, taken: bool) -> str:
    """Return why two folders cannot both be accepted, or the first not if the other one is there; "" if they can."""
    if report.shipped and other.shipped:
        return ""
    folders, new, old = f"{report.folder} and {other.folder}", report.entry, other.entry
    first, second = report.folder.resolve().name, other.folder.resolve().name
    if first != second and first.casefold() == second.casefold():
        return f"the names of the folders {folders} differ in capitals alone"
    if new and old and plain_name(new.name) == plain_name(old.name):
        # Folders with one name must be seeds of one entry, which come together: a row that is there does not change.
        if taken:
            return f"the name {new.name} of {report.folder} is taken by {old.name} of {other.folder}"
        if new.name != old.name:
            return f"the names {new.name} and {old.name} look alike: {folders}"
        if reason := row_conflict(new.to_dict(), old.to_dict()):
            return f"{reason}: {folders}"
    else:
        # A name finds a folder by the folder's name or the entry's.
        names, others = (
            {plain_name(name): name for name in (folder, *([entry.name] if entry else []))}
            for folder, entry in ((first, new), (second, old))
        )
        for plain in names.keys() & others.keys():
            return f"{names[plain]}, of {report.folder}, looks like {others[plain]}, of {other.folder}"
    if report.sha256 is not None and report.sha256 == other.sha256:
        return f"the same policy file is given twice: {folders}"
    return ""
