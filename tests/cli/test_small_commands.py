"""`wtg-gym suites` and `warmup` as a user calls them."""

import os
import subprocess
import sys

from tests.cli.calls import ROOT, json_of
from wtg_gym.cli import main
from wtg_gym.scenarios import FROZEN_HASHES, SUITES
from wtg_gym.systems.compiled import cache_folder


def test_suites_lists_every_suite(capsys):
    listed = json_of(capsys, "suites", "--json")
    hashes = {suite["name"]: suite["hash"] for suite in listed}
    assert list(hashes) == list(SUITES) and FROZEN_HASHES.items() <= hashes.items()
    assert main(["suites"]) == 0
    text = capsys.readouterr().out
    assert all(name in text and own[:12] in text for name, own in hashes.items())


def test_suite_of_v1_is_shown_with_its_grid_sensors_and_task(capsys):
    (data,) = json_of(capsys, "suites", "standard-v1")
    assert (data["environment"], data["hash"]) == ("GFMWTG-14bus-v1", SUITES["standard-v1"].hash)
    assert [(g["bus"], g["n_turbines"]) for g in data["plant"]["groups"]] == [
        *((2, 20.0), (3, 14.0), (6, 10.0), (8, 8.0))
    ]
    assert data["sensors"]["delay_s"] == [0.1, 0.3]
    (data,) = json_of(capsys, "suites", "no-wind-sensor-v1", "--json")
    assert data["sensors"]["wind_sensor"] is False and data["plant"]["physics"] == "extended"


_COMMANDS = """
from wtg_gym.cli import main

for arguments in (
    "warmup",
    "simulate --duration 3",
    "evaluate --suite paper --entries mppt",
    "simulate --suite standard-v1 --duration 3",
    "evaluate --suite standard-v1 --scenarios 2 --duration 3 --entries mppt",
):
    assert main(arguments.split()) == 0
"""


def test_after_a_warmup_nothing_is_compiled_and_nothing_said():
    assert main(["warmup"]) == 0
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-c", _COMMANDS]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, encoding="utf-8", timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"nothing to compile: all machine code is in {cache_folder()}\n")
    assert "compile" not in done.stderr
