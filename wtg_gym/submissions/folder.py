"""The folder of a submission: which files it may hold, and what entry.toml may say."""

from __future__ import annotations

import os
import re
import stat
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.entries import ENTRY_FILE, POLICY_FILE
from wtg_gym.submissions import limits
from wtg_gym.submissions.texts import check_author, check_link, check_name, check_text, short

README_FILE = "README.md"
#: The files of a folder and their largest sizes [bytes].
FILES = {ENTRY_FILE: limits.ENTRY_BYTES, POLICY_FILE: limits.MODEL_BYTES, README_FILE: limits.README_BYTES}
_FOLDER = re.compile(r"(?!.*(\.|\.toml)$)[A-Za-z0-9][A-Za-z0-9+._-]{0,79}", re.IGNORECASE)
#: Names, with any ending, that Windows keeps for devices: a repository with one cannot be checked out there.
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
_REQUIRED = ("name", "authors", "training_seed", "action_mode")
_OPTIONAL = ("observation_mode", "description", "trained_on", "links")
_MODES = {"action_mode": ("k", "tau", "k+tau"), "observation_mode": ("local", "privileged")}
_LARGEST_SEED = 2**32 - 1
_MOST_AUTHORS, _MOST_LINKS = 40, 5


@dataclass(frozen=True, kw_only=True)
class EntryFile:
    """What entry.toml says.

    Args:
        name: of the entry; folders of one name and different training seeds are one entry.
        authors: who made it.
        training_seed: 0 … 2³² - 1.
        action_mode: "k", "tau" or "k+tau".
        observation_mode: "local" or "privileged".
        description: one sentence on what it is.
        trained_on: what it was trained on.
        links: https addresses of a paper or of the training code.
    """

    name: str
    authors: tuple[str, ...]
    training_seed: int
    action_mode: str
    observation_mode: str = "local"
    description: str = ""
    trained_on: str = ""
    links: tuple[str, ...] = ()


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the contents of a submission's files.

    Raises:
        ValueError: the folder holds something else, a file is no plain file or too large, or one is missing.
    """
    # The folder's name goes to shells and terminals, and into checkouts on systems that cannot have every name.
    name = Path(os.path.abspath(folder)).name
    if _FOLDER.fullmatch(name) is None or _DEVICE.fullmatch(name) is not None:
        raise ValueError(
            f"the folder's name must be 1 … 80 letters, digits and + . _ -, begin with a letter or digit, not end with "
            f"a dot or .toml, and be no device of Windows; got {ascii(name)[:90]}"
        )
    if not stat.S_ISDIR(_status(folder).st_mode):
        raise ValueError("it is not a folder, or a link to one")
    names = []
    with os.scandir(folder) as found:
        for item in found:
            names.append(item.name)
            if item.name not in FILES:
                raise ValueError(f"it holds {ascii(item.name)[:80]}; allowed are {', '.join(FILES)} and nothing else")
    missing = [name for name in (ENTRY_FILE, POLICY_FILE) if name not in names]
    if missing:
        raise ValueError(f"it has no {' and no '.join(missing)}")
    return {name: _read(folder / name, FILES[name]) for name in FILES if name in names}


def read_policy(path: Path) -> bytes:
    """Return the content of one policy file; a ValueError if it is no plain file or too large."""
    return _read(path, limits.MODEL_BYTES)


def _status(path: Path) -> os.stat_result:
    try:
        return os.lstat(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"cannot read {path}: {error}") from error


def _read(path: Path, largest: int) -> bytes:
    """Return the content of a plain file that is no link; what is looked at is what is read."""
    if not stat.S_ISREG(_status(path).st_mode):
        raise ValueError(f"{path.name} is a link or something else that is not a plain file")
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        with os.fdopen(os.open(path, flags), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ValueError(f"{path.name} is not a plain file")
            content = file.read(largest + 1)
    except OSError as error:
        raise ValueError(f"cannot read {path.name}: {error.strerror}") from error
    if len(content) > largest:
        raise ValueError(f"{path.name} is larger than {largest} bytes")
    return content


def parse_entry(content: bytes) -> EntryFile:
    """Return what entry.toml says.

    Raises:
        ValueError: it is no TOML, or a key is missing, unknown or out of range; the message names what is allowed.
    """
    try:
        data = tomllib.loads(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"it is not TOML in UTF-8: {ascii(str(error))[:120]}") from error
    missing, unknown = [key for key in _REQUIRED if key not in data], sorted(set(data) - {*_REQUIRED, *_OPTIONAL})
    if missing or unknown:
        raise ValueError(
            f"it must have the keys {', '.join(_REQUIRED)} and may have {', '.join(_OPTIONAL)}; "
            f"missing: {missing}, unknown: {ascii(unknown)[:120]}"
        )
    for key, allowed in _MODES.items():
        if key in data and (not isinstance(data[key], str) or data[key] not in allowed):
            raise ValueError(f"{key} must be one of {', '.join(allowed)}, got {short(data[key])}")
    seed = data["training_seed"]
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed <= _LARGEST_SEED:
        raise ValueError(f"training_seed must be a whole number 0 … {_LARGEST_SEED}, got {short(seed)}")
    for key in ("description", "trained_on"):
        data[key] = check_text(key, data.get(key, ""))
    data["authors"] = tuple(check_author(each) for each in _list("authors", data["authors"], 1, _MOST_AUTHORS))
    data["links"] = tuple(check_link(each) for each in _list("links", data.get("links", []), 0, _MOST_LINKS))
    return EntryFile(**{**data, "name": check_name(data["name"])})


def _list(key: str, value: Any, fewest: int, most: int) -> list[Any]:
    if not isinstance(value, list) or not fewest <= len(value) <= most:
        raise ValueError(f"{key} must be a list of {fewest} … {most} texts, got {short(value)}")
    return value


def settings_of(entry: EntryFile) -> EnvSettings:
    """Return the environment that an entry acts in."""
    # The check of the modes was made when the file was read.
    modes: Any = {"action_mode": entry.action_mode, "observation_mode": entry.observation_mode}
    return EnvSettings(**modes)


__all__ = ["FILES", "README_FILE", "EntryFile", "parse_entry", "read_files", "read_policy", "settings_of"]
