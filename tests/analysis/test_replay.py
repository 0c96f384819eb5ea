"""Golden traces of other simulators, and what the replay promises about times, steps and events."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.golden_cases import CASES, GOLDEN
from wtg_gym.analysis.case_file import read_parameters
from wtg_gym.analysis.replay import differences, replay, replay_closely
from wtg_gym.analysis.trace_file import Trace, choose_events, read_trace

UNITS = read_parameters(GOLDEN / "ideal-source-units" / "params.json")


def test_there_are_golden_cases_of_every_kind() -> None:
    folders = {params.parent.name for params, _ in CASES}
    assert folders >= {"classical-machines", "ideal-source-units", "genrou", "limits", "dead-band", "hydro"}
    assert folders >= {"grid-forming", "shedding"}
    assert len(CASES) >= 10


@pytest.mark.parametrize(("params", "trace_path"), CASES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_fine_step_follows_the_golden_trace(params: Path, trace_path: Path) -> None:
    case = read_parameters(params)
    trace, unknown = read_trace(trace_path, case)
    assert unknown == ()
    found = replay(case, choose_events(case, trace_path), trace.time_s, 0.0025)
    sizes = {d.quantity: d.size for d in differences(case, trace, found)}
    assert set(sizes) >= {"w", "Pe", "V"}
    for quantity, tolerance in case.tolerance.items():
        assert sizes[quantity] <= tolerance, (quantity, sizes[quantity])


@pytest.mark.parametrize(("params", "trace_path"), CASES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_default_step_is_close_to_the_golden_trace(params: Path, trace_path: Path) -> None:
    case = read_parameters(params)
    trace, _ = read_trace(trace_path, case)
    found = replay(case, choose_events(case, trace_path), trace.time_s, 0.02)
    sizes = {d.quantity: d.size for d in differences(case, trace, found)}
    assert sizes["w"] < 5e-6 and sizes["Pe"] < 5e-4 and sizes["V"] < 2e-5


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


def test_step_is_refined_until_its_own_error_does_not_matter() -> None:
    """A machine so light that 2.5 ms are far too coarse."""
    machines = list(UNITS.network.machines)
    machines[5] = dataclasses.replace(machines[5], two_h_s=0.1, damping_pu=0.0)
    light = dataclasses.replace(UNITS, network=dataclasses.replace(UNITS.network, machines=tuple(machines)))
    events = (dataclasses.replace(UNITS.events["a"][0], time_s=0.5),)
    times = np.linspace(0.0, 2.0, 17)
    columns, step_s, own_error = replay_closely(light, events, times, 0.0025, {"w": 1e-7})
    assert step_s < 0.0005 and own_error["w"] <= 1e-8
    assert columns["w8"] == pytest.approx(replay(light, events, times, 5e-5)["w8"], abs=2e-8)


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
    for key, machine in zip(UNITS.machine_keys, network.machines, strict=True):
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


def test_angles_are_compared_modulo_a_turn() -> None:
    found = replay(UNITS, (), [0.0], 0.01)
    trace = Trace(np.array([0.0]), {"delta1": found["delta1"] + 2.0 * np.pi, "w1": found["w1"] + 1e-3})
    sizes = {d.quantity: d for d in differences(UNITS, trace, found)}
    assert sizes["delta"].size < 1e-12
    assert sizes["w"].size == pytest.approx(1e-3)
    assert sizes["w"].column == "w1" and sizes["w"].time_s == 0.0


def test_comments_quotes_and_line_ends_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_bytes('\ufeff# made elsewhere\r\n"t", "w1"\r\n0, 1\r\n\r\n1, 1.5\r\n'.encode())
    trace, _ = read_trace(path, UNITS)
    assert trace.time_s.tolist() == [0.0, 1.0] and trace.columns["w1"].tolist() == [1.0, 1.5]


def test_event_list_is_found_by_name_or_said() -> None:
    assert choose_events(UNITS, "anything_b.csv") == UNITS.events["b"]
    assert choose_events(UNITS, "b.csv") == UNITS.events["b"]
    assert choose_events(UNITS, "x.csv", "a") == UNITS.events["a"]
    with pytest.raises(ValueError, match=r"which events does x\.csv show\? Say so with --events; there are: a, b"):
        choose_events(UNITS, "x.csv")
    with pytest.raises(ValueError, match="unknown event list 'c'; the parameter file has: a, b"):
        choose_events(UNITS, "x.csv", "c")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "must begin with a line of different column names"),
        ("w1,V1\n1,1\n", "the first one 't'"),
        ("# only a comment\n", "the first one 't'"),
        ("t,w1,w1\n0,1,1\n", "different column names"),
        ("t,w1\n0,one\n", "is not a table of numbers"),
        ("t,w1\n0,1\n0.1\n", "is not a table of numbers"),
        ("t,w1\n0,1\n0.1,nan\n", "has nan in row 2 of column w1"),
        ("t,w1\n1,1\n0.1,1\n", "not decrease"),
        ("t,w1\n-1,1\n", "begin at 0 s or later"),
        ("t,w1\n0,1\n1e9,1\n", "is outside the allowed range"),
        ("t,speed\n0,1\n", "none of the columns of this case, such as w1, w2a, w2b"),
        ("t,w1\n", "has no rows"),
    ],
)
def test_wrong_traces_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "trace.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=said):
        read_trace(path, UNITS)


def test_step_out_of_range_is_named() -> None:
    with pytest.raises(ValueError, match=r"integration step = 0.1 s is outside the allowed range 5e-05 … 0.04 s"):
        replay(UNITS, (), [0.0], 0.1)
