"""Parameter files of other simulators are read exactly, and unknown content is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.golden_cases import GOLDEN
from wtg_gym.analysis.case_file import DEFAULT_TOLERANCE, read_parameters
from wtg_gym.analysis.replay import replay

PARAMS = GOLDEN / "ideal-source-units" / "params.json"
HYGOV = dict(R=0.05, r=0.4, Tr=8.0, Tf=0.05, Tg=0.5, VELM=0.2, GMIN=0.0, GMAX=0.1, Tw=1.3, At=1.1, Dt=0.0, qNL=0.08)


@pytest.fixture
def edited(tmp_path: Path) -> Callable[[Callable[[Any], object]], Path]:
    """A copy of the parameter file with a change."""

    def edit(change: Callable[[Any], object]) -> Path:
        data = json.loads(PARAMS.read_text())
        change(data)
        path = tmp_path / "params.json"
        path.write_text(json.dumps(data))
        return path

    return edit


def test_machines_network_and_events_are_read() -> None:
    case = read_parameters(PARAMS)
    assert case.machine_keys == ("1", "2a", "2b", "3", "6", "8")
    assert [machine.rating_mva for machine in case.network.machines] == [615, 50, 50, 60, 25, 25]
    assert case.network.machines[0].governor is not None
    assert case.network.machines[1].governor is None
    assert case.network.machines[1].dispatch_mw == pytest.approx(20.0)
    assert case.network.frequency_hz == 60.0 and case.network.slack_bus == 1
    assert [event.time_s for event in case.events["a"]] == [5.0, 30.0]
    assert [event.power_mw for event in case.events["a"]] == pytest.approx([75.0, 75.0])
    # The whole load goes, its reactive part too.
    assert [(e.power_mw, e.reactive_mvar) for e in case.events["b"]] == [(-47.8, -10.0), (-29.5, -16.6)]
    assert case.tolerance == DEFAULT_TOLERANCE


def test_several_loads_and_governors_and_a_part_of_a_load_are_read(edited: Any) -> None:
    def change(data: Any) -> None:
        load = data["load"].pop(0)
        data["load"] += [{**load, "P": 0.4 * load["P"], "Q": load["Q"]}, {**load, "P": 0.6 * load["P"], "Q": 0.0}]
        data["tgov1"] = [data["tgov1"], {**data["tgov1"], "gen": "3", "bus": 3, "R": 0.04}]
        data["events"] = [{"t": 1.25, "bus": 4, "trip_load_MW": 23.9}, {"t": 0.5, "bus": 9, "dB_pu": 0.1}]
        data["tolerance"] = {"w": 1e-7}

    case = read_parameters(edited(change))
    bus = case.network.buses[case.network.bus_index(2)]
    assert (bus.load_mw, bus.load_mvar) == pytest.approx((21.7, 12.7))
    assert case.network.machines[3].governor is not None and case.network.machines[3].governor.droop_pu == 0.04
    (events,) = case.events.values()
    assert [event.time_s for event in events] == [0.5, 1.25]
    assert events[0].reactive_mvar == pytest.approx(-10.0 * case.voltage[9][0] ** 2)
    assert (events[1].power_mw, events[1].reactive_mvar) == pytest.approx((-23.9, -5.0))
    assert case.tolerance == {**DEFAULT_TOLERANCE, "w": 1e-7}


def test_reactive_shares_are_those_of_the_file(edited: Any) -> None:
    def change(data: Any) -> None:
        data["gens"]["2a"]["gammaq"], data["gens"]["2b"]["gammaq"] = 0.3, 0.7
        data["gens"]["2a"]["gammap"], data["gens"]["2b"]["gammap"] = 0.6, 0.4

    case = read_parameters(edited(change))
    at_rest = replay(case, (), [0.0, 5.0], 0.01)
    total = json.loads(PARAMS.read_text())["gen_static"]["2"]
    for key, p, q in (("2a", 0.6, 0.3), ("2b", 0.4, 0.7)):
        # The file's own power flow is good to about 1e-8.
        assert at_rest[f"Pe{key}"] == pytest.approx([p * total["P"]] * 2, abs=1e-7)
        assert at_rest[f"Qe{key}"] == pytest.approx([q * total["Q"]] * 2, abs=1e-7)
        assert at_rest[f"w{key}"] == pytest.approx([1.0, 1.0], abs=1e-10)


def test_any_machine_bus_can_have_the_angle_zero(edited: Any) -> None:
    def change(data: Any) -> None:
        turn = next(bus["theta"] for bus in data["bus"] if bus["bus"] == 3)
        for bus in data["bus"]:
            bus["theta"] -= turn

    case, original = read_parameters(edited(change)), read_parameters(PARAMS)
    assert case.network.slack_bus == 3
    times = np.linspace(0.0, 8.0, 33)
    turned, straight = (replay(c, c.events["a"], times, 0.01) for c in (case, original))
    for name in ("w1", "Pe2a", "V14", "Tm1"):
        assert turned[name] == pytest.approx(straight[name], abs=1e-7)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.pop("line"), "line of the parameter file .* must be a list, got None"),
        (lambda d: d.update(fn="50"), "fn of the parameter file .* must be a finite positive number, got '50'"),
        (lambda d: d["gens"]["3"].update(Sn=-60), r"Sn of gens|Sn of 3 of gens .* must be a finite positive number"),
        (lambda d: d["gens"]["3"].update(M=0), "M of 3 of gens .* must be a finite positive number, got 0"),
        (lambda d: d["gens"]["3"].update(model="REGCV1"), "must be GENCLS or GENROU, got 'REGCV1'"),
        (lambda d: d["gens"]["3"].update(bus=99), "99 of gen_static"),
        (lambda d: d["gen_static"].pop("3"), "3 of gen_static"),
        (lambda d: d["gens"]["1"].update(gammap=0.6), "gammap of the machines at bus 1 add up to 0.6"),
        (lambda d: d["gens"]["2a"].update(gammaq=0.7), "gammaq of the machines at bus 2 add up to 1.2"),
        (lambda d: d["gen_static"]["1"].update(P=0.9), "the power of machine 1 in the file's power flow is 0.9"),
        (lambda d: d["gen_static"]["3"].update(Q=0.9), "the power of machine 3 in the file's power flow is"),
        (lambda d: d.update(tgov1=[d["tgov1"], d["tgov1"]]), "is the second one of machine '1'"),
        (lambda d: d["tgov1"].update(gen=None, bus=2), "must name its machine .gen.: bus 2 has 2 machines"),
        (
            lambda d: d["events"].update(a=[{"t": t, "bus": 4, "trip_load_MW": 30} for t in (1, 2)]),
            "more than bus 4 has",
        ),
        (lambda d: d["bus"].append(d["bus"][3]), "is bus 4 for the second time"),
        (lambda d: d["line"][3].update(u=0), "is switched off .u = 0.; leave it out"),
        (lambda d: d["line"][3].update(t=2), "a branch goes from bus 2 to itself"),
        (lambda d: d["tgov1"].update(VMIN=2.0), "outside the limits VMIN … VMAX = 2 … 1.2"),
        (lambda d: d.update(hygov=d["tgov1"]), "the machine '1' has a tgov1 and a hygov"),
        (lambda d: d.update(hygov={**HYGOV, "gen": "1"}, tgov1=[]), "outside the limits GMIN … GMAX = 0 … 0.1"),
        (lambda d: d.update(hygov={**HYGOV, "gen": "1", "Tw": 0.0}, tgov1=[]), "Tw of hygov.* positive number, got 0"),
        (lambda d: d["gens"].pop("3"), "gen_static of .* has buses without a machine: 3"),
        (lambda d: d["tgov1"].update(gen="7"), r"tgov1.0. of .* belongs to an unknown machine '7'"),
        (lambda d: d["tgov1"].update(VMAX=0.05), "its machine at bus 1 starts with a gate of 0.1324"),
        (lambda d: d["events"]["a"][0].update(bus=15), "is at bus 15, which the file does not list"),
        (lambda d: d["events"]["a"][0].pop("dG_pu"), "must give dG_pu, dB_pu or trip_load_MW"),
        (lambda d: d["events"]["a"][0].update(t=-1.0), "event time = -1 s is outside"),
        (lambda d: d["events"]["b"][0].update(trip_load_MW=60.0), "disconnects 60 MW, but bus 4 has a load of 47.8 MW"),
        (lambda d: d["load"][0].update(bus=77), "is at bus 77, which the file does not list"),
        (lambda d: d["line"][0].update(t=77), "unknown bus 77"),
        (lambda d: d["line"][0].update(r=0.0, x=0.0), "branch 1-2 has no impedance"),
        (lambda d: d.update(tolerance={"P": 1e-6}), r"has unknown quantities \['P'\]"),
        (lambda d: d["bus"][4].update(V=1.2), "are not a power flow of its own network and powers: at bus 5"),
        (lambda d: (d["gens"].clear(), d.pop("tgov1")), "has no machine"),
        (lambda d: d.update(sexs={"gen": "3"}), "is a GENCLS with an exciter; its voltage is constant"),
    ],
)
def test_wrong_files_are_refused_with_the_place_and_the_value(
    edited: Any, change: Callable[[Any], object], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        case = read_parameters(edited(change))
        replay(case, case.events["a"], [0.0], 0.01)


def test_what_is_not_understood_is_listed(edited: Any) -> None:
    def change(data: Any) -> None:
        data["fault"], data["line"][0]["rate"], data["gens"]["3"]["H"] = [{"bus": 3}], 100.0, 5.0

    assert read_parameters(PARAMS).unused == ()
    unused = read_parameters(edited(change)).unused
    assert [place.split(" of the parameter")[0] for place in unused] == ["fault", "H of 3 of gens", "rate of line[0]"]


def test_null_and_whole_floats_and_missing_events_are_understood(edited: Any) -> None:
    def change(data: Any) -> None:
        data["events"], data["gens"]["3"]["D"], data["line"][0]["f"] = None, None, 1.0
        data["tgov1"].pop("gen")
        data["gens"]["2a"]["gammaq"], data["gens"]["2b"]["gammaq"] = 0.0, 1.0

    case = read_parameters(edited(change))
    assert case.events == {} and case.network.machines[3].damping_pu == 0.0
    assert case.network.machines[0].governor is not None
    assert replay(case, (), [1.0], 0.01)["w3"] == pytest.approx([1.0], abs=1e-9)


def test_event_of_several_parts_is_their_sum(edited: Any) -> None:
    def change(data: Any) -> None:
        data["events"] = [{"t": 1.0, "bus": 4, "dG_pu": 0.1, "dB_pu": 0.2, "trip_load_MW": 47.8}]

    case = read_parameters(edited(change))
    ((event,),) = case.events.values()
    square = case.voltage[4][0] ** 2
    assert event.power_mw == pytest.approx(10.0 * square - 47.8)
    assert event.reactive_mvar == pytest.approx(-20.0 * square - 10.0)


@pytest.mark.parametrize("text", ["", "[1, 2]", "{", '{"Sbase": NaN}', "\x00"])
def test_what_is_no_parameter_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "params.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"params\.json"):
        read_parameters(path)
    with pytest.raises(ValueError, match="cannot read the parameter file"):
        read_parameters(tmp_path / "nowhere.json")
