"""`wtg-gym simulate`, `suites` and `warmup` as a user calls them; the program as a whole: help, pipes, terminals."""

import ast
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import wtg_gym
import wtg_gym.cli
from tests.changes import write
from tests.cli.calls import ROOT, error_of, json_of, printed_by
from wtg_gym import Scenario, evaluate, get_suite, simulate
from wtg_gym.cli import build_app, main, options
from wtg_gym.cli.output import note, print_json, print_table, say
from wtg_gym.physics.scenario import GroupTrip
from wtg_gym.scenarios import DEFAULT_SUITE, FROZEN_HASHES, SUITES
from wtg_gym.systems.compiled import cache_folder

_QUICK = ("--duration", "6")


def test_simulate_tables_every_strategy_with_units_and_all_are_the_built_in_ones_once(capsys):
    laws = ("--strategy", "mppt", "deloaded-5", "--strategy", "coordinated-linear")
    text = printed_by(capsys, "simulate", *_QUICK, *laws).out
    assert "5 s: +75 MW at bus 2" in text
    for unit in ("nadir [Hz]", "zenith [Hz]", "RoCoF, 500 ms [Hz/s]", "rotor speed [p.u.]", "power [p.u.]"):
        assert unit in text
    rows = [line for line in text.splitlines() if line.endswith("completed 6.0 s")]
    assert [row.split()[0] for row in rows] == ["mppt", "deloaded-5", "coordinated-linear"]
    data = json_of(capsys, "simulate", "--duration", "1", "--strategy", "mppt", "all", "--json")
    names = [run["strategy"] for run in data["runs"]]
    assert names[0] == "mppt" and len(names) == len(set(names)) == 6


def test_the_group_that_tripped_is_named(capsys):
    arguments = ("simulate", "--suite", "standard-v1", "--seed", "10029", "--strategy", "mppt")
    (run,) = json_of(capsys, *arguments, "--json")["runs"]
    assert run["status"] == "completed"
    assert [(trip["group"], trip["cause"]) for trip in run["tripped_groups"]] == [(2, "event")]
    at_s = [event.time_s for event in get_suite("standard-v1").scenario(10029).events if isinstance(event, GroupTrip)]
    assert [trip["time_s"] for trip in run["tripped_groups"]] == pytest.approx(at_s)
    said = f"group 2 tripped at {run['tripped_groups'][0]['time_s']:.1f} s (event)"
    assert said in printed_by(capsys, *arguments).out


def test_traces_hold_every_sample_with_units_in_the_header(tmp_path):
    path = tmp_path / "traces.csv"
    assert main(["simulate", *_QUICK, "--strategy", "mppt", "deloaded-10", "--csv", str(path)]) == 0
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert table["strategy"].tolist() == ["mppt"] * 61 + ["deloaded-10"] * 61
    run = simulate(get_suite("paper").scenario(0, duration_s=6.0), "deloaded-10")
    # At the start all machines rest, and without damping torque is power; states have their names.
    assert run.machine_torque_pu[0] == pytest.approx(run.machine_power_pu[0], abs=1e-9)
    assert run.states["wtg1.rotor_speed"].tolist() == run.rotor_speed_pu[:, 1].tolist()
    for name, values in (
        ("frequency_hz", run.frequency_hz),
        ("group_2_rotor_speed_pu", run.rotor_speed_pu[:, 1]),
        ("machine_1_frequency_hz", run.machine_frequency_hz[:, 0]),
        ("bus_14_voltage_pu", run.bus_voltage_pu[:, 13]),
        ("machine_1_power_pu", run.machine_power_pu[:, 0]),
        ("machine_1_torque_pu", run.machine_torque_pu[:, 0]),
        ("group_2_reactive_power_pu", run.reactive_power_pu[:, 1]),
        ("group_1_current_pu", run.current_pu[:, 0]),
        ("group_1_connected", run.connected[:, 0]),
    ):
        assert table[name][61:] == pytest.approx(1.0 * values, rel=1e-8)


def test_key_figures_are_those_of_the_arrays_of_a_run(capsys):
    arguments = ("simulate", "--suite", "standard-v1", "--seed", "10000", "--strategy", "mppt", "--json")
    (figures,) = json_of(capsys, *arguments)["runs"]
    suite = get_suite("standard-v1")
    run = simulate(suite.scenario(10_000), "mppt", suite.plant)
    rocof = run.rocof_hz_s(0.5)
    wanted = {
        **{"nadir_hz": run.frequency_hz.min(), "zenith_hz": run.frequency_hz.max()},
        **{"local_nadir_hz": run.local_frequency_hz.min(), "local_zenith_hz": run.local_frequency_hz.max()},
        "largest_rocof_hz_s": rocof[np.abs(rocof).argmax()],
        "shed_energy_mws": run.shed_energy_mws[-1],
        "final_frequency_hz": run.frequency_hz[-1],
    }
    assert {key: figures[key] for key in wanted} == pytest.approx(wanted, abs=1e-8)
    assert figures["shed_energy_mws"] > 0.0
    assert [trip["group"] for trip in figures["tripped_groups"]] == [1, 2, 3, 4]
    assert {trip["cause"] for trip in figures["tripped_groups"]} == {"under-speed"}
    for trip in figures["tripped_groups"]:
        after, power = run.time_s > trip["time_s"] + 1e-6, run.power_pu[:, trip["group"] - 1]
        assert (power[after] == 0.0).all() and power[~after][-1] != 0.0


def test_wind_and_groups_follow_each_other_or_a_csv_file(capsys, tmp_path):
    data = json_of(capsys, "simulate", "--duration", "1", "--wind", "9", "8", "7", "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.0, 8.0, 7.0]
    assert len(data["plant"]["groups"]) == 3
    data = json_of(capsys, "simulate", "--suite", "paper-v1", "--duration", "1", "--wind", "9", "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.0] * 4
    assert [group["bus"] for group in data["plant"]["groups"]] == [2, 3, 6, 8]
    rows = "".join(f"{second},9.5,8.0\n" for second in range(8))
    path = write(tmp_path / "wind.csv", "time_s,wind_1_m_s,wind_2_m_s\n" + rows)
    data = json_of(capsys, "simulate", *_QUICK, "--wind-csv", str(path), "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.5, 8.0]


def test_suite_of_v1_runs_in_its_own_grid(capsys, tmp_path):
    laws = ("--strategy", "coordinated-piecewise", "coordinated-tuned")
    data = json_of(capsys, "simulate", "--suite", "standard-v1", "--seed", "10003", *laws, "--json")
    played = evaluate([], "standard-v1", seeds=(10_003,))
    for run in data["runs"]:
        (episode,) = played.episodes_of(run["strategy"])
        # The least frequency may lie within a control interval; the command rounds to nine decimals.
        assert -1e-9 < run["nadir_hz"] - episode.metrics["nadir_hz"] < 1e-4
    shown = printed_by(capsys, "suites", "standard-v1", "--seed", "10003", "--json").out
    path = write(tmp_path / "scenario.json", shown)
    again = json_of(capsys, "simulate", "--suite", "standard-v1", "--scenario", str(path), *laws, "--json")
    assert again["runs"] == data["runs"]


def test_plot_replaces_an_older_file_and_leaves_nothing_beside_it(tmp_path):
    pytest.importorskip("matplotlib")
    path = write(tmp_path / "run.PDF", "old")
    assert main(["simulate", *_QUICK, "--plot", str(path)]) == 0
    assert path.stat().st_size > 1000 and list(tmp_path.iterdir()) == [path]


def test_example_of_a_law_is_printed_and_simulated_under_its_own_name(capsys, tmp_path):
    law = write(tmp_path / "my_law.toml", printed_by(capsys, "simulate", "--example-law").out)
    assert law.read_bytes() == (ROOT / "baselines/example_law.toml").read_bytes()
    data = json_of(capsys, "simulate", "--duration", "1", "--strategy", str(law), "--json")
    assert [run["strategy"] for run in data["runs"]] == ["reserve-7"]
    other = write(tmp_path / "other.toml", law.read_text())
    assert "two laws are called 'reserve-7'" in error_of(capsys, "simulate", "--strategy", str(law), str(other))


def test_dumped_scenario_can_be_edited_and_simulated(capsys, tmp_path):
    data = json_of(capsys, "suites", "standard", "--seed", "20003", "--json")
    assert Scenario.from_dict(data).to_json() == get_suite("standard").scenario(20_003).to_json()
    data["events"] = [{"kind": "load_step", "time_s": 2.0, "bus": 3, "power_mw": 30.0}]
    path = write(tmp_path / "mine.json", json.dumps(data))
    result = json_of(capsys, "simulate", *_QUICK, "--scenario", str(path), "--json")
    assert [event["power_mw"] for event in result["scenario"]["events"]] == [30.0]
    assert result["runs"][0]["end_time_s"] == 6.0


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
@pytest.mark.parametrize("words", ["suites standard --seed 20003 --json", "--help"])
def test_reader_that_leaves_early_is_no_error(words):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "wtg_gym.cli", *words.split()]
    done = subprocess.run(command, env=environment, stdout=writing, stderr=subprocess.PIPE, timeout=300)
    os.close(writing)
    assert done.returncode == 141
    assert done.stderr == b""


def test_terminal_gets_a_progress_bar(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    printed = printed_by(capsys, "simulate", *_QUICK)
    assert "━" in printed.err and "coordinated-piecewise" in printed.out and "━" not in printed.out


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
            text = printed_by(capsys, *command, "--help").out
            lines = re.findall(rf"^  (?:\w+=\S+ )?wtg-gym ({' '.join(command)}.*)$", text, re.MULTILINE)
            assert lines, command
            for line in lines:
                words = shlex.split(re.split(r"  +|>", line)[0])
                build_app(words).parse_args(words, exit_on_error=False, print_error=False)


def test_help_is_there_before_the_simulator_and_before_other_commands():
    code = "import sys; from wtg_gym.cli import main\n"
    others = (name for name in build_app([]) if not name.startswith("-") and name not in ("warmup", "suites"))
    for command in ("suites", "", *others):
        code += f"main({[*command.split(), '--help']})\n"
        code += "print({'numba', 'scipy'} & set(sys.modules), 'wtg_gym.cli.simulate' in sys.modules)\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=100)
    lines = [line for line in done.stdout.splitlines() if line.startswith("set() ")]
    assert len(lines) == 10 and lines[0] == "set() False", done.stderr


def _is_harmless(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


def test_lines_tables_notes_and_json_show_escapes(capsys):
    say(NASTY)
    note(NASTY)
    print_table((NASTY, "b"), [(NASTY, "1")])
    printed = capsys.readouterr()
    assert _is_harmless(printed.out) and _is_harmless(printed.err)
    assert (printed.out.count("\n"), printed.err.count("\n")) == (4, 1)
    assert r"a\x1b[31mred" in printed.err and r"\u202eabc" in printed.out
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
    text = printed_by(capsys, "suites").out
    assert all(name in text and own[:12] in text for name, own in hashes.items())


def test_suite_of_v1_is_shown_with_its_grid_sensors_and_task(capsys):
    (data,) = json_of(capsys, "suites", "standard-v1")
    assert (data["environment"], data["hash"]) == ("GFMWTG-14bus-v1", SUITES["standard-v1"].hash)
    groups = [(group["bus"], group["n_turbines"]) for group in data["plant"]["groups"]]
    assert groups == [(2, 20.0), (3, 14.0), (6, 10.0), (8, 8.0)]
    assert data["sensors"]["delay_s"] == [0.1, 0.3]
    (data,) = json_of(capsys, "suites", "no-wind-sensor-v1", "--json")
    assert data["sensors"]["wind_sensor"] is False and data["plant"]["physics"] == "extended"


def test_after_a_warmup_nothing_is_compiled_and_nothing_said():
    assert main(["warmup"]) == 0
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-c", _COMMANDS]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, encoding="utf-8", timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"nothing to compile: machine code came with the package or is in {cache_folder()}\n")
    assert "compile" not in done.stderr
