"""Facts about cases that ANDES converts: bases, repairs, substitutions, and what is refused."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from wtg_gym.grids.andes import convert, grid_of
from wtg_gym.grids.wind import with_wind

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
    "Shunt": [{"bus": "B", "u": 1.0, "g": 0.01, "b": 0.3}],
    "Slack": [{"idx": "s", "bus": "A", "u": 1.0, "p0": 0.7, "q0": 0.1, "v0": 1.02}],
    "PV": [{"idx": "p", "bus": "B", "u": 1.0, "p0": 0.8, "q0": 0.1, "v0": 1.01}],
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
    "SEXS": [{"syn": 1, "u": 1.0, "K": 50.0, "TATB": 0.2, "TB": 5.0, "TE": 0.1, "EMIN": -4.0, "EMAX": 5.0}],
}  # fmt: skip


def changed(**tables: Any) -> dict[str, list[dict[str, Any]]]:
    return {**copy.deepcopy(TABLES), **tables}


def test_values_come_to_the_base_of_the_system_and_what_is_out_of_service_is_not_there() -> None:
    grid = grid_of(TABLES, "small")
    case = grid.case
    assert (case.base_mva, case.frequency_hz, case.slack_bus, case.bus_numbers) == (100.0, 50.0, 1, (1, 2, 3))
    assert case.load_mw == 150.0 and case.buses[1].shunt_mvar == 30.0
    assert (case.buses[2].x, case.buses[2].y) == (2.0, 1.0)
    trafo, line, joint = case.branches
    assert (trafo.reactance, trafo.charging, trafo.tap) == (0.1, 0.2, 0.98)
    assert line.reactance == pytest.approx(0.1 * (115.0 / 110.0) ** 2)
    # Its own admittance stands at the bus.
    assert joint.reactance == 1e-4 and case.buses[2].shunt_mvar == pytest.approx(5.0)
    first, second = case.machines
    assert first.exciter is not None and first.exciter.lead_lag_ratio == 0.2 and second.exciter is None
    assert (first.dispatch_mw, first.two_h_s, first.damping_pu) == (70.0, 9.0, 0.5)
    assert second.x_leakage == pytest.approx(0.2) and len(grid.repairs) == 2


def test_a_model_that_is_not_here_is_refused_by_name_or_replaced_when_asked() -> None:
    tables = changed(EXDC2=[{"syn": 2, "u": 1.0, "KA": 20.0}], PSS9=[{"idx": "x", "u": 1.0}])
    with pytest.raises(ValueError, match=r"EXDC2 \(1\), PSS9 \(1\); --substitute"):
        grid_of(tables, "small")
    grid = grid_of(tables, "small", substitute=True)
    assert grid.case.machines[1].exciter is not None and len(grid.substitutions) == 2


def test_a_case_without_machines_gets_typical_ones_and_says_so() -> None:
    grid = grid_of(changed(GENROU=[], TGOV1=[], SEXS=[]), "power flow")
    assert [machine.dispatch_mw for machine in grid.case.machines] == [80.0, 70.0]
    assert all(machine.governor is not None for machine in grid.case.machines) and "typical" in grid.substitutions[0]


def test_turbines_replace_machines_and_one_with_a_governor_stays() -> None:
    grid = with_wind(grid_of(TABLES, "small"), [2], rating=1.0)
    assert [machine.bus for machine in grid.with_groups.machines] == [1] and grid.groups[0].n_turbines == 30.0
    with pytest.raises(ValueError, match="a machine with a governor has to stay"):
        with_wind(grid_of(TABLES, "small"), [1, 2])
    with pytest.raises(ValueError, match=r"no machine gives power at bus 3; those that do are at \[1, 2\]"):
        with_wind(grid_of(TABLES, "small"), [3])


def test_a_missing_file_or_program_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"there is no file .*none\.raw"):
        convert(tmp_path / "none.raw")
    case = tmp_path / "case.raw"
    case.write_text("")
    with pytest.raises(ValueError, match="there is no program 'no-andes'"):
        convert(case, program="no-andes")
