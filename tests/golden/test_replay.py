"""Golden traces of other simulators, and the script that makes them, as far as it runs without ANDES."""

import pytest

from tests.golden.case import ROW_S, TRACES, read_case, read_data, read_trace
from tests.golden.make import RUNS, columns, devices, row_times
from tests.golden.replay import differences, replay
from tests.golden.shipped import EVENTS

KINDS = (
    *("classical-machines", "dead-band", "genrou", "grid-events", "grid-forming", "hydro", "ideal-source-units"),
    *("ieee39", "ieee39-no-limits", "imposed-source", "kundur", "limits", "nordic45", "shedding"),
    *("gast", "ieeeg1", "ieeest", "ieeet1", "ieeex1", "ieesgo", "saturation", "stab1"),
)


def test_there_are_golden_cases_of_every_kind():
    assert sorted({trace.parent.name for trace in TRACES}) == sorted(KINDS) and len(TRACES) >= 25


@pytest.mark.parametrize("path", TRACES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_fine_step_follows_the_golden_trace_and_the_default_step_is_close_to_it(path):
    case = read_case(path.parent.name)
    times, trace = read_trace(path)
    assert set(trace) <= set(case.columns)
    events = case.events[path.stem]
    fine, default = (differences(case, trace, replay(case, events, times, dt)) for dt in (0.0025, ROW_S / 3))
    for quantity, tolerance in case.tolerance.items():
        assert fine[quantity] <= tolerance, (quantity, fine[quantity])
    # Faults take more than half the voltage away; of 39 buses the machines are ten times as large as the base.
    large = case.network.load_mw > 10.0 * case.network.base_mva
    voltage, power = (2e-4, 5e-3) if large else (5e-5 if path.stem == "faults" else 2e-5, 5e-4)
    if path.parent.name in EVENTS:
        power = 1e-2  # limits bind within a step
        found = replay(case, (), times[:2], ROW_S / 3)
        assert max(abs(found[name][0] - trace[name][0]) for name in trace if name[0] == "V") < 1e-10
    assert default["w"] < 5e-6 and default["Pe"] < power and default["V"] < voltage


OTHERS = {"classical-machines", "ideal-source-units"}
MADE = [path for path in TRACES if path.parent.name not in OTHERS]


@pytest.mark.parametrize("path", MADE, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_trace_made_anew_has_the_rows_the_columns_and_the_machines_of_the_one_kept(path):
    data, run = read_data(path.parent.name), RUNS[path.parent.name]
    events = data["events"][path.stem]
    times, trace = read_trace(path)
    assert columns(data, events) == ("t", *trace)
    assert row_times(events, run.duration_s).tolist() == times.tolist()
    system = devices(data, events, run)
    names = {(model, device["idx"]) for model, device in system if "idx" in device}
    assert set(data["gens"]) == {name for model, name in names if model in ("GENROU", "GENCLS", "REGF1", "REGF2")}
    assert {(device["model"], device["dev"]) for model, device in system if model in ("Toggle", "Alter")} <= names
