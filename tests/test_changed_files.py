"""Facts about files that somebody has changed: read all the same, or refused in one line that names them."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agents.run import RUN_FILE, Run, RunSettings
from agents.train import CONFIG_FOLDER, read_config
from tests.changes import changed, read_or_refused, write
from wtg_gym.cli import main
from wtg_gym.cli.simulation import read_scenario
from wtg_gym.files import find_markers, parse_toml, to_json
from wtg_gym.physics.grid import FOLDER, get_grid
from wtg_gym.physics.parameters import ROTOR_TABLE
from wtg_gym.physics.rotor_table import read_rotor_table
from wtg_gym.physics.tracking_law import read_law
from wtg_gym.policies.entry_folder import ENTRY_FILE, POLICY_FILE, load_entry_folder, policy_folders
from wtg_gym.scenarios import get_suite, read_wind_csv

LAW = {"name": "mine", "k_min": 1.0, "k_nominal": 0.66, "deloading_max": 20.0, "tau_s": 0.2}


def json_text(data: Any) -> str:
    return json.dumps(data)


def toml_text(data: dict[str, Any]) -> str:
    # Texts and lists are written alike in both.
    return "".join(f"{json.dumps(key)} = {json.dumps(value)}\n" for key, value in data.items())


def table_text(rows: list[list[Any]]) -> str:
    return "\n".join(",".join(map(str, row if isinstance(row, list) else [row])) for row in rows)


def lines_text(lines: list[Any]) -> str:
    return "\n".join(map(str, lines))


def grid_of_file(path: Path) -> None:
    get_grid(str(path))


def suite_of_file(path: Path) -> None:
    get_suite(str(path))


def entry_of_folder(path: Path) -> None:
    (path.parent / POLICY_FILE).write_bytes(b"never looked at")
    load_entry_folder(path.parent)


def a_run() -> dict[str, Any]:
    settings = RunSettings(algo="ppo", hyperparameters={"gamma": 0.99}, timesteps=100, n_envs=2)
    run = Run.new(Path(), settings)
    run.curve.append({"timesteps": 50, "wall_time_s": 1.0, "score": 3.0, "marked": 1.0})
    run.resumptions.append(run.provenance)
    data = {name: value for name, value in dataclasses.asdict(run).items() if name not in ("folder", "_began")}
    written: dict[str, Any] = json.loads(to_json(data))
    return written


@functools.cache
def original(kind: str) -> Any:
    """The data of a file of a kind that is read as it is."""
    if kind in ("ieee14", "nordic45"):
        return json.loads((FOLDER / f"{kind}.json").read_text())
    return {
        "suite": lambda: json.loads((FOLDER / "suites" / "ieee39.json").read_text()),
        "scenario": lambda: get_suite("standard-v1").scenario(10_001, duration_s=2.0).to_dict(),
        "law": lambda: LAW,
        "entry": lambda: parse_toml((policy_folders()[0] / ENTRY_FILE).read_text(), "it"),
        "run": a_run,
        "config": lambda: yaml.safe_load((CONFIG_FOLDER / "ppo.yml").read_text()),
        "wind": lambda: [["time_s", "a", "b"], *([0.5 * i, 8.0, 9.5] for i in range(9))],
        "rotor": lambda: ROTOR_TABLE.read_text().splitlines(),
        "markers": lambda: ["# Title", "<!-- table:start -->", "old", "<!-- table:end -->"],
    }[kind]()


KINDS: dict[str, tuple[str, Callable[[Any], str], Callable[[Path], object]]] = {
    "ieee14": ("grid.json", json_text, grid_of_file),
    "nordic45": ("grid.json", json_text, grid_of_file),
    "suite": ("suite.json", json_text, suite_of_file),
    "scenario": ("scenario.json", json_text, lambda path: read_scenario(path, get_suite("standard-v1"))),
    "law": ("law.toml", toml_text, read_law),
    "entry": (ENTRY_FILE, toml_text, entry_of_folder),
    "run": (RUN_FILE, json_text, lambda path: Run.read(path.parent)),
    "config": ("ppo.yml", lambda data: yaml.dump(data), lambda path: read_config(path, "GFMWTG-14bus-v1")),
    "wind": ("wind.csv", table_text, lambda path: read_wind_csv(path, duration_s=3.0)),
    "rotor": ("rotor.txt", lines_text, read_rotor_table),
    "markers": ("README.md", lines_text, lambda path: find_markers(path, "table")),
}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_changed_file_is_read_or_refused_in_a_line_with_its_name(tmp_path: Path, kind: str, data: st.DataObject):
    name, text_of, read = KINDS[kind]
    path = tmp_path / name
    write(path, text_of(original(kind)))
    read(path)
    write(path, text_of(data.draw(changed(original(kind)))))
    read_or_refused(path, read)


#: Kinds of files with a command that reads one, and plays a second with it at most.
COMMANDS = {
    "ieee14": ["grid", "check", "grid.json"],
    "suite": ["suites", "suite.json", "--seed", "10000"],
    "scenario": ["simulate", "--suite", "standard-v1", "--duration", "1", "--scenario", "scenario.json"],
    "law": ["simulate", "--duration", "1", "--strategy", "law.toml"],
}


@pytest.mark.parametrize("kind", COMMANDS)
@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_command_works_with_a_changed_file_or_ends_in_a_line(
    tmp_path: Path, kind: str, data: st.DataObject, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    name, text_of, _ = KINDS[kind]
    write(tmp_path / name, text_of(data.draw(changed(original(kind)))))
    code, said = main(COMMANDS[kind]), capsys.readouterr()
    assert code in (0, 1) or (code, said.out, said.err.count("\n")) == (2, "", 1)
