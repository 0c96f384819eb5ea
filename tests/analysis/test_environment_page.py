"""The page of the environments says what the environments are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from wtg_gym.analysis.environment_page import environment_page
from wtg_gym.envs import EnvArguments, GFMWTGEnv
from wtg_gym.scenarios import SUITES

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "environment.md"


def test_page_is_up_to_date() -> None:
    assert environment_page() in _PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("version", ["v0", "v1"])
def test_every_entry_of_the_observation_has_its_name_unit_and_bounds(version: str) -> None:
    env = GFMWTGEnv(version=version)
    text = environment_page().partition("## Observation Space")[2]
    table = text.partition(f"`GFMWTG-14bus-{version}`, an entry")[2].split("\n\n")[1]
    listed: dict[int, tuple[str, ...]] = {}
    for row in re.findall(r"^\| ([\d, ]+) \| (\w+) \| (.*?) \| (\S+) \| (\S+) \|", table, re.MULTILINE):
        listed.update({int(entry): row[1:] for entry in row[0].split(",")})
    assert sorted(listed) == list(range(len(env.observation_names)))
    for entry, said in enumerate(env.observation_names):
        name, unit, least, most = listed[entry]
        assert re.sub(r"^wtg\d+\.", "", said) == (f"{name} [{unit}]" if unit != "-" else name)
        assert (float(least), float(most)) == (env.observation_space.low[entry], env.observation_space.high[entry])


def test_every_argument_and_suite_is_on_the_page() -> None:
    text = environment_page()
    rows = re.findall(r"^\| `(\w+)` \| .*? \| (.+?) \|$", text.partition("## Arguments")[2], re.MULTILINE)
    assert [name for name, _ in rows] == list(EnvArguments.__annotations__)
    assert all(f"`{name}`" in text for name in SUITES)
