"""The program as a whole: help, pipes, terminals; `wtg-gym suites` and `warmup`."""

import ast
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import wtg_gym
import wtg_gym.cli
from tests.cli.calls import ROOT, json_of
from wtg_gym.cli import build_app, main, options
from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.scenarios import DEFAULT_SUITE, FROZEN_HASHES, SUITES
from wtg_gym.systems.compiled import cache_folder

#: Colours, the title of a window, C1 controls, a changed direction, a line of its own, half a surrogate pair.
NASTY = "a\x1b[31mred\x1b]0;title\x07\x9b2J\x7f\u202eabc\u2066\r\nwtg-gym: all is well\ud800\u2028z"
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


@pytest.mark.skipif(sys.platform == "win32", reason="pipes break in another way there")
def test_reader_that_leaves_early_is_no_error():
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "wtg_gym.cli", "suites", "standard", "--seed", "20003", "--json"]
    done = subprocess.run(command, env=environment, stdout=writing, stderr=subprocess.PIPE, timeout=300)
    os.close(writing)
    assert done.returncode == 141
    assert done.stderr == b""


def test_terminal_gets_a_progress_bar(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    assert main(["simulate", "--duration", "6"]) == 0
    said = capsys.readouterr()
    assert "━" in said.err and "coordinated-piecewise" in said.out and "━" not in said.out


def test_help_of_every_command_teaches_by_examples_that_it_takes(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.chdir(tmp_path)
    for name in ("my-policy", "my-policy-*"):
        (tmp_path / name).mkdir()
    names = [name for name in build_app([]) if not name.startswith("-")]
    assert len(names) == 10
    for name in names:
        own = [part for part in build_app([name])[name] if not part.startswith("-")]
        for command in [(name, part) for part in own] or [(name,)]:
            assert main([*command, "--help"]) == 0
            text = capsys.readouterr().out
            lines = re.findall(rf"^  (?:\w+=\S+ )?wtg-gym ({' '.join(command)}.*)$", text, re.MULTILINE)
            assert lines, command
            for line in lines:
                words = shlex.split(re.split(r"  +|>", line)[0])
                build_app(words).parse_args(words, exit_on_error=False, print_error=False)


def test_help_is_there_before_the_simulator_and_before_other_commands():
    code = "import sys; from wtg_gym.cli import main\n"
    for command in ("", *(name for name in build_app([]) if not name.startswith("-") and name != "warmup")):
        code += f"main({[*command.split(), '--help']}); print({{'numba', 'scipy'}} & set(sys.modules))\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=100)
    assert done.stdout.splitlines().count("set()") == 10, done.stderr
    code = "import sys; from wtg_gym.cli import main; main(['suites', 'paper'])\n"
    code += "print('wtg_gym.cli.simulate' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=100)
    assert done.stdout.endswith("False\n"), done.stderr


def _is_harmless(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


def test_lines_tables_notes_and_json_show_escapes(capsys):
    say(NASTY)
    note(NASTY)
    print_table((NASTY, "b"), [(NASTY, "1")])
    said = capsys.readouterr()
    assert _is_harmless(said.out) and _is_harmless(said.err)
    assert (said.out.count("\n"), said.err.count("\n")) == (4, 1)
    assert r"a\x1b[31mred" in said.err and r"\u202eabc" in said.out
    data = {NASTY: [NASTY, "grün 🜁", {"x": 1.5}]}
    print_json(data)
    out = capsys.readouterr().out
    assert _is_harmless(out) and "grün 🜁" in out and json.loads(out) == data


def test_no_command_prints_past_the_one_place_that_escapes():
    for path in Path(wtg_gym.cli.__file__).parent.glob("*.py"):
        calls = [node.func for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        printing = [call for call in calls if isinstance(call, ast.Name) and call.id == "print"]
        assert not printing or path.name in ("output.py", "__init__.py"), path


def test_suites_lists_every_suite_and_commands_mean_that_of_the_benchmark(capsys):
    assert options.DEFAULT_SUITE == DEFAULT_SUITE
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


def test_after_a_warmup_nothing_is_compiled_and_nothing_said():
    assert main(["warmup"]) == 0
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-c", _COMMANDS]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, encoding="utf-8", timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"nothing to compile: all machine code is in {cache_folder()}\n")
    assert "compile" not in done.stderr
