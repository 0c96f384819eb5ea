"""The gate: every check of a submission, in order, up to the first that it does not pass."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation.entries import ENTRY_FILE, POLICY_FILE, Entry
from wtg_gym.evaluation.onnx_policy import Floats, States
from wtg_gym.files import sha256
from wtg_gym.submissions import limits
from wtg_gym.submissions.folder import EntryFile, parse_entry, read_files, settings_of
from wtg_gym.submissions.isolation import IsolatedPolicy, NotIsolatedError

_FILE_CHECKS = ("file format", "model", "constants", "operators", "signature", "size")
#: All checks in their order; those of the file are made where nothing of it is run.
CHECKS = ("folder", "entry.toml", *_FILE_CHECKS, "loading", "finite", "repeatable", "lanes apart", "speed")
PASSED, REFUSED, NOT_REACHED = "passed", "refused", "not reached"
#: Largest magnitude of an observation.
_BOUND = 5.0
_PROBE_LANES, _PROBE_STEPS, _LONG_STEPS = 64, 3, 600


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
    """

    folder: Path
    checks: tuple[Check, ...]
    entry: EntryFile | None
    sha256: str | None
    content: bytes
    notes: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Return whether every check was passed."""
        return all(check.verdict == PASSED for check in self.checks)

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


def check_submission(folder: Path, *, weak: bool = False) -> Report:
    """Return what the gate says about a folder; nothing of it is run in this process.

    Args:
        folder: with entry.toml and policy.onnx.
        weak: go on where this system cannot isolate a process completely.

    Raises:
        NotIsolatedError: this system cannot, and `weak` is not set.
    """
    done: list[Check] = []
    entry: EntryFile | None = None
    content: bytes = b""
    notes: tuple[str, ...] = ()
    try:
        files = read_files(folder)
        content = files[POLICY_FILE]
        done.append(Check("folder", PASSED, ", ".join(f"{name} {len(data)} bytes" for name, data in files.items())))
        entry = parse_entry(files[ENTRY_FILE])
        seed = f"training seed {entry.training_seed}"
        done.append(Check("entry.toml", PASSED, f"{entry.name}, {seed}, {entry.action_mode}, {entry.observation_mode}"))
        policy_checks, notes = _check_policy(content, entry, weak)
        done += policy_checks
    except NotIsolatedError:
        raise
    except ValueError as error:
        done.append(Check(CHECKS[len(done)], REFUSED, str(error)))
    done += [Check(name, NOT_REACHED) for name in CHECKS[len(done) :]]
    digest = sha256(content) if content else None
    return Report(folder=folder, checks=tuple(done), entry=entry, sha256=digest, content=content, notes=notes)


def doubled(reports: Sequence[Report]) -> list[str]:
    """Return what is wrong with several accepted submissions together: names and seeds, or policies, given twice."""
    seen: dict[object, Path] = {}
    wrong = []
    for report in reports:
        assert report.entry is not None
        name, seed = report.entry.name, report.entry.training_seed
        label = f"{name}, training seed {seed}"
        for key, what in (((name, seed), label), (report.sha256, f"the policy file of {label}")):
            if key in seen:
                wrong.append(f"{what} is given twice: {seen[key]} and {report.folder}")
            seen.setdefault(key, report.folder)
    return wrong


def _widths(entry: EntryFile) -> tuple[int, int]:
    """Return the widths of observations and actions of the benchmark's plant in an entry's modes."""
    lanes = TaskLanes(settings_of(entry), 1, 1)
    try:
        return lanes.n_observation, lanes.n_action
    finally:
        lanes.simulator.close()


def _check_policy(content: bytes, entry: EntryFile, weak: bool) -> tuple[list[Check], tuple[str, ...]]:
    try:
        policy = IsolatedPolicy(content, *_widths(entry), weak=weak)
    except NotIsolatedError:
        raise
    except ValueError as error:
        # The process ended while it read the file.
        return [Check(_FILE_CHECKS[0], REFUSED, str(error))], ()
    with policy:
        done = [Check(name, PASSED if passed else REFUSED, reason) for name, passed, reason in policy.checks]
        if done[-1].verdict == PASSED:
            loaded = Check("loading", REFUSED if policy.error else PASSED, policy.error or "onnxruntime runs it")
            done.append(loaded)
        if done[-1].verdict == PASSED:
            done += _probe(policy)
        return done, tuple(policy.missing)


def _probe(policy: IsolatedPolicy) -> list[Check]:
    """Ask the policy about made-up observations."""
    probes: list[tuple[str, Callable[[IsolatedPolicy], str]]] = [
        ("finite", _finite),
        ("repeatable", _repeatable),
        ("lanes apart", _lanes_apart),
        ("speed", _speed),
    ]
    done: list[Check] = []
    for name, probe in probes:
        try:
            done.append(Check(name, PASSED, probe(policy)))
        except ValueError as error:
            done.append(Check(name, REFUSED, str(error)))
            break
    return done


def _observations(n_lanes: int, width: int, seed: int) -> Floats:
    """Return made-up observations, (n_lanes, width): zero, the bounds, one entry at a bound, small ones and any."""
    rng = np.random.default_rng(seed)
    scale = rng.choice([0.01, 0.3, 1.0, _BOUND], size=(n_lanes, 1))
    values = np.clip(rng.normal(0.0, 1.0, (n_lanes, width)) * scale, -_BOUND, _BOUND)
    special = [np.zeros(width), np.full(width, _BOUND), np.full(width, -_BOUND)]
    special += [sign * _BOUND * row for row in np.eye(width) for sign in (1.0, -1.0)]
    n = min(len(special), n_lanes // 2)
    values[:n] = special[:n]
    found: Floats = values.astype(np.float32)
    return found


def _course(policy: IsolatedPolicy, steps: Sequence[Floats]) -> list[Floats]:
    """Return the actions and states of consecutive steps."""
    state: States | None = None
    found: list[Floats] = []
    for step in steps:
        action, state = policy.predict(step, state)
        found += [action, *(state or ())]
    return found


def _steps(policy: IsolatedPolicy) -> list[Floats]:
    return [_observations(_PROBE_LANES, policy.n_observation, seed) for seed in range(_PROBE_STEPS)]


def _finite(policy: IsolatedPolicy) -> str:
    many = 2 * (2 * policy.n_observation + 3)
    for lanes, n_steps in ((max(many, _PROBE_LANES), _PROBE_STEPS), (4, _LONG_STEPS)):
        course = _course(policy, [_observations(lanes, policy.n_observation, seed) for seed in range(n_steps)])
        wrong = sum(int((~np.isfinite(values)).sum()) for values in course)
        if wrong:
            raise ValueError(f"{wrong} actions or states are not finite, for observations within ±{_BOUND:g}")
    return f"on {max(many, _PROBE_LANES)} observations, and over {_LONG_STEPS} steps"


def _repeatable(policy: IsolatedPolicy) -> str:
    first, second = _course(policy, _steps(policy)), _course(policy, _steps(policy))
    if not all(np.array_equal(one, two) for one, two in zip(first, second, strict=True)):
        raise ValueError("the same observations give other actions the second time")
    return f"{_PROBE_STEPS} steps twice, the same to the last bit"


def _lanes_apart(policy: IsolatedPolicy) -> str:
    steps = _steps(policy)
    together = _course(policy, steps)
    order = np.random.default_rng(0).permutation(_PROBE_LANES)
    mixed = _course(policy, [step[order] for step in steps])
    alone = _course(policy, [step[-1:] for step in steps])
    # States may be of any magnitude; what they do shows in the actions.
    stride = len(together) // len(steps)
    differences = [
        max(float(np.abs(one[order] - two).max()), float(np.abs(one[-1:] - three).max()))
        for one, two, three in list(zip(together, mixed, alone, strict=True))[::stride]
    ]
    if not max(differences) <= limits.LANE_TOLERANCE:
        raise ValueError(
            f"a lane's action differs by {max(differences):.2g} with other lanes beside it, allowed are "
            f"{limits.LANE_TOLERANCE:g}"
        )
    return f"to {max(differences):.1g}"


def _speed(policy: IsolatedPolicy) -> str:
    step = _observations(limits.TIMED_LANES, policy.n_observation, 0)
    times = []
    for _ in range(5):
        began = time.perf_counter()
        policy.predict(step)
        times.append(time.perf_counter() - began)
    # The fastest: a busy machine slows down the others.
    found = f"{1e3 * min(times):.1f} ms for a step of {limits.TIMED_LANES} lanes, allowed are {1e3 * limits.STEP_S:g}"
    if min(times) > limits.STEP_S:
        raise ValueError(found)
    return found


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


__all__ = ["CHECKS", "NOT_REACHED", "PASSED", "REFUSED", "Check", "Report", "as_json", "check_submission", "doubled"]
