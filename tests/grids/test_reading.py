"""Facts about cases of other programs: what is brought in, what is refused, and that both power flows are the same."""

import json
import math
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandapower
import pandapower.networks
import pypowsybl
import pytest

from tests.changes import write
from wtg_gym.grids import dyr, powsybl, solved_case
from wtg_gym.grids.reading import read_case, with_wind
from wtg_gym.grids.solved_case import power_flow
from wtg_gym.physics.grid import Grid

FOLDER = Path(__file__).parent
#: Models of both machines.
DYR = (FOLDER / "three.dyr").read_text()
_LINES = (1, 2, 0.01, 0.1, 0.02), (2, 3, 0.02, 0.12, 0.03), (1, 3, 0.015, 0.11, 0.02)
_ENDS = "".join(f"{b},1,90,15,0,5,220,1,1,1.5,0.5,0.00625,0,0,0,'1',0\n" for b in (1, 3))
ABSENT = [
    ("DC", "'D',1,10,30,220,0,0,0.1,'R',0,20,1\n" + _ENDS, "dc-line", "1 × dc-line with 30 MW"),
    ("FACTS", "'F',1,3,1,20,0,1,50,100,0.9,1.1,1,0,0.05,100,1,0,0,0\n", "facts-series", "1 × facts-series"),
    ("IMPCOR", "1,0.9,2,1,2,1.1,2\n", "impedance-correction", "1 × impedance-correction"),
    ("BUS", "4,'FOUR',220,1,1,1,1,1,0\n", "island", "1 × island with 7 MW"),
]


def raw(tmp_path: Path, version: int = 33, dynamic: str = "", **more: str) -> tuple[Path, Path]:
    """The RAW file of three buses, of a version and with more records, and a DYR file."""
    text = (FOLDER / "three.raw").read_text().replace(",33,", f",{version},", 1)
    for section, records in more.items():
        text = text.replace(f"0 / END OF {section}\n", f"{records}0 / END OF {section}\n")
    return write(tmp_path / "three.raw", text), write(tmp_path / "three.dyr", dynamic)


def mpc(tmp_path: Path, base: float = 100.0, bus: str = "", branch: str = "", after: str = "") -> Path:
    """The same three buses in MATPOWER's form."""
    k = base / 100.0
    lines = [f"{a},{b} {r * k} {x * k} {c / k} 0 0 0 0 0 1;" for a, b, r, x, c in _LINES]
    return write(
        tmp_path / "three.m",
        f"function mpc = three\nmpc.version = '2';\nmpc.baseMVA = {base}; % MVA\n"
        "mpc.bus = [1 3 0 0 0 0 1 1.02 0 220 1 1.1 0.9; 2 2 20 5 0 0 1 1.01 0 220 1 1.1 0.9;\n"
        f"3 1 90 30 0 0 1 1 0 220 1 1.1 0.9\n{bus}];\n"
        "mpc.gen = [\n1 60 0 Inf -Inf 1.02 100 1 0 0;\n2 55 10 60 -60 1.01 100 1 200 0;\n];\n"
        f"mpc.branch = [\n{chr(10).join(lines)}\n{branch}];\nmpc.genfuel = {{'coal'; 'wind'}};\n{after}\n",
    )


@pytest.fixture
def net():
    net = pandapower.create_empty_network(f_hz=50.0)
    for _ in range(3):
        pandapower.create_bus(net, 220.0)
    pandapower.create_ext_grid(net, 0, vm_pu=1.02)
    pandapower.create_gen(net, 1, p_mw=55.0, vm_pu=1.01)
    pandapower.create_load(net, 2, 90.0, 30.0)
    for a, b, km in ((0, 1, 80.0), (1, 2, 100.0), (0, 2, 90.0)):
        pandapower.create_line_from_parameters(net, a, b, km, 0.06, 0.4, 9.0, 1.0)
    return net


def read(net, tmp_path: Path, **options) -> Grid:
    pandapower.to_json(net, str(tmp_path / "net.json"))
    return read_case(tmp_path / "net.json", **options)


def notes(grid: Grid) -> str:
    return "\n".join(grid.substitutions)


def test_the_same_grid_comes_from_RAW_and_from_MATPOWER_on_any_base(tmp_path):
    grids = [read_case(raw(tmp_path)[0]), read_case(mpc(tmp_path)), read_case(mpc(tmp_path, 10.0), frequency_hz=50.0)]
    flows = [np.concatenate(power_flow(grid.case)) for grid in grids]
    assert flows[0] == pytest.approx(flows[1], abs=1e-9) and flows[1] == pytest.approx(flows[2], abs=1e-12)
    assert [grid.case.frequency_hz for grid in grids] == [50.0, 60.0, 50.0] and "60 Hz" in notes(grids[1])
    assert all(grid.case.load_mw == 110.0 for grid in grids)
    # MBASE, and the fuel of a generator.
    assert grids[0].case.machines[0].rating_mva == 150.0 and grids[1].replaced == (2,)


def test_machines_of_a_DYR_file_and_what_was_changed_about_them(tmp_path):
    path, dynamic = raw(tmp_path, dynamic=DYR)
    grid = read_case(path, dynamic)
    first, second = grid.case.machines
    assert (first.two_h_s, first.resistance, first.x_d, first.saturation_1_2) == (9.0, 0.001, 1.8, 0.3)
    assert (first.exciter.gain, first.governor.droop_pu, first.governor.gate_max_pu) == (50.0, 0.05, 1.0)
    assert second.x_q_transient == second.x_q == 0.7 and second.x_leakage == pytest.approx(0.2)
    assert (second.exciter.saturation_voltage_1_pu, second.exciter.regulator_max_pu) == (3.0, 999.0)
    assert (second.stabiliser.gain, second.stabiliser.lead_time_1_s) == (20.0, 0.05)
    for text in ("GENSAL is a GENROU", "leakage reactance 0.3 p.u.", "VRMAX = 0 means no limit"):
        assert text in notes(grid)


def test_models_that_are_not_here_are_refused_or_replaced_when_asked(tmp_path):
    path, dynamic = raw(tmp_path, dynamic=DYR.replace("SEXS", "EXDC2").replace("STAB1", "PSS9"))
    with pytest.raises(ValueError, match=r"three\.raw: models that are not here: EXDC2 \(1\), PSS9 \(1\)"):
        read_case(path, dynamic)
    grid = read_case(path, dynamic, substitute=True)
    assert grid.case.machines[0].exciter is not None and grid.case.machines[1].stabiliser is None
    assert "a typical exciter stands in its place" in notes(grid)
    dynamic.write_text("1 'GENCLS' 1 4 0 /\n")
    grid = read_case(path, dynamic)
    assert grid.case.machines[0].classical and "B2-GA at bus 2 is a negative load: -55 MW" in notes(grid)
    dynamic.write_text("1 'GENROU' 1 4 0 /\n")
    with pytest.raises(ValueError, match="machine 1 at bus 1: GENROU has 2 numbers, not 14"):
        read_case(path, dynamic)


@pytest.mark.parametrize(("section", "records", "kind", "text"), ABSENT)
def test_what_a_grid_has_not_is_refused_by_name_and_left_out_when_asked(section, records, kind, text, tmp_path):
    more = {"LOAD": "4,'1',1,1,1,7,0,0,0,0,0,1,1,0\n"} if kind == "island" else {}
    path, _ = raw(tmp_path, **{section: records}, **more)
    with pytest.raises(ValueError, match=f"{text}.*--drop {kind}"):
        read_case(path)
    grid = read_case(path, drop=(kind,))
    assert f"left out: {text}" in notes(grid) and len(grid.case.buses) == 3


def test_a_switched_shunt_stands_at_its_initial_value_and_a_winding_without_impedance_joins_its_buses(tmp_path):
    more = {
        "TRANSFORMER": "1,2,3,'1',1,1,1,0,0,2,'T',1,1,1\n0,0.1,100,0,0.2,100,0,0.1,100,1,0\n" + 3 * "1,0,0\n",
        "SWSHUNT": "3,0,0,1,1.1,0.9,0,100,'',15,1,20\n2,0,0,0,1.1,0.9,0,100,'',15,1,20\n",
    }  # fmt: skip
    case = read_case(raw(tmp_path, **more)[0]).case
    assert case.buses[2].shunt_mvar == pytest.approx(15.0) and case.buses[1].shunt_mvar == 0.0
    assert case.bus_numbers == (1, 2, 3) and len(case.branches) == 5


def test_RAW_with_blanks_between_its_fields_and_RAWX_say_the_same_as_with_commas(tmp_path):
    switched = "3,0,0,1,1.1,0.9,0,100,'',15,1,20\n"
    path, _ = raw(tmp_path, SWSHUNT=switched)
    case = read_case(path).case
    path.write_text("\n".join(line.replace(",", " ") for line in path.read_text().splitlines()))
    assert read_case(path).case == case
    assert read_case(FOLDER / "three.rawx").case == case
    data = json.loads((FOLDER / "three.rawx").read_text(encoding="utf-8"))
    data["network"]["gne"]["data"] = [["D"]]
    with pytest.raises(ValueError, match="1 × gne-device"):
        read_case(write(tmp_path / "three.rawx", json.dumps(data)))


def test_IEEE_CDF_endless_ratings_of_CGMES_and_tie_lines_between_other_nominal_voltages_are_read(tmp_path):
    net = pypowsybl.network.create_ieee14()
    net.save(tmp_path / "grid.zip", format="CGMES")
    assert max(machine.rating_mva for machine in read_case(tmp_path / "grid.zip").case.machines) < 1000.0
    assert read_case(FOLDER / "two.cdf").case.load_mw == 50.0
    net = pypowsybl.network.create_eurostag_tutorial_example1_with_tie_lines_and_areas()
    net.update_voltage_levels(id="VLHV2", nominal_v=400.0)
    net.save(tmp_path / "ties.xiidm", format="XIIDM")
    assert len(read_case(tmp_path / "ties.xiidm").case.branches) == 6


@pytest.mark.parametrize("country", ["be", "nl"])
def test_a_network_of_pypowsybl_with_boundary_lines_is_read_and_a_case_of_PSSE_but_a_RAW_file_is_not(country, tmp_path):
    net = getattr(pypowsybl.network, f"create_micro_grid_{country}_network")()
    net.save(tmp_path / "micro.xiidm", format="XIIDM")
    grid = read_case(tmp_path / "micro.xiidm")
    assert "power flow is that of pypowsybl" in notes(grid) and grid.case.branches
    path, _ = raw(tmp_path)
    with zipfile.ZipFile(tmp_path / "three.zip", "w") as archive:
        archive.write(path, path.name)
    with pytest.raises(ValueError, match=r"read from its \.raw or \.rawx file only"):
        read_case(tmp_path / "three.zip")


def test_a_bus_of_type_4_of_MATPOWER_is_out_of_service(tmp_path):
    case = mpc(tmp_path, bus="4 4 40 0 0 0 1 1 0 220 1 1.1 0.9;\n", branch="3 4 0 0.1 0 0 0 0 0 0 1;\n")
    grid = read_case(case)
    assert grid.case.load_mw == 110.0 and "out of service with 40 MW of load: 4" in notes(grid)


#: What the MATPOWER file has, what it gets in its place, and what is said of it.
STATEMENT = "besides its tables it has statements, such as"
NOT_A_CASE = [
    ("3 1 90 30", "3 1 NaN 30", "row 3 of its table bus has nan in column 3, which must be finite"),
    ("3 1 90 30", "3 1 90 Inf", "row 3 of its table bus has inf in column 4, which must be finite"),
    *(("3 1 90 30", f"3 {kind} 90 30", f"bus 3 is of type {kind}; allowed: 1, 2, 3, 4") for kind in (0, 5)),
    ("3 1 90 30", "2 1 90 30", "row 2 of its table bus names bus 2, which is there twice"),
    ("0 0 1;\n];\nmpc.gen", "0 0 -1;\n];\nmpc.gen", "row 3 of its table branch has the status -1; allowed: 0, 1"),
    ("100 1 ", "100 0 ", "no generator is in service"),
    ("mpc.genfuel =", "mpc.dcline = [1];\nmpc.genfuel =", "its table dcline has 1 columns; allowed: 4 or more"),
    ("function", "mpc.bus_name = {'a', '50% b'};\nmpc.bus(3,3)=500;\nfunction", f"{STATEMENT} 'mpc.bus(3,3)=500;'"),
    ("function", "mpc.bus_name = {'a... b'};\nmpc.bus(3,3)=500;\nfunction", f"{STATEMENT} 'mpc.bus(3,3)=500;'"),
    ("function", "%{ a\nmpc.bus(3,3)=500;\n% }%}\nfunction", f"{STATEMENT} 'mpc.bus(3,3)=500;'"),
    ("3 1 90 30", "3.5 1 90 30", "row 3 of its table bus has the bus number 3.5; allowed: whole numbers from 1"),
    ("3 1 90 30", "3 1 90", "row 3 of its table bus has 12 numbers, the first one 13"),
    ("baseMVA = 100.0", "baseMVA = 100/2", "its baseMVA has '100/2' in row 1, which is no number"),
    ("baseMVA = 100.0", "baseMVA = 100e6", "its baseMVA = 1e+08 MVA is outside the allowed range 0.1 … 100000 MVA"),
    ("mpc.genfuel =", "mpc.dcline = [1 3 1\n1 3];\nmpc.genfuel =", "row 2 of its table dcline has 2 numbers, the"),
    ("'coal'; ", "", "its genfuel names 1 generators, its table gen 2"),
    ("mpc.genfuel =", "mpc.bus(:, 3) = 1;\nmpc.genfuel =", f"{STATEMENT} 'mpc.bus(:, 3) = 1;'"),
    ("0 0 1;\n];\nmpc.gen", "0 0 1;\n3 9 0 1 0 0 0 0 0 0 1;\n];\nmpc.gen", "row 4 of its table branch names bus 9"),
    ("1,3 0.015", "1,3 1/8", "its table branch has '1/8' in row 3, which is no number"),
    ("mpc.genfuel =", "mpc.dcline = [1 3 1 30];\nmpc.genfuel =", "it has what no grid here has: 1 × dcline with 30 MW"),
]


def test_unknown_scalars_of_MATPOWER_and_a_missing_slack_bus_are_noted_and_limits_may_be_infinite(tmp_path):
    scalars = "mpc.const_int = 123;\nmpc.time_elapsed = 1.5e-3\nmpc.const_str = 'a b';\n"
    path = mpc(tmp_path, after=scalars + "mpc.dcline = [];")
    path.write_text(path.read_text().replace("[1 3 0", "[1 2 0").replace("1 200 0;", "1 Inf NaN;"))
    grid = read_case(path)
    assert "passed over: const_int, time_elapsed, const_str" in notes(grid)
    assert "names no slack bus; the voltage-controlled bus with the largest generator is taken: 2" in notes(grid)
    assert grid.case.slack_bus == 2 and grid.case.load_mw == 110.0


def test_a_bus_of_type_4_of_a_RAW_file_is_out_of_service_with_all_that_is_there(tmp_path):
    plain = read_case(raw(tmp_path)[0]).case
    more = {
        "BUS": "4,'4'' FOUR',220,4,1,1,1,1,0\n",
        "LOAD": "4,'1',1,1,1,30,5,0,0,0,0,1,1,0\n",
        "FIXSHUNT": "4,'1',1,0,20\n",
        "GENERATOR": "4,'1',10,0,60,-60,1.05,0,100,0,1,0,0,1,1,100,200,0,1,1\n",
        "BRANCH": "3,4,'1',0.01,0.1,0.5,0,0,0,0,0,0,0,1,1,0,1,1\n",
        "TRANSFORMER": "4,3,0,'1',1,1,1,0,0,2,'T',1,1,1\n0,0.2,100\n1,0,0\n1,0\n",
    }
    grid = read_case(raw(tmp_path, **more)[0])
    assert grid.case == plain and "out of service with 30 MW of load: 4" in notes(grid)


def test_the_reactive_part_of_an_admittance_is_negative_where_a_load_takes_reactive_power(tmp_path):
    for active in (0, 10):
        case = read_case(raw(tmp_path, LOAD=f"3,'2',1,1,1,0,0,0,0,{active},-20,1,1,0\n")[0]).case
        voltage = abs(power_flow(case)[0][2])
        assert case.buses[2].load_mvar == pytest.approx(30.0 + 20.0 * voltage**2, abs=1e-6)
        assert case.buses[2].load_mw == pytest.approx(90.0 + active * voltage**2, abs=1e-6)
    data = json.loads((FOLDER / "three.rawx").read_text(encoding="utf-8"))
    load = data["network"]["load"]
    load["fields"] += ["yp", "yq"]
    load["data"] = [[*row, 0.0, -20.0] for row in load["data"]]
    case = read_case(write(tmp_path / "three.rawx", json.dumps(data))).case
    assert case.buses[1].load_mvar == pytest.approx(5.0 + 20.0 * 1.01**2)


def test_the_sign_of_a_metered_end_is_no_part_of_its_bus_and_a_RAW_file_that_was_cut_short_is_refused(tmp_path):
    path, _ = raw(tmp_path)
    case, text = read_case(path).case, path.read_text()
    for same in (text.replace("1,3,'1'", "1,-3,'1'"), text.replace("1,3,'1'", " 1 -3 '1'"), text.replace("Q\n", "")):
        path.write_text(same)
        assert read_case(path).case == case
    for end, section in (("2,3,'1'", "acline"), ("0 / END OF FACTS", "facts"), ("0 / END OF BUS", "bus")):
        path.write_text(text[: text.index(end)])
        with pytest.raises(ValueError, match=rf"three\.raw: it ends within its {section} data"):
            read_case(path)


#: A record more in a section of the RAW file.
RECORDS = [
    ("BUS", "3,'DUP',220,1,1,1,1,1,0\n", "bus data have more than one record of bus 3"),
    ("LOAD", "3,'1',1,1,1,25,5,0,0,0,0,1,1,0\n", "load data have more than one record of bus 3 1"),
    ("GENERATOR", "2,'A',10,1,60,-60,1.01,0,100,0,1,0,0,1,1,100,200,0,1,1\n", "generator data .* of bus 2 A"),
    ("BRANCH", "2,-1,'1',0.01,0.1,0,0,0,0,0,0,0,0,1,1,0,1,1\n", "acline data have more than one record of bus 1-2 1"),
    ("LOAD", "7,'1',1,1,1,25,5,0,0,0,0,1,1,0\n", "load data name the bus 7, which is not there"),
    ("FIXSHUNT", "7,'1',1,0,20\n", "fixshunt data name the bus 7, which is not there"),
    ("GENERATOR", "7,'A',10,1,60,-60,1.01,0,100,0,1,0,0,1,1,100,200,0,1,1\n", "generator data name the bus 7, which"),
    ("BRANCH", "2,-7,'1',0.01,0.1,0,0,0,0,0,0,0,0,1,1,0,1,1\n", "acline data name the bus 7, which is not there"),
    ("BRANCH", "2,2,'1',0.01,0.1,0,0,0,0,0,0,0,0,1,1,0,1,1\n", "acline data have a branch from bus 2 to itself"),
    ("TRANSFORMER", "1,3,7,'1',1,1,1,0,0,2,'T',1,1,1\n0,0.2,100\n" + 3 * "1,0,0\n", "transformer data name the bus 7"),
    ("SWSHUNT", "7,0,0,1,1.1,0.9,0,100,'',15,1,20\n", "swshunt data name the bus 7, which is not there"),
    ("BUS", "4,'FOUR',220,5,1,1,1,1,0\n", "bus 4 is of type '5'; allowed: 1, 2, 3, 4"),
    ("LOAD", "3,'2',1,1,1,9000,0,0,0,0,0,1,1,0\n", "pypowsybl finds no power flow: "),
]
NO_RAWX = [
    ("[]", "it is no RAWX file: it must have a network with caseid"),
    ('{"network": [1]}', "it is no RAWX file: it must have a network with caseid"),
    ('{"network": {}}', "it is no RAWX file: it must have a network with caseid"),
    ('{"network": {"caseid": [1]}}', "its caseid data must have the lists fields and data"),
    ('{"network": {"caseid": {"fields": ["rev"], "data": [[35], 1]}}}', "its caseid data must be lists, and their"),
    ('{"network": {"caseid": {"fields": ["rev"], "data": []}}}', "it misses 'rev'"),
]
REFUSED = [
    *((lambda folder, pair=pair: changed(mpc(folder), *pair), f"three.m: {said}") for *pair, said in NOT_A_CASE),
    *((lambda folder, more=more: raw(folder, **dict([more]))[0], f"three.raw: .*{said}") for *more, said in RECORDS),
    *((lambda folder, v=v: raw(folder, v)[0], f"as RAW of version {v}") for v in (30, 34, 35)),
    *((lambda folder, text=text: write(folder / "no.rawx", text), f"no.rawx: {said}") for text, said in NO_RAWX),
]


def changed(path: Path, right: str, wrong: str) -> Path:
    return write(path, path.read_text().replace(right, wrong))


@pytest.mark.parametrize(("make", "sentence"), REFUSED, ids=[sentence for _, sentence in REFUSED])
def test_what_is_no_case_is_refused_by_its_place(make, sentence, tmp_path):
    with pytest.raises(ValueError, match=re.escape(sentence).replace(r"\.\*", ".*")):
        read_case(make(tmp_path))


def test_what_the_file_stores_otherwise_is_noted_reactive_limits_and_voltages_in_Latin_1_too(tmp_path):
    path, dynamic = raw(tmp_path, dynamic="// Größe\n" + DYR)
    text = path.read_text().replace("10,60,-60,1.01", "10,5,-5,1.05").replace("'ONE'", "'ÖNE'")
    path.write_text(text, encoding="latin-1")
    dynamic.write_text(dynamic.read_text(), encoding="latin-1")
    said = notes(read_case(path, dynamic))
    assert re.search(r"reactive limits are not kept; beyond theirs \[Mvar\]: B2-GA at bus 2 \d\S* \(-5 … 5\)", said)
    assert "from the voltages that the file stores, as phasors: 0.0" in said
    path.write_text(text.replace("'ÖNE',220,3", "'ÖNE',220,2"))
    assert "largest generator is taken: 1" in notes(read_case(path))


def test_an_infinite_machine_of_a_DYR_file_is_refused_or_a_typical_one_when_asked(tmp_path):
    path, dynamic = raw(tmp_path, dynamic="1 'GENCLS' 1 0 0 /\n2 'GENCLS' A 4 0 /\n")
    with pytest.raises(ValueError, match=r"GENCLS with H = 0, an infinite machine .* --substitute"):
        read_case(path, dynamic)
    grid = read_case(path, dynamic, substitute=True)
    assert grid.case.machines[0].two_h_s == 8.0 and grid.case.machines[0].rating_mva == 150.0
    assert "machine 1 at bus 1: GENCLS with H = 0, an infinite machine: a typical one" in notes(grid)


def test_a_total_load_that_is_not_the_library_s_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(powsybl._Tables, "_load_mw", lambda tables: 109.0)
    with pytest.raises(ValueError, match=r"total load 110 MW here, 109 MW in pypowsybl"):
        read_case(raw(tmp_path)[0])


def test_a_library_prints_nothing_of_its_own(tmp_path):
    code = f"from wtg_gym.grids.powsybl import *\nread_powsybl(Path({str(raw(tmp_path)[0])!r}), None, ())"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "opf" not in run.stderr + run.stdout


def test_phase_shifts_along_every_path_are_left_out_and_a_phase_shifter_stays(net, tmp_path):
    bus = pandapower.create_bus(net, 110.0)
    values = {"sn_mva": 200.0, "vkr_percent": 0.2, "vk_percent": 10.0, "pfe_kw": 50.0, "i0_percent": 0.1}
    values["vn_hv_kv"] = 220.0
    pandapower.create_transformer_from_parameters(net, 0, bus, vn_lv_kv=110.0, shift_degree=150.0, **values)
    pandapower.create_load(net, bus, 10.0)
    grid = read(net, tmp_path)
    assert "1 buses turn" in notes(grid) and not any(branch.phase_rad for branch in grid.case.branches)
    pandapower.create_transformer_from_parameters(net, 0, 2, vn_lv_kv=220.0, shift_degree=8.0, **values)
    grid = read(net, tmp_path)
    shifts = [branch.phase_rad for branch in grid.case.branches if branch.phase_rad]
    assert shifts == pytest.approx([math.radians(8.0)]) and "phase shifters" in notes(grid)


def test_wind_parks_get_turbines_and_other_static_generators_are_negative_loads(net, tmp_path):
    pandapower.create_sgen(net, 2, 40.0, type="WP")
    pandapower.create_sgen(net, 0, 6.0, type="PV")
    pandapower.create_load(net, 1, 20.0, const_z_p_percent=100.0)
    pandapower.create_storage(net, 2, 2.0, 10.0)
    grid = read(net, tmp_path)
    assert "storage 0 at bus 3 is a load of 2 MW" in notes(grid) and "reactive limits" not in notes(grid)
    assert grid.replaced == (3,) and "wind park of 40 MW" in notes(grid) and "negative load: -6 MW" in notes(grid)
    assert "constant impedance" in notes(grid) and grid.case.load_mw == pytest.approx(92.0 - 6.0 + 20.0 * 1.01**2)
    assert {group.bus for group in with_wind(grid, [2]).groups} == {2, 3}
    pandapower.create_ext_grid(net, 2, vm_pu=1.0)
    assert "external grids beside the first are machines: at buses 3" in notes(read(net, tmp_path))
    pandapower.create_dcline(net, 1, 2, 30.0, 0.0, 0.0, 1.01, 1.0)
    with pytest.raises(ValueError, match="1 × dcline with 30 MW"):
        read(net, tmp_path)


def test_turbines_stand_beside_a_lone_machine_and_one_with_a_governor_stays(net, tmp_path):
    grid = read(net, tmp_path)
    with pytest.raises(ValueError, match=r"no machine gives power at bus 3; those that do are at \[1, 2\]"):
        with_wind(grid, [3])
    net.gen.in_service = False
    machines = tuple(replace(machine, dispatch_mw=3e4) for machine in grid.case.machines)
    large = replace(grid, case=replace(grid.case, machines=machines))
    assert [group.bus for group in with_wind(large).groups] == [1]
    with pytest.raises(ValueError, match=r"turbines at bus 2: .*n_turbines"):
        with_wind(large, [2])
    alone = with_wind(read(net, tmp_path))
    assert alone.groups[0].bus == 1 and alone.replaced == () and len(alone.with_groups.machines) == 1


def test_a_grid_that_is_not_the_one_of_the_file_is_refused_with_bus_and_both_values(tmp_path, monkeypatch):
    path = mpc(tmp_path)
    right = solved_case.Branch
    monkeypatch.setattr(solved_case, "Branch", lambda **values: right(**values | {"charging": 0.0}))
    with pytest.raises(ValueError, match=r"three\.m: bus \d: .* p\.u\. here, .* p\.u\. in PYPOWER"):
        read_case(path)


def test_every_bus_of_a_network_has_the_voltage_that_pandapower_finds(tmp_path):
    net = pandapower.networks.case30()
    pandapower.runpp(net, numba=False)
    voltages, _ = power_flow(read(net, tmp_path).case)
    assert abs(voltages) == pytest.approx(net.res_bus.vm_pu.to_numpy(), abs=1e-6)


def test_too_many_buses_are_refused_before_anything_is_solved(net, tmp_path):
    pandapower.create_buses(net, 2000, 220.0)
    with pytest.raises(ValueError, match="2003 buses; a grid has at most 2000"):
        read(net, tmp_path)


def test_the_page_lists_the_models_of_dyr_files_that_are_here():
    page = (Path(__file__).parents[2] / "docs/howto/grid.md").read_text(encoding="utf-8")
    assert all(model in page for model in dyr._NUMBERS)
