"""Facts about cases that ANDES converts: bases, repairs, substitutions, and what is refused."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from wtg_gym.grids.andes import convert, grid_of
from wtg_gym.grids.wind import with_wind
from wtg_gym.physics.grid import MODELS
from wtg_gym.physics.machine_parameters import ExciterParameters

_LINE = {"u": 1.0, "b1": 0.0, "g1": 0.0, "b2": 0.0, "g2": 0.0, "tap": 1.0, "phi": 0.0, "Vn1": 110.0, "Vn2": 110.0}
_GENROU = {
    "u": 1.0, "Sn": 200.0, "M": 9.0, "D": 0.5, "ra": 0.001, "xl": 0.06, "xd": 1.8, "xq": 1.7, "xd1": 0.3, "xq1": 0.55,
    "xd2": 0.25, "xq2": 0.25, "Td10": 8.0, "Td20": 0.03, "Tq10": 0.4, "Tq20": 0.05, "gammap": 1.0, "gammaq": 1.0,
    "S10": 0.0, "S12": 0.0,
}  # fmt: skip
#: Two machines, a transformer and two parallel lines, as ANDES writes a case.
TABLES: dict[str, list[dict[str, Any]]] = {
    "_config": [
        {"section": "System", "key": "mva", "value": 100.0},
        {"section": "System", "key": "freq", "value": 50.0},
    ],
    "Bus": [{"idx": name, "u": 1.0, "Vn": 110.0, "xcoord": k, "ycoord": 1.0} for k, name in enumerate(("A", "B", "C"))],
    "PQ": [{"bus": "C", "u": 1.0, "p0": 1.5, "q0": 0.2}, {"bus": "C", "u": 0.0, "p0": 9.0, "q0": 9.0}],
    "Shunt": [{"bus": "B", "u": 1.0, "g": 0.01, "b": 0.3, "Sn": 200.0, "Vn": 55.0}],
    "Slack": [{"idx": "s", "bus": "A", "u": 1.0, "p0": 0.7, "q0": 0.1, "v0": 1.02, "Sn": 100.0}],
    "PV": [{"idx": "p", "bus": "B", "u": 1.0, "p0": 0.8, "q0": 0.1, "v0": 1.01, "Sn": 100.0}],
    "Line": [
        {**_LINE, "bus1": "A", "bus2": "B", "Sn": 200.0, "r": 0.0, "x": 0.2, "b": 0.1, "tap": 0.98},
        {**_LINE, "bus1": "B", "bus2": "C", "Sn": 100.0, "r": 0.01, "x": 0.1, "b": 0.02, "Vn1": 115.0},
        {**_LINE, "bus1": "B", "bus2": "C", "Sn": 100.0, "r": 0.0, "x": 0.0, "b": 0.0, "b2": 0.05},
    ],
    "GENROU": [
        {**_GENROU, "idx": 1, "bus": "A", "gen": "s"},
        {**_GENROU, "idx": 2, "bus": "B", "gen": "p", "xl": 0.3},
    ],
    "TGOV1": [
        {"syn": k, "u": 1.0, "R": 0.05, "T1": 0.2, "T2": 1.0, "T3": 5.0, "VMIN": 0.0, "VMAX": 1.0, "Dt": 0.0, "Tn": 0}
        for k in (1, 2)
    ],
    "SEXS": [{"idx": "E", "syn": 1, "u": 1.0, "K": 50.0, "TATB": 0.2, "TB": 5.0, "TE": 0.1, "EMIN": -4.0, "EMAX": 5.0}],
}  # fmt: skip


def changed(**tables: Any) -> dict[str, list[dict[str, Any]]]:
    return {**copy.deepcopy(TABLES), **tables}


def test_values_come_to_the_base_of_the_system_and_what_is_out_of_service_is_not_there() -> None:
    grid = grid_of(TABLES, "small")
    case = grid.case
    assert (case.base_mva, case.frequency_hz, case.slack_bus, case.bus_numbers) == (100.0, 50.0, 1, (1, 2, 3))
    assert case.load_mw == 150.0 and case.buses[1].shunt_mvar == pytest.approx(240.0)
    assert (case.buses[2].x, case.buses[2].y) == (2.0, 1.0)
    trafo, line, joint = case.branches
    assert (trafo.reactance, trafo.charging, trafo.tap) == (0.1, 0.2, 0.98)
    assert line.reactance == pytest.approx(0.1 * (115.0 / 110.0) ** 2)
    # Its own admittance stands at the bus.
    assert joint.reactance == 5e-4 and case.buses[2].shunt_mvar == pytest.approx(5.0)
    first, second = case.machines
    assert isinstance(first.exciter, ExciterParameters) and first.exciter.lead_lag_ratio == 0.2
    assert second.exciter is None
    assert (first.dispatch_mw, first.two_h_s, first.damping_pu) == (70.0, 9.0, 0.5)
    assert second.x_leakage == pytest.approx(0.2) and len(grid.repairs) == 3
    assert "bus numbers: A = 1, B = 2, C = 3" in grid.repairs


def test_a_model_that_is_not_here_is_refused_by_name_or_replaced_when_asked() -> None:
    tables = changed(EXDC2=[{"idx": 1, "syn": 2, "u": 1.0, "KA": 20.0}], PSS9=[{"idx": "x", "u": 1.0}])
    with pytest.raises(ValueError, match=r"EXDC2 \(1\), PSS9 \(1\); --substitute"):
        grid_of(tables, "small")
    grid = grid_of(tables, "small", substitute=True)
    assert grid.case.machines[1].exciter is not None and len(grid.substitutions) == 2


def test_a_case_without_machines_gets_typical_ones_and_says_so() -> None:
    more = [*TABLES["PV"], {**TABLES["PV"][0], "idx": "q", "p0": 0.0, "q0": 0.0, "qmax": 0.5, "pmax": 4.0}]
    grid = grid_of(changed(GENROU=[], TGOV1=[], SEXS=[], PV=more), "power flow")
    assert [machine.dispatch_mw for machine in grid.case.machines] == [80.0, 0.0, 70.0]
    # Each is rated for its own row: 1.3 |S|, and what a condenser can give.
    assert [machine.rating_mva for machine in grid.case.machines] == pytest.approx([104.8, 50.0, 91.9], abs=0.05)
    assert [machine.governor is None for machine in grid.case.machines] == [False, True, False]
    assert "typical" in grid.substitutions[0]


#: A control of each kind of a machine of 200 MVA, by what ANDES' tables say, and what becomes of it.
_DC = {"TR": 0.0, "KA": 50.0, "TA": 0.1, "VRMAX": 0.0, "VRMIN": -2.0, "KE": 0.0, "TE": 0.5}
_STEAM = {"Tn": 400.0, "T1": 0.1, "T2": 0.0, "T3": 0.2, "T4": 0.3, "T5": 7.0, "T6": 0.4, "PMAX": 1.0, "PMIN": 0.0}
_PSS = dict.fromkeys(("A1", "A2", "A3", "A4", "A5", "A6", "T1", "T2", "T3", "T4", "T5"), 0.0) | {"T6": 4.0, "KS": 2.0}


@pytest.mark.parametrize(
    ("model", "row", "facts"),
    [
        ("IEEET1", {**_DC, "KF": 0.1, "TF": 1.0, "E1": 0.0, "SE1": 0.0, "E2": 1.0, "SE2": 1.0},
         {"regulator_max_pu": 999.0, "exciter_gain": 0.0, "feedback_gain_s": 0.1, "saturation_2": 0.0}),
        ("IEEEX1", {**_DC, "KF1": 0.2, "TF1": 1.0, "TC": 0.0, "TB": 0.0, "E1": 4.0, "SE1": 0.6, "E2": 3.0, "SE2": 0.2},
         {"feedback_gain_s": 0.2, "saturation_voltage_1_pu": 3.0, "saturation_1": 0.2, "saturation_2": 0.6}),
        ("TGOV1N", {"Tn": 100.0, "R": 0.05, "T1": 0.2, "T2": 1.0, "T3": 5.0, "VMIN": 0.1, "VMAX": 1.0, "Dt": 2.0},
         {"droop_pu": 0.1, "gate_min_pu": 0.05, "gate_max_pu": 0.5, "turbine_damping_pu": 1.0}),
        ("HYGOV", {"Tn": 400.0, "R": 0.05, "r": 0.4, "Tr": 8.0, "Tf": 0.05, "Tg": 0.5, "VELM": 0.2, "GMIN": 0.0,
                   "GMAX": 1.0, "Tw": 1.0, "At": 1.1, "Dt": 0.5, "qNL": 0.1},
         {"droop_pu": 0.025, "temporary_droop_pu": 0.2, "gate_max_pu": 2.0, "water_time_s": 0.5,
          "turbine_damping_pu": 0.5, "no_load_flow_pu": 0.2}),
        ("IEEEG1", {**_STEAM, "K": 20.0, "UO": 0.1, "UC": -0.2, "T7": 0.0, "K1": 0.3, "K3": 0.7, "K5": 0.0, "K7": 0.0},
         {"droop_pu": 0.025, "closing_rate_pu_s": -0.4, "gate_max_pu": 2.0, "fraction_2": 0.7}),
        ("IEESGO", {**_STEAM, "K1": 25.0, "K2": 0.7, "K3": 0.4}, {"droop_pu": 0.02, "gate_max_pu": 2.0}),
        ("GAST", {"Tn": 0.0, "R": 0.04, "T1": 0.1, "T2": 0.2, "T3": 3.0, "AT": 1.0, "KT": 2.0, "VMIN": 0.0, "VMAX": 1.0,
                  "Dt": 0.0}, {"droop_pu": 0.04, "temperature_gain": 2.0}),
        ("IEEEST", {**_PSS, "avr": "E", "MODE": 1.0, "LSMIN": -0.1, "LSMAX": 0.1, "VCL": -999.0, "VCU": 1.2},
         {"gain": 2.0, "voltage_min_pu": 0.0, "voltage_max_pu": 1.2}),
    ],
)  # fmt: skip
def test_controls_come_with_ANDES_names_from_the_base_of_their_turbine(
    model: str, row: dict[str, Any], facts: dict[str, float]
) -> None:
    exciter, at = (TABLES["SEXS"], {}) if "avr" in row else ([], {"syn": 1})
    machine = grid_of({**changed(TGOV1=[], SEXS=exciter), model: [{"idx": 1, "u": 1.0, **at, **row}]}, "small").case
    first = machine.machines[0]
    (control,) = (
        each
        for each in (first.exciter, first.governor, first.stabiliser)
        if type(each) is MODELS[model.removesuffix("N")]
    )
    assert {name: getattr(control, name) for name in facts} == pytest.approx(facts)


def test_a_stabiliser_of_another_input_and_a_phase_shifter_are_not_here() -> None:
    tables = changed(IEEEST=[{"idx": 1, "u": 1.0, "avr": "E", "MODE": 3.0}])
    tables["Line"][1]["phi"] = 0.5
    with pytest.raises(ValueError, match=r"phase shifter \(1\), IEEEST with input 3 \(1\)"):
        grid_of(tables, "small")
    grid = grid_of(tables, "small", substitute=True)
    assert grid.case.machines[0].stabiliser is None and all(branch.phase_rad == 0.0 for branch in grid.case.branches)
    assert "branch B-C: its shift of 28.6° is taken as 0" in grid.substitutions


def test_a_governor_without_gain_is_left_out_and_said_so() -> None:
    grid = grid_of(changed(IEESGO=[{"syn": 1, "u": 1.0, **_STEAM, "K1": 0.0}], TGOV1=[]), "small")
    assert grid.case.machines[0].governor is None
    assert "IEESGO of machine 1: K1 = 0, so that it does not act; it is left out" in grid.repairs


def test_machines_are_on_the_voltage_of_their_bus_and_share_by_ANDES_shares() -> None:
    halves = [{**_GENROU, "idx": k, "bus": "B", "gen": "p", "Sn": mva, "gammaq": 0.5, "Vn": 121.0}
              for k, mva in ((2, 100.0), (3, 300.0))]  # fmt: skip
    machines = grid_of(changed(GENROU=[TABLES["GENROU"][0], *halves]), "small").case.machines
    assert machines[1].x_d == pytest.approx(1.8 * 1.21) and machines[1].reactive_weight == machines[2].reactive_weight


def test_a_source_without_a_machine_beside_one_with_is_a_negative_load() -> None:
    second = {**TABLES["PV"][0], "idx": "q", "p0": 0.3}
    grid = grid_of(changed(PV=[*TABLES["PV"], second]), "small")
    assert grid.case.buses[1].load_mw == pytest.approx(-30.0) and grid.case.machines[1].dispatch_mw == 80.0
    assert "PV q at bus B has no machine: a load of -P, -Q" in grid.substitutions


@pytest.mark.parametrize("u", [0.0, 1.0])
def test_what_stands_at_a_bus_out_of_service_or_without_branches_is_out_too(u: float) -> None:
    tables = changed()
    tables["Bus"].append({"idx": "D", "u": u, "Vn": 110.0})
    for model in ("PQ", "PV", "Shunt"):
        tables[model].append({**TABLES[model][0], "idx": "d", "bus": "D"})
    tables["GENROU"].append({**_GENROU, "idx": 9, "bus": "D", "gen": "d"})
    tables["TGOV1"].append({**TABLES["TGOV1"][0], "syn": 9})
    case = grid_of(tables, "small").case
    assert case.bus_numbers == (1, 2, 3) and len(case.machines) == 2 and case.load_mw == 150.0


def test_saturation_stays_and_times_of_zero_get_typical_values() -> None:
    tables = changed()
    tables["GENROU"][0] |= {"S10": 0.1, "S12": 0.4, "Tq10": 0.0, "Tq20": 0.0}
    # ANDES' own values for none.
    tables["GENROU"][1] |= {"S10": 0.0, "S12": 1.0}
    grid = grid_of(tables, "small")
    first, second = grid.case.machines
    assert (first.saturation_1_0, first.saturation_1_2, second.saturation_1_2) == (0.1, 0.4, 0.0)
    assert (first.t_q0_transient_s, first.t_q0_subtransient_s) == (0.4, 0.05)
    assert "machine 1: Tq20 is 0 s; 0.05 s, a typical value, stands instead" in grid.repairs


def test_errors_name_the_machine_or_the_control() -> None:
    tables = changed()
    tables["GENROU"][1]["M"] = 0.0
    with pytest.raises(ValueError, match=r"^machine 2: two_h_s = 0 s is outside"):
        grid_of(tables, "small")
    tables = changed()
    tables["SEXS"][0]["TB"] = 0.0
    with pytest.raises(ValueError, match=r"^SEXS of machine 1: lag_time_s = 0 s is outside"):
        grid_of(tables, "small")


def test_turbines_replace_machines_and_one_with_a_governor_stays() -> None:
    grid = with_wind(grid_of(TABLES, "small"), [2], rating=1.0)
    assert [machine.bus for machine in grid.with_groups.machines] == [1] and grid.groups[0].n_turbines == 30.0
    with pytest.raises(ValueError, match="a machine with a governor has to stay"):
        with_wind(grid_of(TABLES, "small"), [1, 2])
    with pytest.raises(ValueError, match=r"no machine gives power at bus 3; those that do are at \[1, 2\]"):
        with_wind(grid_of(TABLES, "small"), [3])
    # Turbines for a machine are rated for 1.25/0.6 of what it gave.
    assert with_wind(grid_of(TABLES, "small"), [2]).groups[0].n_turbines == round(80.0 * 1.25 / 0.6 / 5.0)
    tables = changed()
    tables["PV"][0]["p0"] = 2.0
    with pytest.raises(ValueError, match=r"at most 60 % of it: name the buses"):
        with_wind(grid_of(tables, "small"))


def test_a_missing_file_or_program_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"there is no file .*none\.raw"):
        convert(tmp_path / "none.raw")
    case = tmp_path / "case.raw"
    case.write_text("")
    with pytest.raises(ValueError, match="there is no program 'no-andes'"):
        convert(case, program="no-andes")


def test_models_of_a_DYR_file_that_ANDES_passes_over_or_reads_as_others_are_named(tmp_path: Path) -> None:
    case, dynamic, program = tmp_path / "case.raw", tmp_path / "case.dyr", tmp_path / "andes"
    (tmp_path / "tables.json").write_text(json.dumps(TABLES))
    case.write_text("")
    dynamic.write_text("1 'STAB1' 1 2.0 /\n1 'GENSAL' 1 6.0 /\n")
    said = "Models not yet supported: STAB1, IEEET2"
    program.write_text(f"#!/bin/sh\necho '{said}'\nfor out; do :; done\ncp {tmp_path}/tables.json $out/case.json\n")
    program.chmod(0o755)
    tables = convert(case, dynamic, str(program))
    with pytest.raises(ValueError, match=r"STAB1 \(1\), IEEET2 \(1\)"):
        grid_of(tables, "small")
    said_of_it = grid_of(tables, "small", substitute=True).substitutions
    assert said_of_it[0] == "GENSAL: ANDES reads it as GENROU" and "which ANDES does not read" in said_of_it[1]
