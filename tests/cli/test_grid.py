"""`wtg-gym grid` as a user calls it: from a network of pandapower to a scored law."""

import json
import sys
from pathlib import Path

import pandapower
import pandapower.networks
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.changes import changed, write
from tests.cli.calls import error_of, json_of
from wtg_gym.cli import main
from wtg_gym.grids.describe import describe_equilibrium, grid_of
from wtg_gym.physics.grid import get_grid
from wtg_gym.scenarios import get_suite

STRANGE = {"_module": "a_module_of_strangers", "_class": "Thing", "_object": "{}"}
FRAME = {"_module": "pandas.core.frame", "_class": "DataFrame"}
HOSTILE = [
    STRANGE,
    [STRANGE],
    {"a": {"b": STRANGE}},
    {**STRANGE, "_class": "function"},
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
    assert main(["grid", "import", str(network), "--output", str(output), "--wind", "33", "35"]) == 0
    said = capsys.readouterr().err
    assert "all 10 are typical ones" in said and str(output) in said
    grid = get_grid(str(output))
    assert grid.case.frequency_hz == 60.0 and grid.case.base_mva == 100.0
    assert len(grid.case.branches) == 46 and grid.case.bus_numbers == get_grid("ieee39").case.bus_numbers
    assert {group.bus for group in grid.groups} == {33, 35} == set(grid.replaced)
    assert grid.case.load_mw == pytest.approx(6254.23)
    assert all(bus.x is not None for bus in grid.case.buses)

    assert main(["grid", "check", str(output)]) == 0
    rows = capsys.readouterr().out
    assert "39 buses, 46 branches" in rows and "all 10 are typical ones" in rows
    short = ("--scenarios", "1", "--duration", "2", "--entries", "mppt", "--json")
    assert "mppt" in str(json_of(capsys, "evaluate", "--suite", str(output), *short))


def test_a_grid_that_is_here_is_checked_by_its_name(capsys):
    assert main(["grid", "check", "kundur"]) == 0
    rows = capsys.readouterr().out
    assert "11 buses" in rows and "damped by" in rows
    assert "2, 1800 MVA together" in rows and "in place of 2 others" in rows and "beyond 0.9" not in rows
    assert "unknown grid 'kundru'" in error_of(capsys, "grid", "check", "kundru")


def test_a_suite_is_checked_with_its_own_machines_and_groups(capsys):
    assert main(["grid", "check", "weak-grid-v1"]) == 0
    assert "1, 122 MVA together" in (rows := capsys.readouterr().out) and "4, 52 turbines" in rows
    assert [grid_of(name)[0].groups for name in ("ieee14", "standard-v1")] == [
        get_suite("standard-v1").plant.groups
    ] * 2
    assert grid_of("ieee39-v1") == (get_grid("ieee39"), "ieee39-v1")


def test_voltages_beyond_their_usual_range_are_named_with_their_buses():
    lines = dict(describe_equilibrium(get_grid("nordic45")))
    assert lines["beyond 0.9 … 1.1 p.u."].startswith("1 of 45 buses: lowest 0.868 p.u. at bus 5431, highest 1.020 p.u.")


def test_a_network_without_a_power_flow_is_refused_in_a_line(tmp_path, capsys):
    network = pandapower.networks.case9()
    network.load.p_mw *= 100.0
    path = tmp_path / "heavy.json"
    pandapower.to_json(network, str(path))
    assert main(["grid", "import", str(path), "--output", str(tmp_path / "grid.json")]) == 2
    assert "pandapower finds no power flow" in capsys.readouterr().err
    assert not (tmp_path / "grid.json").exists()


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
    path = tmp_path / "network.json"
    path.write_text(json.dumps({**nine, "_object": {**nine["_object"], "thing": thing}}))
    code, said = imported(path, capsys)
    assert code == 2 and "network.json: " in said and ("only tables are read" in said or "is not JSON" in said)
    assert "a_module_of_strangers" not in sys.modules


def test_an_old_pandapower_is_refused(network, capsys, monkeypatch):
    monkeypatch.setattr(pandapower, "__version__", "3.5.3")
    code, said = imported(network, capsys)
    assert code == 2 and "pandapower 3.5.3 runs code that a file names; 3.5.4 or later is needed" in said


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_changed_network_is_imported_or_refused_in_a_line(nine, tmp_path, data, capsys):
    path = tmp_path / "network.json"
    # The mark of a network stands at its beginning.
    write(path, json.dumps({**nine, "_object": data.draw(changed(nine["_object"]))}))
    code, said = imported(path, capsys)
    assert code == 0 or (code == 2 and said.startswith("wtg-gym: error: ") and "network.json" in said)
