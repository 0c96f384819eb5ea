"""Other machine sets, limits that bind and events at odd times, against a second implementation of the equations."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.golden.case import GOLDEN, Case, read_case
from tests.golden.independent import Independent
from tests.golden.replay import replay
from wtg_gym.physics.parameters import ProtectionParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Event, GovernorLoss, LineTrip, LoadStep, MachineOutage, Scenario
from wtg_gym.physics.simulator import Simulator

EVENTS = [
    {"t": 0.7345, "bus": 9, "dG_pu": 0.6},
    {"t": 4.777, "bus": 14, "dG_pu": -0.3},
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


def changed(folder: Path, name: str, change: Callable[[Any], None], events: list[dict[str, Any]]) -> tuple[Any, Case]:
    """Return a golden case's data with changes and other events, and the case that is read from them."""
    data = json.loads((GOLDEN / name / "params.json").read_text()) | {"events": {"a": events}}
    change(data)
    path = folder / "params.json"
    path.write_text(json.dumps(data))
    return data, read_case(path)


TOLERANCES = {"w": 1e-8, "V": 2e-8, "P": 2e-6}


@pytest.mark.parametrize(
    ("case", "change", "switches"),
    [
        ("ideal-source-units", lambda data: None, 0),
        ("ideal-source-units", _tight_gate, 1),
        ("classical-machines", _other_machines, 1),
        ("classical-machines", _two_governors, 2),
    ],
    ids=["units", "tight gate", "other machines", "two governors"],
)
def test_replay_agrees_with_a_second_implementation(
    tmp_path: Path, case: str, change: Callable[[Any], None], switches: int
) -> None:
    data, parameters = changed(tmp_path, case, change, EVENTS)
    times = [0.0, *(0.7345 + 0.0001 * k for k in range(3)), 1.0, 1.71, 2.5, 3.3333, 4.9, 5.6, 6.9, 7.1, 8.05, 9.5, 11.0]
    expected = Independent(data).run(EVENTS, times)
    # The limits must bind, or the case shows nothing.
    assert expected.pop("switches")[0] >= switches
    found = replay(parameters, parameters.events["a"], times, 0.0025)
    for name, values in expected.items():
        assert np.abs(found[name] - values).max() < TOLERANCES[name[0]], name


@pytest.mark.parametrize("bus", [6, 1], ids=["condenser", "first machine"])
def test_outages_and_a_line_that_closes_again_agree_with_a_second_implementation(tmp_path: Path, bus: int) -> None:
    data, case = changed(tmp_path, "classical-machines", _two_governors, EVENTS[:1])
    network = case.network
    written = [
        {"t": 0.5, "opens": (2, 4)},
        {"t": 1.25, "closes": (2, 4)},
        {"t": 2.0, "bus": bus, "outage": True},
        {"t": 3.25, "bus": 2, "governor_loss": True},
        {"t": 4.0, "bus": 9, "dG_pu": 0.1},
    ]
    times = [0.1 * k for k in range(1, 60) if k not in (5, 20, 40)]
    expected = Independent(data).run(written, [0.0, *times])
    # The second implementation has no protection.
    wide = ProtectionParameters(frequency_min_pu=0.5)
    plant = PlantSettings(case=network, groups=(), control_dt=0.1, simulation_dt=0.0025, protection=wide)
    simulator = Simulator(plant, duration_s=6.0)
    calm = Scenario(name="calm", wind_speed=np.zeros((0, 1)), duration_s=6.0)
    simulator.start(0, calm, ())
    voltage = abs(simulator.bus_voltages()[network.bus_index(9)])
    events: tuple[Event, ...] = (
        LineTrip(time_s=0.5, from_bus=2, to_bus=4, recloses_after_s=0.75),
        MachineOutage(time_s=2.0, bus=bus),
        GovernorLoss(time_s=3.25, bus=2),
        LoadStep(time_s=4.0, bus=9, power_mw=0.1 * network.base_mva * voltage**2),
    )
    simulator.start(0, dataclasses.replace(calm, events=events), ())
    found: dict[str, list[float]] = {name: [] for name in expected}
    for interval in range(1, 60):
        simulator.advance()
        assert simulator.lane_values("status")[0] == 0.0
        if interval in (5, 20, 40):
            # At an event the one has the value before it.
            continue
        for machine, key in enumerate(data["gens"]):
            found[f"w{key}"].append(simulator.machine_values("speed")[0, machine])
            found[f"Pe{key}"].append(simulator.machine_values("power")[0, machine])
        for number, value in zip(network.bus_numbers, np.abs(simulator.bus_voltages()), strict=True):
            found[f"V{number}"].append(value)
    out = next(key for key, gen in data["gens"].items() if gen["bus"] == bus)
    for name, values in found.items():
        # After its outage a rotor affects nothing: one simulator lets it run on, the other stops it.
        if values and name != f"w{out}":
            assert np.abs(np.array(values) - expected[name][1:]).max() < TOLERANCES[name[0]], name
    assert (expected[f"Pe{out}"][-30:] == 0.0).all()
