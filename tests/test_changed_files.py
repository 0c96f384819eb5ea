"""Facts about files that somebody has changed: read all the same, or refused in one line that names them."""

import dataclasses
import json
from pathlib import Path

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
STANDARD_V1 = get_suite("standard-v1")
COMMANDS = {
    "ieee14": ["grid", "check", "grid.json"],
    "suite": ["suites", "suite.json", "--seed", "10000"],
    "scenario": ["simulate", "--suite", "standard-v1", "--duration", "1", "--scenario", "scenario.json"],
    "law": ["simulate", "--duration", "1", "--strategy", "law.toml"],
}


def toml_text(data) -> str:
    # Texts and lists are written alike in both.
    return "".join(f"{json.dumps(key)} = {json.dumps(value)}\n" for key, value in data.items())


def lines_text(rows) -> str:
    return "\n".join(",".join(map(str, row if isinstance(row, list) else [row])) for row in rows)


def entry_of_folder(path: Path) -> None:
    (path.parent / POLICY_FILE).write_bytes(b"never looked at")
    load_entry_folder(path.parent)


def a_run():
    settings = RunSettings(algo="ppo", hyperparameters={"gamma": 0.99}, timesteps=100, n_envs=2)
    run = Run.new(Path(), settings)
    run.curve.append({"timesteps": 50, "wall_time_s": 1.0, "score": 3.0, "marked": 1.0})
    run.resumptions.append(run.provenance)
    data = {name: value for name, value in dataclasses.asdict(run).items() if name not in ("folder", "_began")}
    return json.loads(to_json(data))


#: By kind: a file's name, its data, what makes a text of data, and what reads the file.
KINDS = {
    **{
        name: ("grid.json", json.loads((FOLDER / f"{name}.json").read_text()), json.dumps, lambda p: get_grid(str(p)))
        for name in ("ieee14", "nordic45")
    },
    "suite": (
        *("suite.json", json.loads((FOLDER / "suites" / "ieee39.json").read_text()), json.dumps),
        lambda path: get_suite(str(path)),
    ),
    "scenario": (
        *("scenario.json", STANDARD_V1.scenario(10_001, duration_s=2.0).to_dict(), json.dumps),
        lambda path: read_scenario(path, STANDARD_V1),
    ),
    "law": ("law.toml", LAW, toml_text, read_law),
    "entry": (ENTRY_FILE, parse_toml((policy_folders()[0] / ENTRY_FILE).read_text(), "it"), toml_text, entry_of_folder),
    "run": (RUN_FILE, a_run(), json.dumps, lambda path: Run.read(path.parent)),
    "config": (
        *("ppo.yml", yaml.safe_load((CONFIG_FOLDER / "ppo.yml").read_text()), yaml.dump),
        lambda path: read_config(path, "GFMWTG-14bus-v1"),
    ),
    "wind": (
        *("wind.csv", [["time_s", "a", "b"], *([0.5 * i, 8.0, 9.5] for i in range(9))], lines_text),
        lambda path: read_wind_csv(path, duration_s=3.0),
    ),
    "rotor": ("rotor.txt", ROTOR_TABLE.read_text().splitlines(), lines_text, read_rotor_table),
    "markers": (
        *("README.md", ["# Title", "<!-- table:start -->", "old", "<!-- table:end -->"], lines_text),
        lambda path: find_markers(path, "table"),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_changed_file_is_read_or_refused_in_a_line_with_its_name(tmp_path, kind, data):
    name, original, text_of, read = KINDS[kind]
    path = tmp_path / name
    write(path, text_of(original))
    read(path)
    write(path, text_of(data.draw(changed(original))))
    read_or_refused(path, read)


@pytest.mark.parametrize("kind", COMMANDS)
@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_command_works_with_a_changed_file_or_ends_in_a_line(tmp_path, kind, data, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, original, text_of, _ = KINDS[kind]
    write(tmp_path / name, text_of(data.draw(changed(original))))
    code, said = main(COMMANDS[kind]), capsys.readouterr()
    assert code in (0, 1) or (code, said.out, said.err.count("\n")) == (2, "", 1)
