"""Entries by name: built-in strategies, laws in files, folders with a policy, and Python modules.

A checkout has the baselines in its folder `baselines` and the trained policies in `agents/policies`. An installed
package has copies of both in `wtg_gym/shipped`, because those two names could collide with other packages.
"""

from __future__ import annotations

import difflib
import importlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from wtg_gym.files import interpreting, read_text
from wtg_gym.physics.tracking_law import STRATEGY_NAMES, get_law
from wtg_gym.policies.entry import Entry, is_policy
from wtg_gym.policies.entry_toml import parse_entry
from wtg_gym.policies.names import BASELINES, INSTALLED, POLICIES, ROOT, check_not_built_in, is_built_in
from wtg_gym.policies.onnx_policy import OnnxPolicy
from wtg_gym.scenarios.benchmark import V1, Benchmark

#: The files of a folder with a trained policy.
ENTRY_FILE, POLICY_FILE = "entry.toml", "policy.onnx"


def load_entries(spec: str | Path | Iterable[str | Path], benchmark: Benchmark = V1) -> list[Entry]:
    """Return the entries that a text or several name.

    Args:
        spec: what is found first, in this order: the name of a built-in strategy; "baselines" for all baselines,
            "policies" for all trained policies that come with the package; the name of a baseline; a .toml file with a
            law; a folder with an entry.toml and a policy.onnx, see :func:`load_entry_folder`; the name of one of those
            policies ("PPO (k)" stands for all of its seeds, "ppo-k-0" for one of them); or "module:ATTRIBUTE", an
            entry, a policy, or a callable that returns one. Importing runs the module's code.
        benchmark: the version whose baselines are meant, and whose trained policies, where some of a name are for it.

    Raises:
        ValueError: nothing of that name, or it holds no entry; the message says what is allowed.
    """
    if not isinstance(spec, (str, Path, Iterable)):
        raise ValueError(f"load_entries() takes names and paths, got {spec!r}")
    if not isinstance(spec, (str, Path)):
        return [entry for each in spec for entry in load_entries(each, benchmark)]
    text = str(spec)
    if text == BASELINES:
        return _baselines(benchmark.version)
    if text == POLICIES:
        return _for_version(policy_folders(), benchmark)
    baselines = _baselines() if is_built_in(text) else []
    if named := [entry for entry in baselines if entry.name == text]:
        return named
    if text.endswith(".toml"):
        law = get_law(text)
        check_not_built_in(f"the name of the law in {text}", law.name)
        return [Entry(name=law.name, strategy=law, description="A law read from a file.")]
    if (Path(text) / ENTRY_FILE).is_file():
        return [load_entry_folder(Path(text))]
    if text.endswith(".zip"):
        raise ValueError(
            f"entry {text}: an archive of Stable-Baselines3 is not opened, because loading it runs the code in it; "
            "in Python, play its model with Entry(policy=model), or export it with "
            "wtg_gym.export_onnx(wtg_gym.sb3.DeterministicPolicy(model), folder, name=...)"
        )
    if shipped := [folder for folder in policy_folders() if text in (folder.name, policy_name(folder))]:
        return _for_version(shipped, benchmark)
    module_name, colon, attribute = text.partition(":")
    if not colon and Path(text or "no folder").is_dir():
        raise ValueError(f"the folder {text} holds no {ENTRY_FILE}; several folders are {text.rstrip('/')}/*")
    if not colon or not all(part.isidentifier() for part in module_name.split(".")):
        raise ValueError(f"unknown entry {text!r}; {_allowed(text)}")
    return [_entry_of(_import(module_name, text), attribute, text)]


def example_law() -> str:
    """Return the text of a file with a law, for users to change."""
    return (ROOT / BASELINES / "example_law.toml").read_text(encoding="utf-8")


# --- trained policies ------------------------------------------------------------------------------------------------


def policy_folders(env_id: str | None = None) -> list[Path]:
    """Return the folders of the trained policies that come with the package: all, or those for an environment."""
    folders = sorted(path.parent for path in (ROOT / "agents" / "policies").glob(f"*/{ENTRY_FILE}"))
    return folders if env_id is None else [each for each in folders if _said(each).get("environment") == env_id]


def policy_name(folder: Path) -> str | None:
    """Return the name of the entry in a folder; None if its entry.toml is wrong, loading the folder says why."""
    return _said(folder).get("name")


def _said(folder: Path) -> dict[str, Any]:
    try:
        return _entry_data(folder / ENTRY_FILE)
    except ValueError:
        return {}


def _for_version(folders: Sequence[Path], benchmark: Benchmark) -> list[Entry]:
    """Return the entries of shipped folders: those for a version, or all if there are none for it."""
    entries = [load_entry_folder(folder) for folder in folders]
    return [entry for entry in entries if entry.environment == benchmark.env_id] or entries


def load_entry_folder(folder: Path) -> Entry:
    """Return the entry of a folder with a policy.

    Its entry.toml has the keys name and action_mode, and may have description, observation_mode, environment (without
    it: that of version v1), strategy (the name of a built-in one; without it: the reference strategy), training_seed,
    authors (a list of names) and trained_on (text). An :class:`OnnxPolicy` plays its policy.onnx in a process of its
    own; nothing of that file is looked at before.

    Raises:
        ValueError: a file is missing or damaged, or a key is unknown or of the wrong type.
    """
    data = _entry_data(folder / ENTRY_FILE)
    check_not_built_in(f"the name in {folder / ENTRY_FILE}", data["name"])
    try:
        # Errors of entry.toml come before the policy is loaded.
        Entry(**data)
        policy = OnnxPolicy(folder / POLICY_FILE)
        return Entry(**data, policy=policy, fingerprint=policy.sha256)
    except ValueError as error:
        raise ValueError(f"entry {folder}: {error}") from error


def _entry_data(path: Path) -> dict[str, Any]:
    """Return the arguments of :class:`Entry` that an entry.toml gives."""
    text = read_text(path, "entry file")
    with interpreting(path, "entry file"):
        return entry_arguments(parse_entry(text))


def entry_arguments(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of :class:`Entry` in the keys of an entry.toml: authors are its source."""
    source = ", ".join(data.get("authors", ()))
    return {**{key: data[key] for key in data if key not in ("authors", "trained_on")}, "source": source}


# --- modules ---------------------------------------------------------------------------------------------------------


def _import(name: str, spec: str) -> ModuleType:
    if name.partition(".")[0] == BASELINES and INSTALLED:
        name = f"wtg_gym.shipped.{name}"
    try:
        return importlib.import_module(name)
    except ImportError as error:
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing is not None and (name == missing or name.startswith(missing + ".")):
            raise ValueError(f"unknown entry {spec!r}: there is no module {missing!r}; {_allowed(spec)}") from error
        raise ValueError(f"entry {spec!r} cannot be imported: {error}") from error


def _allowed(text: str) -> str:
    """Return what can stand in the place of a wrong entry: the names like it, or all."""
    shipped = (name for folder in policy_folders() if (name := policy_name(folder)))
    baselines = (entry.name for entry in _baselines())
    names = {name.casefold(): name for name in (*STRATEGY_NAMES, *baselines, BASELINES, *shipped, POLICIES)}
    if close := difflib.get_close_matches(text.casefold(), names):
        return f"did you mean {' or '.join(repr(names[name]) for name in close)}?"
    known = ", ".join(map(repr, names.values()))
    return f'allowed are {known}, a .toml file with a law, a folder with {ENTRY_FILE}, or "module:ATTRIBUTE"'


def _baselines(version: str | None = None) -> list[Entry]:
    """Return the baselines of a version in the order of its table; None: those of all versions."""
    order: Mapping[str, Sequence[Entry | str]] = _import(BASELINES, BASELINES).ORDER
    named = order[version] if version else dict.fromkeys(itertools.chain(*order.values()))
    # A feedback is named by its module.
    return [_import(f"{BASELINES}.{each}", BASELINES).ENTRY if isinstance(each, str) else each for each in named]


def _entry_of(module: ModuleType, attribute: str, spec: str) -> Entry:
    if not hasattr(module, attribute):
        names = ", ".join(sorted(name for name in vars(module) if not name.startswith("_")))
        raise ValueError(f"entry {spec!r}: module {module.__name__!r} has no {attribute!r}; it has {names}")
    found = getattr(module, attribute)
    if callable(found) and not is_policy(found):
        found = found()
    if isinstance(found, Entry):
        return found
    if is_policy(found):
        return Entry(name=attribute, policy=found)
    raise ValueError(
        f"entry {spec!r} must be an Entry, an object with predict(), or a callable that returns one, "
        f"got {type(found).__name__}"
    )
