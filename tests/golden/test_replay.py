"""Golden traces of other simulators, and what the replay promises about times, steps and events."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.golden.case import GOLDEN, TRACES, read_case, read_trace
from tests.golden.replay import differences, replay

UNITS = read_case(GOLDEN / "ideal-source-units" / "params.json")


KINDS = "classical-machines dead-band genrou grid-forming hydro ideal-source-units limits shedding"


def test_there_are_golden_cases_of_every_kind() -> None:
    assert sorted({trace.parent.name for trace in TRACES}) == KINDS.split() and len(TRACES) >= 10


@pytest.mark.parametrize("path", TRACES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_fine_step_follows_the_golden_trace_and_the_default_step_is_close_to_it(path: Path) -> None:
    case = read_case(path.parent / "params.json")
    times, trace = read_trace(path)
    assert set(trace) <= set(case.columns)
    fine, default = (
        differences(case, trace, replay(case, case.events[path.stem], times, step_s)) for step_s in (0.0025, 0.02)
    )
    for quantity, tolerance in case.tolerance.items():
        assert fine[quantity] <= tolerance, (quantity, fine[quantity])
    assert default["w"] < 5e-6 and default["Pe"] < 5e-4 and default["V"] < 2e-5


def test_events_at_any_time_end_their_step_exactly() -> None:
    """An event off every grid, with a step that divides nothing, against a step forty times as fine."""
    events = tuple(
        dataclasses.replace(e, time_s=t) for e, t in zip(UNITS.events["a"], (1.23456789, 2.718281828), strict=True)
    )
    times = np.array([0.0, 1.2, 1.23456789, 1.2345679, 1.3, 2.0, 2.718281828, 2.72, 3.141592654])
    coarse, fine = (replay(UNITS, events, times, step) for step in (0.0093, 0.00023))
    for name, values in fine.items():
        assert coarse[name] == pytest.approx(values, abs=2e-6), name
    # Before the event it has not struck; a tenth of a microsecond later it has.
    assert fine["Pe2a"][2] == pytest.approx(fine["Pe2a"][0], abs=1e-9)
    assert fine["Pe2a"][3] > fine["Pe2a"][2] + 0.05


@settings(max_examples=15)
@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=12))
def test_looking_more_often_changes_nothing(times: list[float]) -> None:
    events = (dataclasses.replace(UNITS.events["a"][0], time_s=1.1),)
    times = sorted(times)
    whole = replay(UNITS, events, [*times, 3.0], 0.02)
    end = replay(UNITS, events, [3.0], 0.02)
    for name, values in end.items():
        assert whole[name][-1] == values[-1], name


def test_second_row_at_an_event_is_the_one_after_it() -> None:
    times = [4.9, 5.0, 5.0, 5.1]
    found = replay(UNITS, UNITS.events["a"], times, 0.0025)
    before, after = found["Pe2a"][1], found["Pe2a"][2]
    assert before == pytest.approx(found["Pe2a"][0], abs=1e-9)
    assert after > before + 0.05
    assert found["w2a"][1] == pytest.approx(found["w2a"][2], abs=1e-12)
