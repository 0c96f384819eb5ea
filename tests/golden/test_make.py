"""The script that makes the golden traces, as far as it runs without ANDES."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.golden.case import TRACES, read_data, read_trace
from tests.golden.make import RUNS, columns, devices, row_times

#: Cases whose traces another program made.
OTHERS = {"classical-machines", "ideal-source-units"}
MADE = [path for path in TRACES if path.parent.name not in OTHERS]


@pytest.mark.parametrize("path", MADE, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_trace_made_anew_has_the_rows_the_columns_and_the_machines_of_the_one_kept(path: Path) -> None:
    data, run = read_data(path.parent.name), RUNS[path.parent.name]
    events = data["events"][path.stem]
    times, trace = read_trace(path)
    assert columns(data, events) == ("t", *trace)
    assert row_times(events, run.duration_s).tolist() == times.tolist()
    system = devices(data, events, run)
    names = {(model, device["idx"]) for model, device in system if "idx" in device}
    assert set(data["gens"]) == {name for model, name in names if model in ("GENROU", "GENCLS", "REGF1", "REGF2")}
    assert {(device["model"], device["dev"]) for model, device in system if model in ("Toggle", "Alter")} <= names
