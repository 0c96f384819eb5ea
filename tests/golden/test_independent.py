"""Other machine sets, limits that bind, and every event of a grid, against a second implementation of the equations."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.golden.case import ROW_S, case_of, read_data
from tests.golden.independent import Independent, IndependentConverter
from tests.golden.replay import replay
from tests.physics.extended import recorded
from wtg_gym.physics.grid import Branch, Bus, NetworkCase, Source
from wtg_gym.physics.parameters import ConverterLimitParameters, ProtectionParameters, TurbineParameters, WtgGroup
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Event, FrequencyRamp, GovernorLoss, LineTrip, MachineOutage, PhaseJump, Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import TrackingLaw

TOLERANCES = {"w": 1e-8, "V": 2e-8, "P": 2e-6}
LOADS = [
    {"t": 0.735, "bus": 9, "dG_pu": 0.6},
    {"t": 4.7775, "bus": 14, "dG_pu": -0.3},
    {"t": 7.0, "bus": 3, "trip_load_MW": 50.0},
]


def _tight_gate(data: Any) -> None:
    data["tgov1"].update(VMAX=0.20, R=0.02)


def _other_machines(data: Any) -> None:
    data["fn"], gens = 50.0, data["gens"]
    gens["1"]["ra"], gens["3"]["ra"], gens["6"]["Sn"], gens["2"]["M"], gens["8"]["D"] = 0.01, 0.02, 80, 3.0, 20
    data["tgov1"].update(gen="3", bus=3, VMAX=0.9, Dt=0.5, R=0.03, T1=0.08)


def _two_governors(data: Any) -> None:
    first = {**data["tgov1"], "VMAX": 0.18}
    data["tgov1"] = [first, {**first, "gen": "2", "bus": 2, "T1": 0.02, "VMAX": 1.0, "VMIN": 0.35}]


def compare(data: Any, loads: list[Any], others: dict[Event, list[Any]], end_s: float, left_out: str = "") -> Any:
    """Let both play the same loads and other events, compare all columns but one, and return the second's."""
    case = case_of("changed", data | {"events": {"a": loads}})
    happens = sorted([*loads, *(event for events in others.values() for event in events)], key=lambda event: event["t"])
    # A row at an event may be the one before or after it.
    times = [t for t in np.arange(ROW_S, end_s, ROW_S) if t not in {event["t"] for event in happens}]
    expected = Independent(data).run(happens, times)
    found = replay(case, (*case.events["a"], *others), np.array(times), 0.0025)
    for name in expected.keys() - {"switches", left_out}:
        assert np.abs(found[name] - expected[name]).max() < TOLERANCES[name[0]], name
    return expected


@pytest.mark.parametrize(
    ("name", "change", "switches"),
    [
        ("ideal-source-units", lambda data: None, 0),
        ("ideal-source-units", _tight_gate, 1),
        ("classical-machines", _other_machines, 1),
        ("classical-machines", _two_governors, 2),
    ],
    ids=["units", "tight gate", "other machines", "two governors"],
)
def test_loads_and_limits_agree_with_a_second_implementation(
    name: str, change: Callable[[Any], None], switches: int
) -> None:
    data = read_data(name)
    change(data)
    # The limits must bind, or the case shows nothing.
    assert compare(data, LOADS, {}, 11.0)["switches"][0] >= switches


@pytest.mark.parametrize("bus", [6, 1], ids=["condenser", "first machine"])
def test_outages_and_a_line_that_closes_again_agree_with_a_second_implementation(bus: int) -> None:
    data = read_data("classical-machines")
    _two_governors(data)
    others: dict[Event, list[dict[str, Any]]] = {
        LineTrip(time_s=0.5, from_bus=2, to_bus=4, recloses_after_s=0.75): [
            {"t": 0.5, "opens": (2, 4)},
            {"t": 1.25, "closes": (2, 4)},
        ],
        MachineOutage(time_s=2.0, bus=bus): [{"t": 2.0, "bus": bus, "outage": True}],
        GovernorLoss(time_s=3.25, bus=2): [{"t": 3.25, "bus": 2, "governor_loss": True}],
    }
    out = next(key for key, gen in data["gens"].items() if gen["bus"] == bus)
    # After its outage a rotor affects nothing: one simulator lets it run on, the other stops it.
    expected = compare(data, [{"t": 4.0, "bus": 9, "dG_pu": 0.1}], others, 6.0, left_out=f"w{out}")
    assert (expected[f"Pe{out}"][-30:] == 0.0).all()


def test_a_machine_that_comes_back_agrees_with_a_second_implementation() -> None:
    data = read_data("classical-machines")
    _two_governors(data)
    data["tgov1"][1]["VMIN"] = 0.0
    others: dict[Event, list[dict[str, Any]]] = {
        MachineOutage(time_s=1.0, bus=2, returns_after_s=1.5): [
            {"t": 1.0, "bus": 2, "outage": True},
            {"t": 2.5, "bus": 2, "returns": True},
        ],
    }
    # With the speed, angle and voltage that it finds at its bus: the frequency is not nominal.
    expected = compare(data, [{"t": 0.5, "bus": 9, "dG_pu": 0.4}], others, 8.0, left_out="w2")
    assert abs(expected["w1"][39] - 1.0) > 1e-3 and expected["Pe2"][-1] > 0.05


def test_limits_of_power_and_torque_and_the_chopper_agree_with_a_second_implementation() -> None:
    network = NetworkCase(
        name="a group at an imposed source",
        base_mva=100.0,
        frequency_hz=50.0,
        slack_bus=1,
        buses=(Bus(number=1, voltage_pu=1.0), Bus(number=2, voltage_pu=1.0)),
        branches=(Branch(from_bus=1, to_bus=2, resistance=0.0, reactance=0.1),),
        machines=(),
        sources=(Source(bus=1, reactance=0.05),),
    )
    settings = Plant(
        case=network,
        groups=(WtgGroup(bus=2, n_turbines=20.0),),
        turbine=TurbineParameters(conserves_energy=True),
        limits=ConverterLimitParameters(current_max_pu=10.0),
        protection=ProtectionParameters(frequency_min_pu=0.5, frequency_max_pu=1.5),
        simulation_dt=0.0025,
    )
    events = (
        FrequencyRamp(time_s=1.0, bus=1, rocof_hz_s=-0.5, duration_s=0.8),
        PhaseJump(time_s=6.0, bus=1, angle_deg=-40.0),
        FrequencyRamp(time_s=10.0, bus=1, rocof_hz_s=1.0, duration_s=1.0),
        PhaseJump(time_s=15.0, bus=1, angle_deg=70.0),
    )
    changes = [
        (1.0, 0.0, -0.01),
        (1.8, 0.0, 0.0),
        (6.0, math.radians(-40.0), 0.0),
        (10.0, 0.0, 0.02),
        (11.0, 0.0, 0.0),
        (15.0, math.radians(70.0), 0.0),
    ]
    k = (1.3, 0.65, 0.55)
    law = TrackingLaw(name="steep", k_min=k[0], k_nominal=k[1], k_max=k[2], damping_time_constant_s=0.8)
    what = Scenario(name="x", wind_speed=np.array([[11.0]]), events=events, duration_s=20.0, load_noise_bus=1)
    simulator = Simulator(settings, duration_s=20.0)
    simulator.start(0, what, (law,))
    times = 0.1 * np.arange(1, 201)
    expected = IndependentConverter(k, 11.0, (0.55, 0.1, 0.05)).run(changes, times)
    found = recorded(simulator, 20.0, *expected)
    assert len(found["coi"]) == 200
    for name, values in expected.items():
        tolerance = {"power": 1e-5, "heat": 1e-5, "energy_delivered": 2e-6, "energy_chopped": 2e-6}.get(name, 2e-7)
        assert np.abs(found[name][:, 0] - values).max() < tolerance, name
    # All of it acts.
    assert expected["shift"].min() < -0.01 and expected["shift"].max() > 0.01 and expected["heat"].max() > 0.1
    assert simulator.wtg_values("pitch")[0] == 0.0
