"""The command line, as a user calls it."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import wtg_gym
import wtg_gym.cli.scores
import wtg_gym.cli.simulate
import wtg_gym.cli.suites
from wtg_gym.cli import main
from wtg_gym.physics.scenario import Scenario
from wtg_gym.scenarios import FROZEN_HASHES, SUITES, get_suite

_QUICK = ("--duration", "6")
_ROOT = Path(__file__).resolve().parent.parent


def _call(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-m", "wtg_gym.cli", *arguments]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, encoding="utf-8", timeout=300)


def _error(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line of an error, once the exit code and the silence of stdout are checked."""
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    lines = said.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("wtg-gym: error: ")
    return lines[0]


def _json(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> Any:
    assert main(arguments) == code
    return json.loads(capsys.readouterr().out)


# --- the program -----------------------------------------------------------------------------------------------------


def test_program_runs_as_a_module_and_prints_only_json_on_stdout(tmp_path: Path) -> None:
    done = _call("simulate", *_QUICK, "--json", "--csv", "traces.csv", cwd=tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["runs"][0]["strategy"] == "coordinated-piecewise"
    # A first call that has to compile reports its progress before that.
    assert done.stderr.endswith("wrote traces.csv\n")


def test_bad_input_is_one_line_without_a_traceback(tmp_path: Path) -> None:
    done = _call("simulate", "--wind", "-3", "--plot", "run.png", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "-3 m/s, outside the allowed range 3 … 25 m/s" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="pipes break in another way there")
def test_reader_that_leaves_early_is_no_error() -> None:
    environment = {**os.environ, "PYTHONPATH": str(_ROOT)}
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "wtg_gym.cli", "suites", "standard", "--seed", "20003", "--json"]
    done = subprocess.run(command, env=environment, stdout=writing, stderr=subprocess.PIPE, timeout=300)
    os.close(writing)
    assert done.returncode == 141
    assert done.stderr == b""


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals there")
@pytest.mark.parametrize("arguments", [("simulate", *_QUICK), ("evaluate", "--entries", "mppt", "--suite", "paper")])
def test_terminal_gets_a_drawn_table_and_a_progress_bar(arguments: tuple[str, ...]) -> None:
    pytest.importorskip("rich")
    import pty

    own, theirs = pty.openpty()
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "COLUMNS": "200", "TERM": "xterm"}
    command = [sys.executable, "-m", "wtg_gym.cli", *arguments]
    process = subprocess.Popen(command, env=environment, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    shown = b""
    # At the end of the output Linux raises, others return nothing.
    with contextlib.suppress(OSError):
        while chunk := os.read(own, 4096):
            shown += chunk
    os.close(own)
    assert process.wait(timeout=100) == 0
    text = shown.decode()
    assert "Traceback" not in text
    assert "coordinated-piecewise" in text
    assert "─" in text


@pytest.mark.parametrize("columns", ["60", "120", "180", "240"])
def test_no_column_is_lost_in_a_narrow_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, columns: str
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main(["simulate", *_QUICK]) == 0
    text = capsys.readouterr().out
    assert "final power [p.u.]" in text
    assert "completed 6.0 s" in text


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"wtg-gym {wtg_gym.__version__}\n"


@pytest.mark.parametrize("command", ["simulate", "evaluate", "leaderboard", "suites"])
def test_help_of_each_command_teaches(capsys: pytest.CaptureFixture[str], command: str) -> None:
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert "examples:\n  wtg-gym " in text
    assert "--json" in text


def test_help_lists_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    assert all(command in text for command in ("simulate", "evaluate", "leaderboard", "suites"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "required: COMMAND"),
        (("fly",), "invalid choice: 'fly'"),
        (("simulate", "--wnd", "8"), "--wnd"),
        (("simulate", "--case", "load-increase", "--suite", "paper"), "not allowed with argument --case"),
        (("simulate", "--wind", "strong"), "invalid float value: 'strong'"),
    ],
)
def test_wrong_usage_points_to_the_help(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    line = _error(capsys, *arguments)
    assert said in line
    assert "--help" in line


def test_interrupt_exits_with_130_and_says_what_is_left(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(wtg_gym.cli.simulate, "simulate", interrupt)
    assert main(["simulate", *_QUICK]) == 130
    assert "wtg-gym: interrupted; nothing was written" in capsys.readouterr().err


# --- simulate --------------------------------------------------------------------------------------------------------


def test_simulate_tables_every_strategy_with_units(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", *_QUICK, "--strategy", "mppt", "deloaded-5", "--strategy", "coordinated-linear"]) == 0
    text = capsys.readouterr().out
    assert "5 s: +75 MW at bus 2" in text
    for unit in ("nadir [Hz]", "zenith [Hz]", "RoCoF, 500 ms [Hz/s]", "rotor speed [p.u.]", "power [p.u.]"):
        assert unit in text
    rows = [line for line in text.splitlines() if line.endswith("completed 6.0 s")]
    assert [row.split()[0] for row in rows] == ["mppt", "deloaded-5", "coordinated-linear"]


def test_strategy_all_is_every_built_in_one_once(capsys: pytest.CaptureFixture[str]) -> None:
    data = _json(capsys, "simulate", "--duration", "1", "--strategy", "mppt", "all", "--json")
    names = [run["strategy"] for run in data["runs"]]
    assert len(names) == len(set(names)) == 6
    assert names[0] == "mppt"


def test_deloaded_strategy_is_reported_to_stall_in_the_papers_load_increase(
    capsys: pytest.CaptureFixture[str],
) -> None:
    data = _json(capsys, "simulate", "--case", "load-increase", "--strategy", "deloaded-5", "--json")
    (run,) = data["runs"]
    assert (run["status"], run["failed_group"]) == ("stall", 2)
    assert 30.0 < run["end_time_s"] < 120.0
    assert 49.5 < run["nadir_hz"] < 49.9 < run["zenith_hz"]
    assert -1.0 < run["largest_rocof_hz_s"] < 0.0
    assert run["rocof_window_s"] == 0.5


def test_on_failure_trip_names_the_group_that_tripped(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("simulate", "--strategy", "mppt", "--on-failure", "trip")
    (run,) = _json(capsys, *arguments, "--json")["runs"]
    assert run["status"] == "completed"
    assert [trip["group"] for trip in run["tripped_groups"]] == [2]
    assert main(arguments) == 0
    assert f"group 2 tripped at {run['tripped_groups'][0]['time_s']:.1f} s" in capsys.readouterr().out


def test_wind_and_groups_follow_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    data = _json(capsys, "simulate", "--duration", "1", "--wind", "9", "8", "7", "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.0, 8.0, 7.0]
    assert len(data["plant"]["groups"]) == 3
    data = _json(capsys, "simulate", "--duration", "1", "--wind", "9", "--groups", "3", "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.0] * 3
    assert "give one or 2" in _error(capsys, "simulate", "--wind", "9", "8", "7", "--groups", "2")


def test_traces_hold_every_sample_with_units_in_the_header(tmp_path: Path) -> None:
    path = tmp_path / "traces.csv"
    assert main(["simulate", *_QUICK, "--strategy", "mppt", "deloaded-10", "--csv", str(path)]) == 0
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 61
    assert {row["strategy"] for row in rows} == {"mppt", "deloaded-10"}
    assert {"time_s", "frequency_hz", "rocof_hz_s", "group_1_power_pu", "group_2_rotor_speed_pu"} <= set(rows[0])
    assert float(rows[0]["frequency_hz"]) == pytest.approx(50.0)
    assert float(rows[60]["time_s"]) == 6.0


@pytest.mark.parametrize("name", ["run.png", "run.svg", "run.PDF"])
def test_plot_replaces_an_older_file_and_leaves_nothing_beside_it(tmp_path: Path, name: str) -> None:
    pytest.importorskip("matplotlib")
    path = tmp_path / name
    path.write_text("old", encoding="utf-8")
    assert main(["simulate", *_QUICK, "--plot", str(path)]) == 0
    assert path.stat().st_size > 1000
    assert list(tmp_path.iterdir()) == [path]


def test_missing_matplotlib_is_said_before_anything_runs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    line = _error(capsys, "simulate", "--plot", str(tmp_path / "run.png"))
    assert "--plot needs the leaderboard extra: pip install 'wtg-gym[leaderboard]'" in line


def test_law_file_is_simulated_under_its_own_name(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    law = tmp_path / "law.toml"
    law.write_text('name = "mine"\nk_min = 1.0\nk_nominal = 0.7\nk_max = 0.5\ntau_s = 0.5\n', encoding="utf-8")
    data = _json(capsys, "simulate", "--duration", "1", "--strategy", str(law), "--json")
    assert data["runs"][0]["strategy"] == "mine"
    other = tmp_path / "other.toml"
    other.write_text(law.read_text(encoding="utf-8"), encoding="utf-8")
    assert "two strategies are called 'mine'" in _error(capsys, "simulate", "--strategy", str(law), str(other))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--strategy", "turbo"), "unknown strategy 'turbo'; known strategies: mppt"),
        (("--suite", "storm"), "unknown suite 'storm'; known suites: paper"),
        (("--case", "storm"), "unknown case 'storm'; known cases: load-increase, load-decrease"),
        (("--suite", "standard", "--seed", "3"), "seed 3 is in no split"),
        (("--seed", "3"), "--seed 3 needs a suite"),
        (("--wind", "-1"), "-1 m/s, outside the allowed range 3 … 25 m/s"),
        (("--duration", "nan"), "duration_s = nan s is outside the allowed range 0.1 … 86400 s"),
        (("--duration", "10.05"), "10.05 s is not a whole number of"),
        (("--simulation-dt", "0.03"), "control_dt = 0.1 s is not a whole number of"),
        (("--simulation-dt", "0.2"), "simulation_dt = 0.2 s is outside the allowed range"),
        (("--groups", "0"), "the number of WTG groups must be 1 … 1024, got 0"),
        (("--plot", "run.jpg"), "it must end in .png, .svg, .pdf"),
        (("--csv", "run.txt"), "it must end in .csv"),
        (("--csv", "nowhere/run.csv"), "there is no folder nowhere"),
        (("--scenario", "nowhere.json"), "cannot read the scenario file nowhere.json"),
        (("--wind-csv", "nowhere.csv"), "nowhere.csv: No such file"),
    ],
)
def test_simulate_refuses_bad_input(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in _error(capsys, "simulate", *arguments)
    assert not list(tmp_path.iterdir())


def test_folder_in_the_place_of_a_file_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "run.csv").mkdir()
    assert "it exists and is not a file" in _error(capsys, "simulate", "--csv", str(tmp_path / "run.csv"))


# --- scenario and wind files -----------------------------------------------------------------------------------------


def _wind_csv(path: Path, times: list[float]) -> str:
    lines = ["time_s,wind_1_m_s,wind_2_m_s", *(f"{time:g},9.5,8.0" for time in times)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(path)


def test_wind_from_csv_replaces_the_wind(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = _wind_csv(tmp_path / "wind.csv", [float(second) for second in range(8)])
    data = _json(capsys, "simulate", *_QUICK, "--wind-csv", path, "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.5, 8.0]
    assert "has wind for 2 WTG groups, --groups asks for 3" in _error(
        capsys, "simulate", "--wind-csv", path, "--groups", "3"
    )
    assert "the series ends after 7 s, at least 120 s" in _error(capsys, "simulate", "--wind-csv", path)


def test_wind_csv_with_a_gap_names_the_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = _wind_csv(tmp_path / "wind.csv", [0.0, 1.0, 2.0, 5.0, 6.0])
    line = _error(capsys, "simulate", *_QUICK, "--wind-csv", path)
    assert "line 5: gap or change of step in time" in line


def _scenario_file(path: Path, **changes: Any) -> str:
    data = get_suite("standard").scenario(20_003).to_dict()
    data.update(changes)
    path.write_text(json.dumps(data), encoding="utf-8")
    return str(path)


def test_dumped_scenario_can_be_edited_and_simulated(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = _json(capsys, "suites", "standard", "--seed", "20003", "--json")
    assert Scenario.from_dict(data).to_json() == get_suite("standard").scenario(20_003).to_json()
    data["events"] = [{"kind": "load_step", "time_s": 2.0, "bus": 3, "power_mw": 30.0}]
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    result = _json(capsys, "simulate", *_QUICK, "--scenario", str(path), "--json")
    assert [event["power_mw"] for event in result["scenario"]["events"]] == [30.0]
    assert result["runs"][0]["end_time_s"] == 6.0
    assert "has wind for 2 WTG groups, --groups asks for 3" in _error(
        capsys, "simulate", "--scenario", str(path), "--groups", "3"
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"events": [{"kind": "load_step", "time_s": 2.0, "bus": 99, "power_mw": 30.0}]}, "unknown bus 99"),
        ({"events": [{"kind": "storm"}]}, "an event needs a kind out of load_step"),
        ({"wind_speed": [[9.0], [-2.0]]}, "-2 m/s, outside the allowed range 3 … 25 m/s"),
        ({"inertia_scale": 0.0}, "inertia_scale = 0 is outside the allowed range 0.05 … 5"),
        ({"colour": "red"}, "unknown scenario keys ['colour']"),
    ],
)
def test_scenario_file_with_a_wrong_value_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    assert said in _error(capsys, "simulate", "--scenario", _scenario_file(tmp_path / "s.json", **changes))


def test_scenario_file_that_is_not_json_is_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "broken.json"
    path.write_text('{"name": ', encoding="utf-8")
    line = _error(capsys, "simulate", "--scenario", str(path))
    assert "broken.json is not JSON" in line


# --- suites ----------------------------------------------------------------------------------------------------------


def test_suites_lists_every_suite(capsys: pytest.CaptureFixture[str]) -> None:
    listed = _json(capsys, "suites", "--json")
    assert {suite["name"]: suite["hash"] for suite in listed} == dict(FROZEN_HASHES)
    assert main(["suites"]) == 0
    text = capsys.readouterr().out
    assert all(name in text and FROZEN_HASHES[name][:12] in text for name in SUITES)


def test_suite_is_shown_with_its_splits(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["suites", "standard"]) == 0
    text = capsys.readouterr().out
    assert "200 scenarios, seeds 20000 … 20199" in text
    assert "mean_wind_m_s" in text


def test_scenario_is_shown_with_wind_grid_and_events(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["suites", "paper", "--seed", "1"]) == 0
    text = capsys.readouterr().out
    assert "mean wind    11.4, 8 m/s" in text
    assert "5 s: load of bus 4 lost" in text
    assert "inertia 100 %" in text


def test_hash_check_passes_and_fails_by_exit_code(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["suites", "--check"]) == 0
    assert "DIFFERS" not in capsys.readouterr().out
    monkeypatch.setattr(wtg_gym.cli.suites, "FROZEN_HASHES", {**FROZEN_HASHES, "gust": "0" * 64})
    rows = _json(capsys, "suites", "--check", "--json", code=1)
    assert [row["name"] for row in rows if not row["agrees"]] == ["gust"]
    assert main(["suites", "--check", "paper"]) == 0


def test_suites_refuses_unknown_names_and_seeds(capsys: pytest.CaptureFixture[str]) -> None:
    assert "unknown suite 'storm'" in _error(capsys, "suites", "storm")
    assert "seed 5 is in no split" in _error(capsys, "suites", "standard", "--seed", "5")
    assert "--seed 5 needs a suite" in _error(capsys, "suites", "--seed", "5")


# --- evaluate and leaderboard ----------------------------------------------------------------------------------------

_FEW = ("--suite", "low-wind", "--seeds", "20000:20003", "20005")
_PAPER = ("leaderboard", "--suite", "paper", "--entries", "mppt", "deloaded-5", "coordinated-piecewise")


def _count_played(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Names of the entries of every evaluation from now on."""
    played: list[list[str]] = []
    real = wtg_gym.cli.scores.evaluate

    def counting(entries: Any, *arguments: Any, **named: Any) -> Any:
        played.append([entry.name for entry in entries])
        return real(entries, *arguments, **named)

    monkeypatch.setattr(wtg_gym.cli.scores, "evaluate", counting)
    return played


def test_evaluate_scores_entries_and_writes_results(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    assert main(["evaluate", "--entries", "deloaded-5", *_FEW, "--results", str(folder)]) == 0
    said = capsys.readouterr()
    assert "4 scenarios" in said.out
    assert "score" in said.out and "median nadir [Hz]" in said.out
    assert all(name in said.out for name in ("deloaded-5", "mppt", "coordinated-piecewise"))
    assert sorted(path.name for path in folder.iterdir()) == ["low-wind-test.csv", "low-wind-test.json"]


def test_evaluate_json_is_the_description_with_the_summary(capsys: pytest.CaptureFixture[str]) -> None:
    data = _json(capsys, "evaluate", "--entries", "deloaded-5", *_FEW, "--machine-model", "classical", "--json")
    assert data["seeds"] == [20_000, 20_001, 20_002, 20_005]
    assert set(data["summary"]) == {"deloaded-5", "mppt", "coordinated-piecewise"}
    assert data["summary"]["coordinated-piecewise"]["score"]["value"] == 100.0
    assert data["settings"]["machine_model"] == "classical"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--entries", "turbo"), "'turbo'"),
        (("--entries", "mppt", "mppt"), "mppt more than once"),
        (("--suite", "storm"), "unknown suite 'storm'"),
        (("--seeds", "3"), "the test seeds of suite 'standard' are 20000 … 20199"),
        (("--seeds", "20000-20010"), "expected a seed such as 20003, or a range such as 20000:20010"),
        (("--seeds", "20010:20000"), "0 seeds, a range must hold 1 … 100000"),
        (("--seeds", "0:999999999999"), "a range must hold 1 … 100000"),
        (("--duration", "0.2"), "duration_s = 0.2 s is outside the allowed range 1 … 3600 s"),
        (("--simulation-dt", "0.03"), "0.1 s is not a whole number of"),
        (("--threads", "0"), "the number of threads must be 1 or more, got 0"),
        (("--results", "file.txt"), "file.txt is not a folder"),
    ],
)
def test_evaluate_refuses_bad_input(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    said: str,
) -> None:
    (tmp_path / "file.txt").write_text("not a folder", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    entries = () if "--entries" in arguments else ("--entries", "mppt")
    assert said in _error(capsys, "evaluate", *entries, *arguments)
    assert [path.name for path in tmp_path.iterdir()] == ["file.txt"]


def test_missing_baselines_say_how_to_go_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wtg_gym.cli.scores, "_DEFAULT_ENTRIES", "no_such_package")
    line = _error(capsys, "leaderboard", "--entries", "no_such_package")
    assert "run the command in the root of a checkout, or say what to score with --entries" in line


@pytest.mark.skipif(sys.platform == "win32", reason="signals are another thing there")
def test_interrupted_leaderboard_keeps_its_finished_parts(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(_ROOT)}
    command = [sys.executable, "-m", "wtg_gym.cli", "leaderboard", "--entries"]
    command += ["deloaded-5", "deloaded-10", "coordinated-linear", "coordinated-undamped", "--threads", "1"]
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True)
    partial = tmp_path / "results" / "partial"
    until = time.monotonic() + 200.0
    while not list(partial.glob("*.json")) and process.poll() is None and time.monotonic() < until:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=100)[1]
    assert process.returncode == 130
    assert f"finished parts are kept in {Path('results') / 'partial'}: run the same command again to go on" in said
    assert "Traceback" not in said
    assert list(partial.glob("*.json"))


def test_leaderboard_ranks_writes_and_updates_the_readme(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text("before\n<!-- leaderboard:paper:start -->\nold\n<!-- leaderboard:paper:end -->\nafter\n")
    results = tmp_path / "results"
    arguments = [*_PAPER, "--results", str(results), "--readme", str(readme)]
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert f"{readme}: updated" in said.err
    rows = [line.split() for line in said.out.splitlines() if line.split()[1:2] and line.split()[0] in "123"]
    assert rows[0][:2] == ["1", "coordinated-piecewise"]
    text = readme.read_text(encoding="utf-8")
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert "| 1 | coordinated-piecewise |" in text
    assert sorted(path.name for path in results.iterdir()) == ["paper-test.csv", "paper-test.json"]
    assert main(arguments) == 0
    assert f"{readme}: already up to date" in capsys.readouterr().err


def test_leaderboard_evaluates_only_what_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    results = ("--results", str(tmp_path))
    whole = ("--entries", "mppt", "deloaded-5", "coordinated-linear", "coordinated-piecewise")
    assert main([*_PAPER, *whole, *results]) == 0
    expected = [(tmp_path / f"paper-test.{ending}").read_bytes() for ending in ("json", "csv")]
    assert main([*_PAPER, *results]) == 0
    played = _count_played(monkeypatch)
    assert main([*_PAPER, *whole, *results]) == 0
    # The anchors alone, to compare; then the one that the second call has dropped.
    assert played == [[], ["coordinated-linear"]]
    assert [(tmp_path / f"paper-test.{ending}").read_bytes() for ending in ("json", "csv")] == expected
    played.clear()
    assert main([*_PAPER, *results, "--fresh"]) == 0
    assert played == [[], ["mppt", "deloaded-5", "coordinated-piecewise"]]


@pytest.mark.parametrize("damage", ["cut short", "edited", "other source"])
def test_damaged_or_stale_results_are_evaluated_again(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, damage: str
) -> None:
    results = ("--results", str(tmp_path))
    assert main([*_PAPER, *results]) == 0
    path = tmp_path / "paper-test.json"
    good = path.read_text(encoding="utf-8")
    if damage == "cut short":
        path.write_text(good[:500], encoding="utf-8")
    elif damage == "edited":
        table = path.with_suffix(".csv")
        table.write_text(table.read_text(encoding="utf-8").replace("49.", "50."), encoding="utf-8")
    else:
        monkeypatch.setattr("wtg_gym.evaluation.evaluator.source_hash", lambda: "0" * 64)
    capsys.readouterr()
    played = _count_played(monkeypatch)
    assert main([*_PAPER, *results]) == 0
    assert "not used: " in capsys.readouterr().err
    assert played == [[], ["mppt", "deloaded-5", "coordinated-piecewise"]]
    if damage != "other source":
        assert path.read_text(encoding="utf-8") == good


def test_leaderboard_json_keeps_stdout_clean(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = _json(capsys, *_PAPER, "--results", str(tmp_path), "--json")
    assert data["suite_hash"] == FROZEN_HASHES["paper"]
    assert set(data["summary"]) == {"mppt", "deloaded-5", "coordinated-piecewise"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "cannot read the file with the markers"),
        ("no markers", "must have the markers <!-- leaderboard:paper:start -->"),
    ],
)
def test_readme_that_cannot_take_the_table_is_refused_before_anything_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str | None, said: str
) -> None:
    readme = tmp_path / "README.md"
    if text is not None:
        readme.write_text(text, encoding="utf-8")
    results = tmp_path / "results"
    assert said in _error(capsys, *_PAPER, "--results", str(results), "--readme", str(readme))
    assert not results.exists()
