"""The folder of a submission: its files, the keys of entry.toml, and a template to fill in."""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import LARGEST_BYTES, write_atomically
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.policies.entry_toml import parse_entry
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE
from wtg_gym.policies.names import check_not_built_in
from wtg_gym.policies.submission_texts import check_author, check_name, check_text
from wtg_gym.scenarios.benchmark import BENCHMARKS

#: The files of a folder and their largest sizes [bytes]; every limit is far above what a policy here needs.
FILES = {ENTRY_FILE: LARGEST_BYTES["entry file"], POLICY_FILE: 5_000_000, "README.md": 65_536}
_FOLDER = re.compile(r"(?!.*(\.|\.toml)$)[A-Za-z0-9][A-Za-z0-9+._-]{0,79}", re.IGNORECASE | re.ASCII)
#: Names, with any ending, that Windows keeps for devices: a repository with one cannot be checked out there.
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
_MOST_AUTHORS = 40
_REQUIRED = ("name", "authors", "training_seed", "action_mode")
_TEMPLATE = Path(__file__).with_name("entry_template.toml")


@dataclass(frozen=True, kw_only=True)
class EntryFile:
    """The content of entry.toml, see CONTRIBUTING.md; folders of one name and several seeds are one entry."""

    name: str
    authors: tuple[str, ...]
    training_seed: int
    action_mode: str
    observation_mode: str = "local"
    per_group: bool = False
    environment: str
    strategy: str = REFERENCE_STRATEGY
    description: str = ""
    trained_on: str = ""

    def widths(self) -> tuple[int, int]:
        """Return how many observations and actions there are in its modes and environment, or for one group of it."""
        version = BENCHMARKS[self.environment].version
        modes: Any = {"action_mode": self.action_mode, "observation_mode": self.observation_mode}
        lanes = TaskLanes(EnvSettings(version=version, **modes), 1, 1)
        n_parts = lanes.n_wtg if self.per_group else 1
        return lanes.n_observation // n_parts, lanes.n_action // n_parts


def entry_text(values: Mapping[str, Any]) -> str:
    """Return an entry.toml with values that are texts, whole numbers and lists of texts."""
    # These are written alike in JSON and TOML.
    return "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in values.items())


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the contents of a submission's files; a ValueError names one that is missing, too large or not allowed."""
    _check_folder_name(folder)
    if folder.is_symlink() or not folder.is_dir():
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


def _check_folder_name(folder: Path) -> None:
    # It goes to shells and terminals, and into checkouts on systems that cannot have every name.
    name = Path(os.path.abspath(folder)).name
    if _FOLDER.fullmatch(name) is None or _DEVICE.fullmatch(name) is not None:
        raise ValueError(
            f"the folder's name must be 1 … 80 letters, digits and + . _ -, begin with a letter or digit, not end with "
            f"a dot or .toml, and be no device of Windows; got {ascii(name)[:90]}"
        )
    check_not_built_in("the folder's name", name)


def _read(path: Path, largest: int) -> bytes:
    """Return the content of a plain file; a link, even one put there after the check, is refused."""
    if path.is_symlink() or not path.is_file():
        raise ValueError(f"{path.name} is not there, a link or something else that is not a plain file")
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


def parse_submission(content: bytes) -> EntryFile:
    """Return the content of a submission's entry.toml; a ValueError says what is wrong and what is allowed."""
    try:
        data = parse_entry(content.decode("utf-8"), _REQUIRED)
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not TOML in UTF-8: {error}") from error
    for key in ("description", "trained_on"):
        data[key] = check_text(key, data.get(key, ""))
    if not 1 <= len(data["authors"]) <= _MOST_AUTHORS:
        raise ValueError(f"authors must be a list of 1 … {_MOST_AUTHORS} texts, got {len(data['authors'])}")
    data["authors"] = tuple(map(check_author, data["authors"]))
    name = check_name(data["name"])
    check_not_built_in("name", name)
    return EntryFile(**data)


def write_template(folder: Path) -> Path:
    """Write an entry.toml to fill in into a folder, which is made if missing; a ValueError if it has one already."""
    _check_folder_name(folder)
    path = folder / ENTRY_FILE
    if path.exists():
        raise ValueError(f"{folder} has {ENTRY_FILE} already; choose another folder")
    write_atomically(path, _TEMPLATE.read_bytes())
    return path
