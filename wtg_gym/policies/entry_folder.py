"""Entries by name: built-in laws, laws in files, folders with a policy, submissions, and Python modules.

A policy's folder holds `entry.toml`, which describes it, and `policy.onnx`. A checkout has the trained policies in
`agents/policies` and the baselines in `baselines`; an installed package has copies of both in `wtg_gym/shipped`,
because those names could collide with other packages.
"""

import dataclasses
import functools
import importlib
import itertools
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from wtg_gym.files import LARGEST_BYTES, interpreting, parse_toml, read_plain, read_text, write_atomically
from wtg_gym.names import check_name, check_text, plain_name, short
from wtg_gym.physics.tracking_law import LAW_NAMES, get_law
from wtg_gym.policies.entry import Entry, is_policy
from wtg_gym.policies.policy_process import OnnxPolicy
from wtg_gym.ranges import did_you_mean, is_whole
from wtg_gym.tasks import TASKS, V1, Task, episode, observation

ENTRY_FILE, POLICY_FILE = "entry.toml", "policy.onnx"
#: The files of a submission and their largest sizes [bytes]; every limit is far above what a policy here needs.
FILES = {ENTRY_FILE: LARGEST_BYTES["entry file"], POLICY_FILE: 5_000_000, "README.md": 65_536}
#: The package with the baselines, and the name of all trained policies together.
BASELINES, POLICIES = "baselines", "policies"
#: Words that cannot be names: those two, and the packages of a checkout.
RESERVED = (BASELINES, POLICIES, "agents", "tests", "wtg_gym")
_PACKAGE = Path(__file__).resolve().parents[1]
INSTALLED = (_PACKAGE / "shipped").is_dir()
#: The folder with `baselines` and `agents/policies`.
ROOT = _PACKAGE / "shipped" if INSTALLED else _PACKAGE.parent
_TEMPLATE = Path(__file__).with_name("entry_template.toml")

#: Keys that an entry.toml must have, those that a submission's must have, and more that it may have.
_NEEDED, _SUBMITTED = ("name", "action_mode"), ("name", "authors", "training_seed", "action_mode")
_OPTIONAL = ("description", "observation_mode", "per_group", "environment", "strategy", "trained_on")
KEYS = (*_SUBMITTED, *_OPTIONAL)
_CHOICES = {
    "action_mode": tuple(episode.ACTION_MODES),
    "observation_mode": observation.OBSERVATION_MODES,
    "environment": tuple(TASKS),
    "strategy": LAW_NAMES,
}
_LARGEST_SEED, _MOST_AUTHORS = 2**32 - 1, 40
#: The table says itself how many seeds a row has: "seed" in any word, or spread over signs.
_SEED = re.compile("seed|(?<![a-z])s[^a-z]*e[^a-z]*e[^a-z]*d", re.IGNORECASE)
_FOLDER = re.compile(r"(?!.*(\.|\.toml)$)[A-Za-z0-9][A-Za-z0-9+._-]{0,79}", re.IGNORECASE | re.ASCII)
#: Names, with any ending, that Windows keeps for devices: a repository with one cannot be checked out there.
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


@functools.cache
def _built_in() -> frozenset[str]:
    """Return the plain names of the laws and the baselines, each of which is called like its module."""
    modules = (path.stem for path in (ROOT / BASELINES).glob("*.py"))
    return frozenset(map(plain_name, (*LAW_NAMES, *modules)))


def check_not_built_in(what: str, name: str) -> None:
    """Raise a ValueError if a name is, or looks like, a law's or baseline's, or begins with a reserved word."""
    if plain_name(name) in _built_in() or plain_name(name.partition(".")[0]) in map(plain_name, RESERVED):
        raise ValueError(
            f"{what} must not be, or look like, that of a law or a baseline or one of {', '.join(RESERVED)}; "
            f"got {short(name)}"
        )


def parse_entry(text: str, *, submitted: bool = False) -> Entry:
    """Return the entry of an entry.toml, without its policy; if `submitted`, with the keys of a submission.

    Authors are its source. A ValueError names the error and the allowed values in one line, with foreign text escaped
    to ASCII.
    """
    try:
        data = parse_toml(text, "it")
    except ValueError as error:
        raise ValueError(ascii(str(error))[1:-1][:160]) from error
    needed = _SUBMITTED if submitted else _NEEDED
    others = [key for key in KEYS if key not in needed]
    missing, unknown = [key for key in needed if key not in data], sorted(set(data) - {*needed, *others})
    if missing or unknown:
        raise ValueError(
            f"it must have the keys {', '.join(needed)} and may have {', '.join(others)}; "
            f"missing: {missing}, unknown: {ascii(unknown)[:120]}"
        )
    for key, allowed in _CHOICES.items():
        if key in data and not (isinstance(data[key], str) and data[key] in allowed):
            raise ValueError(f"{key} must be one of {', '.join(allowed)}, got {short(data[key])}")
    for key in ("description", "trained_on"):
        check_text(key, data.get(key, ""))
    authors = data.pop("authors", [])
    if not isinstance(authors, list) or not submitted <= len(authors) <= _MOST_AUTHORS:
        raise ValueError(f"authors must be a list of {int(submitted)} … {_MOST_AUTHORS} names, got {short(authors)}")
    source = ", ".join(check_name("an author", author) for author in authors)
    if not isinstance(data.get("per_group", False), bool):
        raise ValueError(f"per_group must be true or false, got {short(data['per_group'])}")
    seed = data.get("training_seed", 0)
    if not is_whole(seed) or not 0 <= seed <= _LARGEST_SEED:
        raise ValueError(f"training_seed must be a whole number 0 … {_LARGEST_SEED}, got {short(seed)}")
    name = check_name("name", data["name"])
    if submitted and _SEED.search(name):
        raise ValueError(f"name must say nothing of seeds, which the table counts; got {short(name)}")
    check_not_built_in("name", name)
    return Entry(**{"environment": V1.env_id, **data}, source=source)


def entry_text(values: Mapping[str, Any]) -> str:
    """Return an entry.toml with values that are texts, whole numbers and lists of texts."""
    # These are written alike in JSON and TOML.
    return "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in values.items())


def write_template(folder: Path) -> Path:
    """Write an entry.toml to fill in into a folder, which is made if missing; a ValueError if it has one already."""
    _check_folder_name(folder)
    path = folder / ENTRY_FILE
    if path.exists():
        raise ValueError(f"{folder} has {ENTRY_FILE} already; choose another folder")
    write_atomically(path, _TEMPLATE.read_bytes())
    return path


def load_entry_folder(folder: Path) -> Entry:
    """Return the entry of a folder with a policy; a ValueError names what is missing, damaged or unknown.

    Of the keys of a submission it needs name and action_mode. policy.onnx is not looked at before it is played.
    """
    entry, policy = _described(folder), OnnxPolicy(folder / POLICY_FILE)
    return dataclasses.replace(entry, policy=policy, fingerprint=policy.sha256)


def _described(folder: Path) -> Entry:
    text = read_text(folder / ENTRY_FILE, "entry file")
    with interpreting(folder / ENTRY_FILE, "entry file"):
        return parse_entry(text)


def policy_folders() -> list[Path]:
    """Return the folders of the trained policies that come with the package."""
    return sorted(path.parent for path in (ROOT / "agents" / "policies").glob(f"*/{ENTRY_FILE}"))


def policy_name(folder: Path) -> str | None:
    """Return the name of the entry in a folder; None if its entry.toml is wrong, loading the folder says why."""
    try:
        return _described(folder).name
    except ValueError:
        return None


def parse_submission(content: bytes) -> Entry:
    """Return a submission's entry.toml as an entry without its policy; a ValueError says what is wrong and allowed."""
    try:
        return parse_entry(content.decode("utf-8"), submitted=True)
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not TOML in UTF-8: {error}") from error


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the contents of a submission's files; a ValueError names one that is missing, too large or not allowed."""
    _check_folder_name(folder)
    if folder.is_symlink() or not folder.is_dir():
        raise ValueError("it is not a folder, or a link to one")
    # No list of a folder that may hold millions.
    with os.scandir(folder) as items:
        names = [item.name for item in itertools.islice(items, 1 + len(FILES))]
    if others := [name for name in names if name not in FILES]:
        raise ValueError(f"it holds {ascii(others[0])[:80]}; allowed are {', '.join(FILES)} and nothing else")
    if missing := [name for name in (ENTRY_FILE, POLICY_FILE) if name not in names]:
        raise ValueError(f"it has no {' and no '.join(missing)}")
    contents = {}
    for name in filter(names.__contains__, FILES):
        try:
            contents[name] = read_plain(folder / name, FILES[name], links=False)
        except OSError as error:
            raise ValueError(f"{name}: {error.strerror}") from error
    return contents


def _check_folder_name(folder: Path) -> None:
    # It goes to shells and terminals, and into checkouts on systems that cannot have every name.
    name = Path(os.path.abspath(folder)).name
    if _FOLDER.fullmatch(name) is None or _DEVICE.fullmatch(name) is not None:
        raise ValueError(
            f"the folder's name must be 1 … 80 letters, digits and + . _ -, begin with a letter or digit, not end with "
            f"a dot or .toml, and be no device of Windows; got {ascii(name)[:90]}"
        )
    check_not_built_in("the folder's name", name)


def load_entries(spec: str | Path | Iterable[str | Path], task: Task = V1) -> list[Entry]:
    """Return the entries that a text or several name.

    A ValueError says that there is nothing of that name, or that it holds no entry, and what is allowed.

    Args:
        spec: one of these; the first that exists counts. "baselines" or "policies" for all baselines or all trained
            policies of the package. The name of a law or a baseline. A .toml file with a law. A folder with entry.toml
            and policy.onnx. The name of a trained policy ("PPO (k)" for all its seeds, "ppo-k-0" for one).
            "module:ATTRIBUTE" for an entry, a policy, or a callable that returns one; importing runs the module's code.
        task: the version of the baselines, and of trained policies if some of the name are for it.
    """
    if not isinstance(spec, (str, Path, Iterable)):
        raise ValueError(f"load_entries() takes names and paths, got {spec!r}")
    if not isinstance(spec, (str, Path)):
        return [entry for item in spec for entry in load_entries(item, task)]
    text = str(spec)
    if text == BASELINES:
        return _baselines(task.version)
    if text == POLICIES:
        return _for_version(policy_folders(), task)
    baselines = _baselines() if plain_name(text) in _built_in() else []
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
            "in Python, play its model with Entry(policy=model, strategy=...), or export it with "
            "wtg_gym.export_onnx(wtg_gym.sb3.DeterministicPolicy(model), folder, name=...)"
        )
    if shipped := [folder for folder in policy_folders() if text in (folder.name, policy_name(folder))]:
        return _for_version(shipped, task)
    module_name, colon, attribute = text.partition(":")
    if not colon and Path(text or "no folder").is_dir():
        raise ValueError(f"the folder {text} holds no {ENTRY_FILE}; several folders are {text.rstrip('/')}/*")
    if not colon or not all(part.isidentifier() for part in module_name.split(".")):
        raise ValueError(f"unknown entry {text!r}{_allowed(text)}")
    return [_entry_of(_import(module_name, text), attribute, text)]


def example_law() -> str:
    """Return the text of a file with a law, for users to change."""
    return (ROOT / BASELINES / "example_law.toml").read_text(encoding="utf-8")


def _for_version(folders: Sequence[Path], task: Task) -> list[Entry]:
    """Return the entries of shipped folders: those for a version, or all if there are none for it."""
    entries = [load_entry_folder(folder) for folder in folders]
    return [entry for entry in entries if entry.environment == task.env_id] or entries


def _import(name: str, spec: str) -> ModuleType:
    if name.partition(".")[0] == BASELINES and INSTALLED:
        name = f"wtg_gym.shipped.{name}"
    try:
        return importlib.import_module(name)
    except ImportError as error:
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing is not None and (name == missing or name.startswith(missing + ".")):
            raise ValueError(f"unknown entry {spec!r}: there is no module {missing!r}{_allowed(spec)}") from error
        raise ValueError(f"entry {spec!r} cannot be imported: {error}") from error


def _allowed(text: str) -> str:
    """Return the end of an error about a wrong entry: the names like it, or all."""
    file, _, attribute = text.partition(":")
    if file.endswith(".py"):
        return f"; did you mean {'.'.join(Path(file).with_suffix('').parts) + ':' + (attribute or 'ENTRY')!r}?"
    shipped = (name for folder in policy_folders() if (name := policy_name(folder)))
    baselines = (entry.name for entry in _baselines())
    names = dict.fromkeys((*LAW_NAMES, *baselines, BASELINES, *shipped, POLICIES))
    known = f'{", ".join(map(repr, names))}, a .toml file with a law, a folder with {ENTRY_FILE}, or "module:ATTRIBUTE"'
    own = (str(path.parent) for path in Path().glob(f"*/{ENTRY_FILE}"))
    return did_you_mean(text, (*own, *names)) or f"; allowed are {known}"


def _baselines(version: str | None = None) -> list[Entry]:
    """Return the baselines of a version in the order of its table; None: those of all versions."""
    order: Mapping[str, Sequence[Entry | str]] = _import(BASELINES, BASELINES).ORDER
    named = order[version] if version else dict.fromkeys(itertools.chain(*order.values()))
    # A feedback is named by its module.
    return [_import(f"{BASELINES}.{item}", BASELINES).ENTRY if isinstance(item, str) else item for item in named]


def _entry_of(module: ModuleType, attribute: str, spec: str) -> Entry:
    if not hasattr(module, attribute):
        names = ", ".join(sorted(name for name in vars(module) if not name.startswith("_")))
        raise ValueError(f"entry {spec!r}: module {module.__name__!r} has no {attribute!r}; it has {names}")
    value = getattr(module, attribute)
    if callable(value) and not is_policy(value):
        value = value()
    if isinstance(value, Entry):
        return value
    if is_policy(value):
        return Entry(name=attribute, policy=value)
    raise ValueError(
        f"entry {spec!r} must be an Entry, an object with predict(), or a callable that returns one, "
        f"got {type(value).__name__}"
    )
