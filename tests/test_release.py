"""Facts about the files that a release is made from: they say the same as pyproject.toml."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def _yaml(path: str) -> Any:
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def _spaceless(requirements: list[str]) -> list[str]:
    return sorted(requirement.replace(" ", "") for requirement in requirements)


def test_conda_recipe_asks_for_what_the_package_asks_for() -> None:
    recipe = _yaml("conda/recipe.yaml")
    assert recipe["context"]["version"] == PROJECT["version"]
    python = f"python{PROJECT['requires-python']}"
    assert _spaceless(recipe["requirements"]["run"]) == _spaceless([python, *PROJECT["dependencies"]])
    scripts = [f"{name} = {target}" for name, target in PROJECT["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == scripts


def test_citation_and_archive_name_the_same_work() -> None:
    citation = _yaml("CITATION.cff")
    archive = json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8"))
    assert citation["version"] == PROJECT["version"]
    assert archive["title"] == citation["title"] and archive["license"] == citation["license"] == PROJECT["license"]
    assert archive["keywords"] == citation["keywords"]
    assert [author["name"] for author in archive["creators"]] == [author["name"] for author in citation["authors"]]


def test_changelog_has_the_version() -> None:
    versions = re.findall(r"^## \[(.+)\] - ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert versions[0] == PROJECT["version"]


def test_pythons_of_the_classifiers_are_those_that_are_tested() -> None:
    named = [line.rsplit(" ", 1)[1] for line in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", line)]
    assert _yaml(".github/workflows/ci.yml")["jobs"]["test"]["strategy"]["matrix"]["python-version"] == named
    assert _yaml(".github/workflows/release.yml")["jobs"]["try"]["strategy"]["matrix"]["python-version"] == named


@pytest.mark.parametrize("path", sorted((ROOT / ".github").rglob("*.yml")), ids=lambda path: path.name)
def test_workflows_and_forms_are_yaml_and_scripts_exist(path: Path) -> None:
    content = path.read_text(encoding="utf-8")
    assert yaml.safe_load(content)
    for script in re.findall(r"(?<![\w/])\.ci/[\w.]+", content):
        assert (ROOT / script).is_file(), script
