"""What is evaluated: a strategy, and the policy that modulates it."""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, runtime_checkable

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.onnx_policy import OnnxPolicy
from wtg_gym.evaluation.shipped import BASELINES, POLICIES, importable, policy_folders, policy_names
from wtg_gym.files import read_toml, sha256
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES, TrackingLaw, get_law

#: Names of the two entries that fix the score's 0 and 100.
ANCHORS = ("mppt", REFERENCE_STRATEGY)
_NOT_IN_NAMES = "|<>`*\\"
#: The files of a folder with a trained policy.
ENTRY_FILE = "entry.toml"
POLICY_FILE = "policy.onnx"
#: In its place an archive of Stable-Baselines3, which runs code when it is loaded, and the key that names its class.
ARCHIVE_FILE, _ALGORITHM = "model.zip", "algorithm"
_ENTRY_KEYS = (
    "name",
    "description",
    "action_mode",
    "observation_mode",
    "training_seed",
    "authors",
    "trained_on",
    "links",
)


@runtime_checkable
class Policy(Protocol):
    """Whatever has Stable-Baselines3's `predict`."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_action) in [-1, 1], next recurrent state) for observations (n_lanes, n)."""
        ...


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One competitor.

    Args:
        name: name in tables, 1 … 60 printable characters; with `training_seed` it is unique among the entries.
        strategy: the law that actions modulate: a built-in name, a .toml file, or a law.
        policy: gives the actions; None is the zero action, which is the strategy itself.
        action_mode: "k", "tau" or "k+tau".
        observation_mode: "local" or "privileged".
        description: one sentence on what it is.
        equation: the control law in short.
        source: citation.
        fingerprint: text that identifies the policy's content, such as its file's sha256; None: unknown, so that an
            interrupted evaluation starts this entry again. A law needs none: its numbers identify it.
        training_seed: seed the policy was trained with; entries of one name and several seeds share a table row.
        learned: False for a policy that was made by hand.

    Raises:
        ValueError: a value is unknown or of the wrong type; the message says what is allowed.
    """

    name: str
    strategy: str | Path | TrackingLaw = REFERENCE_STRATEGY
    policy: Policy | None = None
    action_mode: str = "k+tau"
    observation_mode: str = "local"
    description: str = ""
    equation: str = ""
    source: str = ""
    fingerprint: str | None = None
    training_seed: int | None = None
    learned: bool = True
    law: TrackingLaw = field(init=False, repr=False)

    def __post_init__(self) -> None:
        name = self.name
        if not is_name(name):
            raise ValueError(
                f"an entry's name must be 1 … 60 printable characters without {' '.join(_NOT_IN_NAMES)}, got {name!r}"
            )
        object.__setattr__(self, "law", get_law(self.strategy))
        # The settings' own check of the two modes.
        EnvSettings(action_mode=self.action_mode, observation_mode=self.observation_mode)
        if self.policy is not None and not _is_policy(self.policy):
            raise ValueError(
                f"the policy of entry {name!r} must have predict(observation, state, episode_start, deterministic), "
                f"got {type(self.policy).__name__}"
            )
        for key in ("description", "equation", "source", "fingerprint"):
            value = getattr(self, key)
            if not isinstance(value, str) and not (key == "fingerprint" and value is None):
                raise ValueError(f"{key} of entry {name!r} must be text, got {value!r}")
        if not isinstance(self.learned, bool):
            raise ValueError(f"learned of entry {name!r} must be True or False, got {self.learned!r}")
        seed = self.training_seed
        if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int) or seed < 0):
            raise ValueError(f"training_seed of entry {name!r} must be a whole number from 0 on, got {seed!r}")

    @property
    def kind(self) -> str:
        """Return "law" for a strategy as it is; where a policy modulates it, "learned", or "feedback" made by hand."""
        return "law" if self.policy is None else "learned" if self.learned else "feedback"

    @property
    def label(self) -> str:
        """Return the name with the training seed, for messages."""
        return self.name if self.training_seed is None else f"{self.name} (training seed {self.training_seed})"

    @property
    def identity(self) -> str | None:
        """Return a sha256 over what decides its actions; None for a policy without fingerprint."""
        if self.policy is not None and self.fingerprint is None:
            return None
        policy = None if self.policy is None else self.fingerprint
        data = [_law_numbers(self.law), policy, self.action_mode, self.observation_mode]
        return sha256(json.dumps(data, sort_keys=True).encode())

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as JSON-ready data; an infinite time constant is the text "inf".

        "sha256" is the :attr:`identity`; "policy_sha256" that of the policy's file, as sha256sum gives it, or None.
        """
        own = getattr(self.policy, "sha256", None)
        texts = ("name", "action_mode", "observation_mode", "description", "equation", "source", "training_seed")
        return {
            **{key: getattr(self, key) for key in texts},
            "kind": self.kind,
            "strategy": _law_numbers(self.law),
            "sha256": self.identity,
            "policy_sha256": own if isinstance(own, str) else None,
        }


def is_name(value: Any) -> bool:
    """Return whether a value can be the name of an entry, which stands in tables."""
    printable = isinstance(value, str) and value.isprintable() and not set(value) & set(_NOT_IN_NAMES)
    return printable and 1 <= len(value) <= 60 and value == value.strip()


def _is_policy(value: Any) -> bool:
    # A class has the method too, but nothing to call it on.
    return isinstance(value, Policy) and not isinstance(value, type) and callable(value.predict)


def _law_numbers(law: TrackingLaw) -> dict[str, Any]:
    numbers = dataclasses.asdict(law)
    if numbers["damping_time_constant_s"] == float("inf"):
        numbers["damping_time_constant_s"] = "inf"
    return numbers


#: Returns the policy of a folder's archive and a sha256 of it, given folder and algorithm; runs the archive's code.
LoadArchive = Callable[[Path, str], tuple[Policy, str]]


def load_entries(spec: str | Path, load_archive: LoadArchive | None = None) -> list[Entry]:
    """Return the entries that a text names.

    Args:
        spec: the name of a built-in strategy, of a baseline, or of a trained policy that comes with the package ("PPO
            (k)" stands for all of its seeds, "ppo-k-0" for one of them, "policies" for all policies); a .toml file with
            a law; a folder with an entry.toml and a policy.onnx, see :func:`load_entry_folder`; a package such as
            "baselines", of which every module with an `ENTRY` counts, in the order of the package's `ORDER` and then by
            name; or "module:ATTRIBUTE", an entry, a policy, or a callable that returns one. Importing runs the module's
            code.
        load_archive: as for :func:`load_entry_folder`.

    Raises:
        ValueError: nothing of that name, or it holds no entry; the message says what is allowed.
    """
    text = str(spec)
    if text in STRATEGIES:
        return [Entry(name=text, strategy=text, description="A built-in strategy.")]
    if text.endswith(".toml"):
        law = get_law(text)
        return [Entry(name=law.name, strategy=law, description="A law read from a file.")]
    if (Path(text) / ENTRY_FILE).is_file() or os.path.lexists(Path(text) / ARCHIVE_FILE):
        return [load_entry_folder(Path(text), load_archive)]
    _refuse_folder_of_folders(text)
    if shipped := [load_entry_folder(folder) for folder in policy_folders(text)] or _baseline(text):
        return shipped
    module_name, colon, attribute = text.partition(":")
    module = _import(importable(module_name), text)
    return [_entry_of(module, attribute, text)] if colon else _entries_of(module, text)


def _baseline(name: str) -> list[Entry]:
    """Return the baseline of a name; an empty list if there is none."""
    baselines = _entries_of(_import(importable(BASELINES), BASELINES), BASELINES)
    return [entry for entry in baselines if entry.name == name]


def _refuse_folder_of_folders(text: str) -> None:
    folders = sorted(path.parent.name for path in Path(text).glob(f"*/{ENTRY_FILE}")) if text else []
    if folders:
        raise ValueError(
            f"the folder {text} holds no {ENTRY_FILE}, but {len(folders)} folders with one: "
            f"write {text.rstrip('/')}/* for all of them, or name one, such as {text.rstrip('/')}/{folders[0]}"
        )


def load_entry_folder(folder: Path, load_archive: LoadArchive | None = None) -> Entry:
    """Return the entry of a folder with a policy that modulates the reference strategy.

    Its entry.toml has the keys name and action_mode, and may have description, observation_mode, training_seed,
    authors (a list of names), trained_on (text) and links (a list of addresses); its policy.onnx is what
    :class:`OnnxPolicy` plays, in a process of its own. Nothing of that file is looked at before it is played.

    Args:
        folder: the folder.
        load_archive: loads a model.zip in the place of policy.onnx, whose entry.toml then has the key algorithm too;
            None refuses it without opening it, because loading one runs the code in it.

    Raises:
        ValueError: a file is missing, damaged or not allowed, a key is unknown or of the wrong type, or a package is
            missing.
    """
    is_archive = os.path.lexists(folder / ARCHIVE_FILE)
    if is_archive and os.path.lexists(folder / POLICY_FILE):
        raise ValueError(f"entry {folder} has both {POLICY_FILE} and {ARCHIVE_FILE}: which one plays? Remove the other")
    if is_archive and load_archive is None:
        raise ValueError(
            f"entry {folder}: {ARCHIVE_FILE} is an archive of Stable-Baselines3 and was not opened, because loading it "
            f"would run whatever code its maker put in it, with your rights. The leaderboard takes {POLICY_FILE}, "
            "an ONNX file that 'python -m agents.export' writes; a file that you made yourself, and only that, can be "
            "scored as it is with 'wtg-gym evaluate --trust-pickle'"
        )
    data = _entry_data(folder / ENTRY_FILE, (_ALGORITHM,) if is_archive else ())
    algorithm = data.pop(_ALGORITHM, "")
    try:
        # All that entry.toml can have wrong is said before a policy is loaded.
        entry = Entry(**data)
        if is_archive and load_archive is not None:
            policy, fingerprint = load_archive(folder, algorithm)
            return dataclasses.replace(entry, policy=policy, fingerprint=fingerprint)
        onnx_policy = OnnxPolicy(folder / POLICY_FILE)
        return dataclasses.replace(entry, policy=onnx_policy, fingerprint=onnx_policy.sha256)
    except (ImportError, ValueError) as error:
        raise ValueError(f"entry {folder}: {error}") from error


def _entry_data(path: Path, further: tuple[str, ...]) -> dict[str, Any]:
    """Return the arguments of :class:`Entry` that an entry.toml gives, and its `further` keys, which it must have."""
    data = read_toml(path, "entry file")
    required, known = ("name", "action_mode", *further), (*_ENTRY_KEYS, *further)
    unknown, missing = sorted(set(data) - set(known)), sorted(set(required) - set(data))
    if unknown or missing:
        raise ValueError(
            f"the entry file {path} must have the keys {' and '.join(required)} and may have others out of "
            f"{', '.join(known)}; unknown: {unknown}, missing: {missing}"
        )
    authors = data.pop("authors", [])
    if not isinstance(authors, list) or not all(isinstance(author, str) and author for author in authors):
        raise ValueError(f"authors in {path} must be a list of names, got {authors!r}")
    # They say nothing about what it does.
    trained_on, links = data.pop("trained_on", ""), data.pop("links", [])
    if not isinstance(trained_on, str) or not isinstance(links, list) or not all(isinstance(x, str) for x in links):
        raise ValueError(f"in {path}, trained_on must be text and links a list of texts, got {trained_on!r}, {links!r}")
    return {**data, "source": ", ".join(authors)}


def _import(name: str, spec: str) -> ModuleType:
    shipped = ", ".join(repr(known) for known in (*STRATEGIES, BASELINES, *policy_names(), POLICIES))
    allowed = (
        f"allowed are {shipped}, a .toml file with a law, "
        f'a folder with {ENTRY_FILE}, an importable package or module with entries, or "module:ATTRIBUTE"'
    )
    if not name or not all(part.isidentifier() for part in name.split(".")):
        if name and Path(spec).is_dir():
            raise ValueError(f"the folder {spec} holds no {ENTRY_FILE}")
        raise ValueError(f"unknown entry {spec!r}; {allowed}")
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(error.name + ".")):
            raise ValueError(f"unknown entry {spec!r}: there is no module {error.name!r}; {allowed}") from error
        raise ValueError(f"entry {spec!r} cannot be imported: {error}") from error
    except ImportError as error:
        raise ValueError(f"entry {spec!r} cannot be imported: {error}") from error


def _entry_of(module: ModuleType, attribute: str, spec: str) -> Entry:
    names = ", ".join(sorted(name for name in vars(module) if not name.startswith("_")))
    if not hasattr(module, attribute):
        raise ValueError(f"entry {spec!r}: module {module.__name__!r} has no {attribute!r}; it has {names}")
    found = getattr(module, attribute)
    if callable(found) and not _is_policy(found):
        found = found()
    if isinstance(found, Entry):
        return found
    if _is_policy(found):
        return Entry(name=attribute, policy=found)
    raise ValueError(
        f"entry {spec!r} must be an Entry, an object with predict(), or a callable that returns one, "
        f"got {type(found).__name__}"
    )


def _entries_of(module: ModuleType, spec: str) -> list[Entry]:
    path = getattr(module, "__path__", None)
    if path is None:
        modules = [module]
    else:
        names = sorted(info.name for info in pkgutil.iter_modules(path))
        order: Sequence[str] = getattr(module, "ORDER", ())
        missing = [name for name in order if name not in names]
        if missing:
            raise ValueError(f"ORDER of package {spec!r} names modules {missing} that it has not; it has {names}")
        names = [*order, *(name for name in names if name not in order)]
        modules = [_import(f"{module.__name__}.{name}", spec) for name in names]
    entries = [vars(m)["ENTRY"] for m in modules if "ENTRY" in vars(m)]
    wrong = [type(entry).__name__ for entry in entries if not isinstance(entry, Entry)]
    if wrong:
        raise ValueError(f"every ENTRY in {spec!r} must be an Entry, got {', '.join(wrong)}")
    if not entries:
        raise ValueError(f"{spec!r} has no entry: a folder needs an {ENTRY_FILE}, a package or module an ENTRY")
    return entries


__all__ = [
    "ANCHORS",
    "ARCHIVE_FILE",
    "ENTRY_FILE",
    "POLICY_FILE",
    "Entry",
    "LoadArchive",
    "Policy",
    "is_name",
    "load_entries",
    "load_entry_folder",
]
