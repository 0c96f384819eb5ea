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


def test_there_are_golden_cases_of_every_kind() -> None:
    folders = {trace.parent.name for trace in TRACES}
    assert folders >= {"classical-machines", "ideal-source-units", "genrou", "limits", "dead-band", "hydro"}
    assert folders >= {"grid-forming", "shedding"}
    assert len(TRACES) >= 10


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


def test_the_events_of_a_case_are_those_of_its_file() -> None:
    assert [event.time_s for event in UNITS.events["a"]] == [5.0, 30.0]
    assert [event.power_mw for event in UNITS.events["a"]] == pytest.approx([75.0, 75.0])
    # The whole load goes, its reactive part too.
    lost = [(event.power_mw, event.reactive_mvar) for event in UNITS.events["b"]]
    assert lost == [pytest.approx((-47.8, -10.0)), pytest.approx((-29.5, -16.6))]


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


def test_two_events_at_once_are_their_sum() -> None:
    first, second = UNITS.events["a"]
    together = (dataclasses.replace(first, time_s=1.0), dataclasses.replace(second, time_s=1.0, bus=first.bus))
    once = (dataclasses.replace(first, time_s=1.0, power_mw=first.power_mw + second.power_mw),)
    a, b = (replay(UNITS, events, [2.0], 0.01) for events in (together, once))
    for name, values in b.items():
        assert a[name] == pytest.approx(values, abs=1e-12)


def test_powers_balance_at_every_instant() -> None:
    """The power of the units minus the losses equals the power of loads and shunts at their bus voltages."""
    times = np.linspace(0.0, 8.0, 17)
    found = replay(UNITS, UNITS.events["a"], times, 0.01)
    network = UNITS.network
    v = np.array([found[f"V{n}"] * np.exp(1j * found[f"th{n}"]) for n in network.bus_numbers])
    injected = np.zeros_like(v)
    for key, machine in zip(UNITS.keys, network.machines, strict=True):
        injected[network.bus_index(machine.bus)] += found[f"Pe{key}"] + 1j * found[f"Qe{key}"]
    for branch in network.branches:
        i, j = network.bus_index(branch.from_bus), network.bus_index(branch.to_bus)
        series, half = 1.0 / complex(branch.resistance, branch.reactance), 0.5j * branch.charging
        inner = v[i] / (branch.tap * np.exp(1j * branch.phase_rad))
        flow = series * (inner - v[j])
        injected[i] -= inner * np.conj(flow + half * inner)
        injected[j] -= v[j] * np.conj(-flow + half * v[j])
    for k, bus in enumerate(network.buses):
        y = complex(bus.load_mw, -bus.load_mvar) / abs(v[k, 0]) ** 2
        y += complex(bus.shunt_mw, bus.shunt_mvar)
        injected[k] -= np.abs(v[k]) ** 2 * np.conj(y / network.base_mva)
    step = UNITS.events["a"][0]
    taken = np.where(times > step.time_s, step.power_mw / network.base_mva, 0.0)
    k = network.bus_index(step.bus)
    taken /= abs(v[k, 0]) ** 2
    injected[k] -= np.abs(v[k]) ** 2 * taken
    assert np.abs(injected).max() < 1e-10
