"""`wtg-gym simulate` as a user calls it, with scenario and wind files."""

import json

import numpy as np
import pytest

from tests.cli.calls import ROOT, error_of, json_of
from wtg_gym import Scenario, evaluate, get_suite, simulate
from wtg_gym.cli import main

_QUICK = ("--duration", "6")


def test_simulate_tables_every_strategy_with_units_and_all_are_the_built_in_ones_once(capsys):
    assert main(["simulate", *_QUICK, "--strategy", "mppt", "deloaded-5", "--strategy", "coordinated-linear"]) == 0
    text = capsys.readouterr().out
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
    assert [trip["group"] for trip in run["tripped_groups"]] == [2]
    assert main(arguments) == 0
    assert f"group 2 tripped at {run['tripped_groups'][0]['time_s']:.1f} s" in capsys.readouterr().out


def test_traces_hold_every_sample_with_units_in_the_header(tmp_path):
    path = tmp_path / "traces.csv"
    assert main(["simulate", *_QUICK, "--strategy", "mppt", "deloaded-10", "--csv", str(path)]) == 0
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert table["strategy"].tolist() == ["mppt"] * 61 + ["deloaded-10"] * 61
    run = simulate(get_suite("paper").scenario(0, duration_s=6.0), "deloaded-10")
    for name, values in (
        ("frequency_hz", run.frequency_hz),
        ("group_2_rotor_speed_pu", run.rotor_speed_pu[:, 1]),
        ("machine_1_frequency_hz", run.machine_frequency_hz[:, 0]),
    ):
        assert table[name][61:] == pytest.approx(values, rel=1e-8)


def test_key_figures_are_those_of_the_arrays_of_a_run(capsys):
    arguments = ("simulate", "--suite", "standard-v1", "--seed", "10000", "--strategy", "mppt", "--json")
    (figures,) = json_of(capsys, *arguments)["runs"]
    suite = get_suite("standard-v1")
    run = simulate(suite.scenario(10_000), "mppt", suite.plant)
    rocof = run.rocof_hz_s(0.5)
    wanted = {
        "nadir_hz": run.frequency_hz.min(),
        "zenith_hz": run.frequency_hz.max(),
        "local_nadir_hz": run.local_frequency_hz.min(),
        "local_zenith_hz": run.local_frequency_hz.max(),
        "largest_rocof_hz_s": rocof[np.abs(rocof).argmax()],
        "shed_energy_mws": run.shed_energy_mws[-1],
        "final_frequency_hz": run.frequency_hz[-1],
    }
    assert {key: figures[key] for key in wanted} == pytest.approx(wanted, abs=1e-8)
    assert figures["shed_energy_mws"] > 0.0
    assert [trip["group"] for trip in figures["tripped_groups"]] == [1, 2, 3, 4]
    for trip in figures["tripped_groups"]:
        after, power = run.time_s >= trip["time_s"] - 1e-6, run.power_pu[:, trip["group"] - 1]
        assert (power[after] == 0.0).all() and power[~after][-1] != 0.0


def test_wind_and_groups_follow_each_other_or_a_csv_file(capsys, tmp_path):
    data = json_of(capsys, "simulate", "--duration", "1", "--wind", "9", "8", "7", "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.0, 8.0, 7.0]
    assert len(data["plant"]["groups"]) == 3
    data = json_of(capsys, "simulate", "--suite", "paper-v1", "--duration", "1", "--wind", "9", "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.0] * 4
    assert [group["bus"] for group in data["plant"]["groups"]] == [2, 3, 6, 8]
    path = tmp_path / "wind.csv"
    path.write_text("time_s,wind_1_m_s,wind_2_m_s\n" + "".join(f"{second},9.5,8.0\n" for second in range(8)))
    data = json_of(capsys, "simulate", *_QUICK, "--wind-csv", str(path), "--json")
    assert data["scenario"]["mean_wind_m_s"] == [9.5, 8.0]


def test_suite_of_v1_runs_in_its_own_grid(capsys, tmp_path):
    laws = ("--strategy", "coordinated-piecewise", "coordinated-tuned")
    data = json_of(capsys, "simulate", "--suite", "standard-v1", "--seed", "10003", *laws, "--json")
    assert [group["bus"] for group in data["plant"]["groups"]] == [2, 3, 6, 8]
    assert data["plant"]["physics"] == "extended"
    played = evaluate([], "standard-v1", seeds=(10_003,))
    for run in data["runs"]:
        (episode,) = played.episodes_of(run["strategy"])
        # The least frequency may lie within a control interval; the command rounds to nine decimals.
        assert -1e-9 < run["nadir_hz"] - episode.metrics["nadir_hz"] < 1e-4
    assert main(["suites", "standard-v1", "--seed", "10003", "--json"]) == 0
    path = tmp_path / "scenario.json"
    path.write_text(capsys.readouterr().out)
    again = json_of(capsys, "simulate", "--suite", "standard-v1", "--scenario", str(path), *laws, "--json")
    assert again["runs"] == data["runs"]


def test_plot_replaces_an_older_file_and_leaves_nothing_beside_it(tmp_path):
    pytest.importorskip("matplotlib")
    path = tmp_path / "run.PDF"
    path.write_text("old", encoding="utf-8")
    assert main(["simulate", *_QUICK, "--plot", str(path)]) == 0
    assert path.stat().st_size > 1000 and list(tmp_path.iterdir()) == [path]


def test_example_of_a_law_is_printed_and_simulated_under_its_own_name(capsys, tmp_path):
    assert main(["simulate", "--example-law"]) == 0
    law, other = tmp_path / "my_law.toml", tmp_path / "other.toml"
    law.write_text(capsys.readouterr().out, encoding="utf-8")
    assert law.read_bytes() == (ROOT / "baselines/example_law.toml").read_bytes()
    data = json_of(capsys, "simulate", "--duration", "1", "--strategy", str(law), "--json")
    assert [run["strategy"] for run in data["runs"]] == ["reserve-7"]
    other.write_bytes(law.read_bytes())
    assert "two strategies are called 'reserve-7'" in error_of(capsys, "simulate", "--strategy", str(law), str(other))


def test_dumped_scenario_can_be_edited_and_simulated(capsys, tmp_path):
    data = json_of(capsys, "suites", "standard", "--seed", "20003", "--json")
    assert Scenario.from_dict(data).to_json() == get_suite("standard").scenario(20_003).to_json()
    data["events"] = [{"kind": "load_step", "time_s": 2.0, "bus": 3, "power_mw": 30.0}]
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    result = json_of(capsys, "simulate", *_QUICK, "--scenario", str(path), "--json")
    assert [event["power_mw"] for event in result["scenario"]["events"]] == [30.0]
    assert result["runs"][0]["end_time_s"] == 6.0
