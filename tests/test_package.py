"""Facts about the installed package, and the files that a release is made from."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import wtg_gym

ROOT = Path(__file__).parent.parent
HEAVY = {"torch", "onnx", "onnxruntime", "matplotlib", "pandas", "stable_baselines3", "rich", "baselines", "agents"}


def test_importing_the_package_loads_nothing_heavy_and_environments_are_found_by_module_and_id() -> None:
    program = "import sys, wtg_gym, gymnasium; print(*sys.modules); gymnasium.make('wtg_gym:GFMWTG-14bus-v0')"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {name.partition(".")[0] for name in done.stdout.split()} & HEAVY


def test_public_names_are_those_of_their_modules_and_no_others() -> None:
    assert all(getattr(wtg_gym, name) is not None and name in dir(wtg_gym) for name in wtg_gym.__all__)
    with pytest.raises(AttributeError, match="no attribute 'evaluat'"):
        wtg_gym.evaluat  # noqa: B018
    assert (Path(wtg_gym.__file__).parent / "py.typed").exists()


def _read(path: str) -> Any:
    text = (ROOT / path).read_text(encoding="utf-8")
    return tomllib.loads(text) if path.endswith(".toml") else yaml.safe_load(text)


def test_release_files_agree() -> None:
    project, recipe, citation = _read("pyproject.toml")["project"], _read("conda/recipe.yaml"), _read("CITATION.cff")
    (newest, *_) = re.findall(r"^## \[(.+)\] - ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert {recipe["context"]["version"], citation["version"], newest} == {project["version"]}
    needed = [f"python{project['requires-python']}", *project["dependencies"]]
    asked = [[each.replace(" ", "") for each in names] for names in (recipe["requirements"]["run"], needed)]
    assert sorted(asked[0]) == sorted(asked[1])
    archive = json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8"))
    assert (archive["title"], archive["license"]) == (citation["title"], project["license"])


@pytest.mark.skipif(shutil.which("git") is None or not (ROOT / ".git").exists(), reason="needs a checkout and git")
def test_nothing_that_is_made_anew_is_in_the_repository() -> None:
    """Results, environments and machine code that somebody had added would be used instead of one's own."""
    command = ["git", "ls-files", "--cached", "--ignored", "--exclude-standard"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == ""
