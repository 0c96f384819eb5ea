"""The baselines and the trained policies that come with the package.

A checkout has them in its folders `baselines` and `agents/policies`. An installed package has copies of both under
`wtg_gym/shipped`, because those two names could collide with other packages.
"""

from __future__ import annotations

from pathlib import Path

from wtg_gym.files import read_toml

#: Name of the package with the baselines.
BASELINES = "baselines"
#: Name of all trained policies together.
POLICIES = "policies"
_PACKAGE = Path(__file__).resolve().parents[1]


def _installed() -> bool:
    return (_PACKAGE / "shipped").is_dir()


def _root() -> Path:
    return _PACKAGE / "shipped" if _installed() else _PACKAGE.parent


def importable(module: str) -> str:
    """Return the name that a module of the baselines is imported by; any other name is returned as it is."""
    is_baseline = module.partition(".")[0] == BASELINES
    return f"wtg_gym.shipped.{module}" if is_baseline and _installed() else module


def policy_folders(name: str) -> list[Path]:
    """Return the folders of the trained policies that a name stands for; an empty list if there are none.

    Args:
        name: the name of an entry, which stands for all of its training seeds; the name of a folder, such as
            "ppo-k-0"; or "policies" for all of them.
    """
    folders = sorted((_root() / "agents" / "policies").glob("*/"))
    if name == POLICIES:
        return folders
    return [folder for folder in folders if name in (folder.name, _entry_name(folder))]


def policy_names() -> list[str]:
    """Return the names of the entries among the trained policies."""
    names = [_entry_name(folder) for folder in policy_folders(POLICIES)]
    return list(dict.fromkeys(name for name in names if name is not None))


def example_law() -> str:
    """Return the text of a file with a law, for users to change."""
    return (_root() / BASELINES / "example_law.toml").read_text(encoding="utf-8")


def _entry_name(folder: Path) -> str | None:
    """Return the name in a folder's entry.toml; None if there is none, which loading the folder explains."""
    try:
        name = read_toml(folder / "entry.toml", "entry file").get("name")
    except ValueError:
        return None
    return name if isinstance(name, str) else None


__all__ = ["BASELINES", "POLICIES", "example_law", "importable", "policy_folders", "policy_names"]
