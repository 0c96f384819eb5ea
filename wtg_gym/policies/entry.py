"""An entry: a law, and the policy that modulates it."""

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import sha256
from wtg_gym.names import check_name
from wtg_gym.physics.tracking_law import REFERENCE_LAW, TrackingLaw, get_law
from wtg_gym.ranges import require_choice, require_whole
from wtg_gym.scenarios.suite import Suite
from wtg_gym.tasks import ANCHOR_NAMES, ANY_GRID, TASKS, V1

#: What training seeds of one name must agree on, as they share a row; keys of :meth:`Entry.to_dict`.
_OF_A_ROW = (
    *("kind", "environment", "strategy", "action_mode", "observation_mode", "per_group"),
    *("source", "description", "trained_on"),
)
#: Kinds of entries, see :attr:`Entry.kind`.
KINDS = ("law", "feedback", "learned")


@runtime_checkable
class Policy(Protocol):
    """An object with the `predict` of Stable-Baselines3."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (num_envs, n_action) in [-1, 1], next recurrent state) for observations (num_envs, n)."""
        ...


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A controller that is scored: a control law, with or without a policy on top.

    A ValueError names a value that is unknown or of the wrong type, and what is allowed.
    """

    name: str  # in tables, see :func:`~wtg_gym.names.check_name`; with `training_seed` unique among the entries
    #: The law that actions modulate: a built-in name, a .toml file, or a law; None: that of a learner's environment, or
    #: the published law without one.
    strategy: str | Path | TrackingLaw | None = None
    #: Maps observations to actions; None: zero action, which is the law itself. A learner of Stable-Baselines3
    #: that was trained under VecNormalize is exported with :func:`~wtg_gym.export_onnx`.
    policy: Policy | None = None
    action_mode: str = "k+tau"  # or "k", "tau"
    observation_mode: str = "local"  # or "privileged"
    per_group: bool = False  # whether the policy acts for one group at a time from its observation, on any grid
    environment: str | None = None  # id of that whose observations the policy takes; None: a learner's own, or any
    description: str = ""  # one sentence
    source: str = ""  # citation
    #: Text that identifies the policy's content, such as its file's sha256; an interrupted evaluation starts an entry
    #: without one again.
    fingerprint: str | None = None
    training_seed: int | None = None  # entries of one name share a row if only their seeds differ
    learned: bool = True  # False for a policy that was designed by hand
    trained_on: str = ""  # suite, split and steps
    law: TrackingLaw = field(init=False, repr=False)

    def __post_init__(self) -> None:
        name = check_name("the entry's name", self.name)
        # Asked once: it may be in other processes.
        learned = learned_in(self.policy)
        strategy = self.strategy
        if strategy is None:
            if not learned and hasattr(self.policy, "get_vec_normalize_env"):
                raise without_environment(name)
            law = learned.get("strategy")
            strategy = law if isinstance(law, TrackingLaw) else REFERENCE_LAW
        object.__setattr__(self, "strategy", strategy)
        object.__setattr__(self, "law", get_law(strategy))
        # Checks the two modes.
        EnvSettings(action_mode=self.action_mode, observation_mode=self.observation_mode)
        if self.environment is None:
            object.__setattr__(self, "environment", learned.get("environment"))
        if self.environment is not None:
            require_choice(f"environment of entry {name!r}", self.environment, (*TASKS, ANY_GRID))
        if self.training_seed is not None:
            seed = require_whole(f"training_seed of entry {name!r}", self.training_seed, 0)
            object.__setattr__(self, "training_seed", seed)
        texts = (self.description, self.source, self.trained_on)
        if not all(isinstance(text, str) for text in texts):
            raise ValueError(f"description, source and trained_on of entry {name!r} must be texts, got {texts!r}")
        if not isinstance(self.per_group, bool) or (self.per_group and self.observation_mode != "local"):
            raise ValueError(f"per_group of entry {name!r} may be true with local observations alone")
        if self.policy is not None:
            self._check_policy(learned)

    def _check_policy(self, learned: Mapping[str, Any]) -> None:
        name, policy = self.name, self.policy
        if not is_policy(policy):
            raise ValueError(
                f"the policy of entry {name!r} must have predict(observation, state, episode_start, deterministic), "
                f"got {type(policy).__name__}"
            )
        # A learner of Stable-Baselines3 whose environment normalises observations.
        normalization = getattr(policy, "get_vec_normalize_env", None)
        if callable(normalization) and getattr(normalization(), "norm_obs", False):
            raise ValueError(
                f"the policy of entry {name!r} was trained under VecNormalize, whose normalisation of the observations "
                "predict() leaves out; export both with "
                "wtg_gym.export_onnx(wtg_gym.sb3.DeterministicPolicy(model), folder, name=...)"
            )
        self.check_learned(learned)

    def check_learned(self, learned: Mapping[str, Any]) -> None:
        """Raise a ValueError if the learner of its policy had another law or other modes, see :func:`learned_in`."""
        for key, entry_value in {"environment": self.environment, **self.env_arguments}.items():
            if entry_value != (value := learned.get(key, entry_value)):
                labels = [law.name if isinstance(law, TrackingLaw) else law for law in (value, entry_value)]
                raise ValueError(
                    f"the policy of entry {self.name!r} learned with {key} {labels[0]!r}, the entry has "
                    f"{labels[1]!r}: give it the {key} of its training"
                )

    @property
    def env_arguments(self) -> dict[str, Any]:
        """Return its law and modes as arguments of the environment."""
        return {"strategy": self.law, "action_mode": self.action_mode, "observation_mode": self.observation_mode}

    @property
    def kind(self) -> str:
        """Return "law" without a policy, "learned" for a trained policy, or "feedback" for one made by hand."""
        return "law" if self.policy is None else "learned" if self.learned else "feedback"

    @property
    def label(self) -> str:
        """Return the name with the training seed, for messages."""
        return run_label(self.name, self.training_seed)

    @property
    def identity(self) -> str | None:
        """Return a sha256 over everything that decides the actions; None for a policy without fingerprint."""
        if self.policy is not None and self.fingerprint is None:
            return None
        policy = None if self.policy is None else self.fingerprint
        data = [self.law.to_dict(), policy, self.action_mode, self.observation_mode]
        data += ["per group"] * self.per_group
        return sha256(json.dumps(data, sort_keys=True).encode())

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as JSON-ready data: "sha256" is the :attr:`identity`, "policy_sha256" that of the file."""
        file_hash = getattr(self.policy, "sha256", None)
        return {
            **{key: getattr(self, key) for key in ("name", "training_seed", *_OF_A_ROW)},
            "strategy": self.law.to_dict(),
            "sha256": self.identity,
            "policy_sha256": file_hash if isinstance(file_hash, str) else None,
        }


def run_label(name: str, training_seed: int | None) -> str:
    """Return the name of an entry with the training seed, for messages."""
    return name if training_seed is None else f"{name} (training seed {training_seed})"


def is_policy(value: Any) -> bool:
    """Return whether a value has `predict` and is an instance, not a class."""
    return isinstance(value, Policy) and not isinstance(value, type) and callable(value.predict)


def learned_in(policy: Any) -> dict[str, Any]:
    """Return id, law ("strategy"; of several the names) and modes of a learner's environment; empty without one."""
    try:
        settings = policy.get_env().get_attr("settings")[0]
    # Anybody's policy may have a method of that name, and an environment may be closed.
    except Exception:
        return {}
    if not isinstance(settings, EnvSettings):
        return {}
    strategy = settings.strategy
    laws = [get_law(name) for name in ([strategy] if isinstance(strategy, (str, Path, TrackingLaw)) else strategy)]
    law = laws[0] if all(other == laws[0] for other in laws) else ", ".join(other.name for other in laws)
    modes = {"action_mode": settings.action_mode, "observation_mode": settings.observation_mode}
    return {"environment": settings.env_id, "strategy": law, **modes}


def without_environment(name: str) -> ValueError:
    """Return the error of an entry whose learner was loaded: nothing says which law it learned on."""
    return ValueError(
        f"the policy of entry {name!r} is a learner without an environment, as after load(): give the law that it "
        "learned on, such as strategy='coordinated-tuned'"
    )


def check_entries(entries: Sequence[Entry]) -> None:
    """Raise a ValueError if entries cannot stand in one table: names, training seeds and rows must fit."""
    if isinstance(entries, (str, Entry)) or not all(isinstance(entry, Entry) for entry in entries):
        raise ValueError(f"entries must be a list of Entry, see load_entries(), got {entries!r}")
    check_rows(entry.to_dict() for entry in entries)
    for entry in entries:
        if entry.name in ANCHOR_NAMES and (entry.policy is not None or entry.law != get_law(entry.name)):
            raise ValueError(f"the name {entry.name!r} is reserved for the law itself, which fixes the score")


def check_rows(entries: Iterable[Mapping[str, Any]]) -> None:
    """Raise a ValueError unless entries of one name, given by :meth:`Entry.to_dict`, are training seeds of one row."""
    rows = defaultdict[str, list[Mapping[str, Any]]](list)
    for entry in entries:
        for other in rows[entry["name"]]:
            if reason := row_conflict(other, entry):
                raise ValueError(reason)
        rows[entry["name"]].append(entry)


def row_conflict(entry: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return why two entries of one name, given by :meth:`Entry.to_dict`, cannot share a row; "" if they can."""
    name, seeds = entry["name"], (entry["training_seed"], other["training_seed"])
    if seeds[0] == seeds[1]:
        return f"the entry {run_label(name, seeds[0])} is given twice"
    if None in seeds:
        return f"entries named {name!r} share a row and must all have a training seed, got {seeds[0]} and {seeds[1]}"
    for key in _OF_A_ROW:
        if entry[key] != other[key]:
            label = "source (authors)" if key == "source" else key
            values = f"{entry[key]!r} and {other[key]!r}"
            return f"entries named {name!r} share a row and must agree on {label}, got {values}"
    return ""


def check_version(entries: Sequence[Entry], suite: Suite) -> None:
    """Raise a ValueError if an entry's policy takes observations of another version, or of another grid's groups."""
    moving = (V1.env_id, ANY_GRID) if suite.task is V1 else ()
    for entry in entries:
        # A law has no observations, and what was made by hand takes those of any number of groups.
        moves = entry.per_group or not entry.learned or entry.policy is None
        if entry.environment in (None, suite.env_id) or (moves and entry.environment in moving):
            continue
        raise ValueError(
            f"entry {entry.label!r} is for {entry.environment}, these scenarios are of {suite.env_id}, whose "
            "observations are others: choose a suite of its own environment; policies with per_group = true in their "
            "entry.toml play every grid"
        )
