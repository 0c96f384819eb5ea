"""Facts about suites of grids, from what they are told by to a score, and about `wtg-gym grid` as a user calls it."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pandapower
import pandapower.networks
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.changes import changed, write
from tests.cli.calls import json_of, printed_by
from tests.physics.test_grid_files import STRANGER
from wtg_gym import Entry, GFMWTGEnv, evaluate, get_suite
from wtg_gym.cli import main
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.grids.describe import describe_equilibrium, describe_grid, grid_of
from wtg_gym.physics.grid import data_of, get_grid, text_of
from wtg_gym.policies.entry import check_version
from wtg_gym.scenarios.grid_suite import all_places, unscreened

MISTAKES = [
    ({"name": "../elsewhere"}, "name must be letters"),
    ({"name": "standard"}, "another suite than standard-v1: give it another name"),
    ({"grid": "nowhere.json"}, r"wrong\.json: cannot read the grid .*nowhere\.json"),
    ({"places": {"load_noise_bus": 99}}, "LoadNoise.bus: there is no bus 99"),
    ({"places": {"load_buses": [[5, 1.0]]}}, r"Places.load_buses must be tuple\[tuple\[int, float, float\]"),
    ({"places": {"governor_buses": [5]}}, "GovernorLosses.buses: there is no machine with a governor"),
    ({"places": {"line_trips": [[5, 99]]}}, "unknown bus 5"),
]
WITHOUT_SUITE = [
    ({"load_mw": 0.0}, "take 0 MW together"),
    ({"dispatch_mw": -50.0, "governor": None}, "governor of grid .* take 50"),
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a grid, and a suite of it in a folder of its own; it is the working directory."""
    (tmp_path / "ring.json").write_text(json.dumps(STRANGER), encoding="utf-8")
    (tmp_path / "suites").mkdir()
    own = replace(unscreened(str(tmp_path / "ring.json")), name="my-ring", grid="../ring.json")
    (tmp_path / "suites" / "mine.json").write_text(text_of(data_of(own)), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_suite_is_what_is_in_its_files_wherever_they_lie(folder):
    one = get_suite("suites/mine.json")
    assert one.name == "my-ring-v1" and one.scenario(1_000_000).name.startswith("my-ring-v1/")
    assert one.hash == get_suite(str(folder / "suites" / ".." / "suites" / "mine.json")).hash
    (folder / "link.json").symlink_to(folder / "suites" / "mine.json")
    for path in ("./suites/mine.json", str(folder / "suites" / "mine.json"), "suites//../link.json"):
        assert get_suite(path).hash == one.hash


def test_files_are_told_apart_by_what_is_in_them_not_by_name_or_time(folder):
    path, before = folder / "ring.json", (folder / "ring.json").stat()
    one, env = get_suite("suites/mine.json"), GFMWTGEnv(grid="ring.json", strategy="coordinated-tuned")
    env.reset(seed=1)
    path.write_text(json.dumps({**STRANGER, "frequency_hz": 50.0}), encoding="utf-8")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size and path.stat().st_mtime_ns == before.st_mtime_ns
    other = get_suite("suites/mine.json")
    assert other.nominal_hz == 50.0 and other.hash != one.hash
    # What was made before is of one piece: of what was in the file then.
    assert one.nominal_hz == one.plant.case.frequency_hz == 60.0
    with pytest.raises(ValueError, match="the snapshot is of an environment with other settings: plant"):
        GFMWTGEnv(grid="ring.json", strategy="coordinated-tuned").restore(env.snapshot())
    path.write_text(json.dumps({**STRANGER, "buses": STRANGER["buses"][:4]}), encoding="utf-8")
    with pytest.raises(ValueError, match="unknown bus 12"):
        get_suite("suites/mine.json")
    # The places of a suite are looked for in the grid that is there now.
    machines = [{**machine, "governor": None} for machine in STRANGER["machines"]]
    path.write_text(json.dumps({**STRANGER, "machines": machines}), encoding="utf-8")
    with pytest.raises(ValueError, match=r"mine\.json: UnitCommitment.generator_mva = 0 MVA"):
        get_suite("suites/mine.json")


def test_an_evaluation_of_a_suite_that_is_written_anew_meanwhile_is_refused(folder):
    ring, anew = folder / "ring.json", json.dumps({**STRANGER, "frequency_hz": 50.0})
    entries, short = [Entry(name="mppt", strategy="mppt")], {"seeds": [10_000], "duration_s": 5.0}
    with pytest.raises(ValueError, match=r"ring\.json was written anew while it was played"):
        evaluate(entries, "ring.json", partial="parts", on_progress=lambda *_: write(ring, anew), **short)
    assert len(list((folder / "parts").iterdir())) == 1


def test_a_file_is_scored_by_the_command_and_its_results_stay_in_their_folder(folder, capsys):
    json_of(capsys, "evaluate", "--suite", "suites/mine.json", "--scenarios", "3", "--results", "found", "--json")
    assert {path.name for path in (folder / "found").glob("*.json")} == {"my-ring-v1-validation.json"}


@pytest.mark.parametrize(("change", "words"), MISTAKES, ids=str)
def test_a_suite_with_a_mistake_is_refused_before_anything_is_played(folder, change, words):
    data = data_of(unscreened(str(folder / "ring.json")))
    places = {**data["places"], **change.pop("places", {})}
    wrong = write(folder / "wrong.json", text_of({**data, **change, "places": places}))
    with pytest.raises(ValueError, match=words) as refusal:
        get_suite(str(wrong))
    assert "\n" not in str(refusal.value)


def test_a_grid_whose_runs_end_without_any_event_is_refused_with_the_protection():
    grid = get_grid("ieee39")
    low = [replace(bus, voltage_pu=bus.voltage_pu and bus.voltage_pu - 0.16) for bus in grid.case.buses]
    with pytest.raises(ValueError, match=r"a run ends after 3\.\d s by voltage collapse, with voltages of 0\.7"):
        list(describe_equilibrium(replace(grid, case=replace(grid.case, buses=tuple(low)))))


def test_kinds_without_a_place_do_not_happen(folder):
    own = unscreened(str(folder / "ring.json"))
    suite = replace(own, places=replace(own.places, governor_buses=())).suite
    assert not any("governor" in scenario.name for scenario in suite.scenarios(suite.validation[:90]))


@pytest.mark.parametrize(("change", "words"), WITHOUT_SUITE)
def test_a_grid_without_load_or_with_machines_that_take_power_has_no_suite(folder, change, words):
    where = "buses" if "load_mw" in change else "machines"
    rows = [{**row, **change} if where == "buses" or row is STRANGER[where][-1] else row for row in STRANGER[where]]
    (folder / "ring.json").write_text(json.dumps({**STRANGER, where: rows}), encoding="utf-8")
    with pytest.raises(ValueError, match=words):
        get_suite("ring.json")


def test_settings_of_a_grid_can_be_changed():
    settings = EnvSettings(grid="ieee39")
    assert replace(settings, split="test").suite_name == settings.suite_name and settings.env_id == "GFMWTG-v1"
    assert EnvSettings(grid="ieee14", version="v0").suite_name == "standard"


def test_a_policy_of_all_groups_stays_in_its_grid_and_one_of_a_group_moves():
    elsewhere = get_suite(EnvSettings(grid="ieee39").suite_name)
    given = {"name": "one", "policy": SimpleNamespace(predict=lambda *_: None), "environment": "GFMWTG-14bus-v1"}
    check_version([Entry(**given, per_group=True)], elsewhere)
    for suite, other in ((elsewhere, {}), (get_suite("standard-v1"), {"environment": "GFMWTG-v1"})):
        with pytest.raises(ValueError, match="choose a suite of its own environment; policies with per_group = true"):
            check_version([Entry(**{**given, **other})], suite)


def test_places_name_every_bus_once_and_lines_that_are_no_bridges():
    for name in ("ieee39", "nordic45"):
        case, places = get_grid(name).with_groups, all_places(get_grid(name))
        for buses in (places.machine_buses, places.generator_buses, places.governor_buses):
            assert len(set(buses)) == len(buses)
        assert not {case.branch_index(*line) for line in places.line_trips} & case.bridges


STRANGE = {"_module": "a_module_of_strangers", "_class": "Thing", "_object": "{}"}
FRAME = {"_module": "pandas.core.frame", "_class": "DataFrame"}
HOSTILE = [
    *(STRANGE, [STRANGE], {"a": {"b": STRANGE}}, {**STRANGE, "_class": "function"}),
    {"_module": "pandapower.control", "_class": "ConstControl", "_object": "{}"},
    {**FRAME, "_object": json.dumps({"columns": ["a"], "index": [0], "data": [[STRANGE]]})},
    {**FRAME, "_object": json.dumps(STRANGE).replace("_module", "\\u005fmodule")},
    {**FRAME, "_object": "/etc/another.json"},
]


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    path = tmp_path_factory.mktemp("networks") / "new england.json"
    pandapower.to_json(pandapower.networks.case39(), str(path))
    return path


def test_a_network_of_pandapower_becomes_a_grid_whose_law_is_scored(network, tmp_path, capsys):
    output = tmp_path / "ne.json"
    message = printed_by(capsys, "grid", "import", str(network), "--output", str(output), "--wind", "33", "35").err
    assert all(text in message for text in ("all 10 machines are typical ones", "turbines at bus 33: ", str(output)))
    grid = get_grid(str(output))
    assert grid.case.frequency_hz == 60.0 and grid.case.base_mva == 100.0
    assert len(grid.case.branches) == 46 and grid.case.bus_numbers == get_grid("ieee39").case.bus_numbers
    assert {group.bus for group in grid.groups} == {33, 35} == set(grid.replaced)
    assert grid.case.load_mw == pytest.approx(6254.23)
    assert all(bus.x is not None for bus in grid.case.buses)
    rows = printed_by(capsys, "grid", "check", str(output)).out
    assert "39 buses, 46 branches" in rows and "all 10 machines are typical ones" in rows
    short = ("--scenarios", "1", "--duration", "2", "--entries", "mppt", "--json")
    assert "mppt" in str(json_of(capsys, "evaluate", "--suite", str(output), *short))


def test_a_grid_that_is_here_is_checked_by_its_name(capsys):
    rows = printed_by(capsys, "grid", "check", "kundur").out
    assert "11 buses" in rows and "damped by" in rows
    assert "2, 1800 MVA together" in rows and "in place of 2 others" in rows and "beyond 0.9" not in rows


def test_a_suite_is_checked_with_its_own_machines_and_groups(capsys):
    rows = printed_by(capsys, "grid", "check", "weak-grid-v1").out
    assert "1, 122 MVA together" in rows and "4, 52 turbines" in rows
    assert {grid_of(name)[0].groups for name in ("ieee14", "standard-v1")} == {get_suite("standard-v1").plant.groups}
    assert grid_of("ieee39-v1") == (get_grid("ieee39"), "ieee39-v1")


def test_modes_that_grow_and_branches_of_negative_reactance_are_named():
    grid = get_grid("kundur")
    branches = list(grid.case.branches)
    branches[7] = replace(branches[7], reactance=-2.0 * branches[7].reactance)
    odd = replace(grid, case=replace(grid.case, branches=tuple(branches)))
    lines = dict([*describe_grid(odd), *describe_equilibrium(odd)])
    assert lines["negative reactance"] == f"of branches {branches[7].from_bus}-{branches[7].to_bus}"
    assert lines["stable"] == "no, modes grow: +0.224/s at 2.62 Hz, +0.117/s"


def test_voltages_beyond_their_usual_range_are_named_with_their_buses():
    lines = dict(describe_equilibrium(get_grid("nordic45")))
    assert lines["beyond 0.9 … 1.1 p.u."].startswith("1 of 45 buses: lowest 0.868 p.u. at bus 5431, highest 1.020 p.u.")


def test_a_network_without_a_power_flow_is_refused_in_a_line(tmp_path, capsys):
    network = pandapower.networks.case9()
    network.load.p_mw *= 100.0
    path = tmp_path / "heavy.json"
    pandapower.to_json(network, str(path))
    code, message = imported(path, capsys)
    assert code == 2 and "pandapower finds no power flow" in message and not (tmp_path / "out.json").exists()


def imported(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = main(["grid", "import", str(path), "--output", str(path.parent / "out.json")])
    return code, capsys.readouterr().err.splitlines()[-1]


@pytest.fixture(scope="module")
def nine():
    return json.loads(pandapower.to_json(pandapower.networks.case9()))


@pytest.mark.parametrize("thing", HOSTILE, ids=str)
def test_no_module_is_imported_because_a_file_names_it(nine, thing, tmp_path, capsys, monkeypatch):
    (tmp_path / "a_module_of_strangers.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    path = write(tmp_path / "network.json", json.dumps({**nine, "_object": {**nine["_object"], "thing": thing}}))
    code, message = imported(path, capsys)
    assert code == 2 and "network.json: " in message and ("only tables are read" in message or "is not JSON" in message)
    assert "a_module_of_strangers" not in sys.modules


def test_an_old_pandapower_is_refused(network, capsys, monkeypatch):
    monkeypatch.setattr(pandapower, "__version__", "3.5.3")
    code, message = imported(network, capsys)
    assert code == 2 and "pandapower 3.5.3 runs code that a file names; 3.5.4 or later is needed" in message


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_changed_network_is_imported_or_refused_in_a_line(nine, tmp_path, data, capsys):
    # The mark of a network stands at its beginning.
    path = write(tmp_path / "network.json", json.dumps({**nine, "_object": data.draw(changed(nine["_object"]))}))
    code, message = imported(path, capsys)
    assert code == 0 or (code == 2 and message.startswith("wtg-gym: error: ") and "network.json" in message)
