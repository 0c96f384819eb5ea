"""Other machine sets, limits that bind and events at odd times, against a second implementation of the equations."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.independent import Independent
from tests.golden_cases import GOLDEN
from wtg_gym.analysis.case_file import read_parameters
from wtg_gym.analysis.replay import replay

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
    data = copy.deepcopy(json.loads((GOLDEN / case / "params.json").read_text()))
    change(data)
    data["events"] = {"a": EVENTS}
    path = tmp_path / "params.json"
    path.write_text(json.dumps(data))
    times = [0.0, *(0.7345 + 0.0001 * k for k in range(3)), 1.0, 1.71, 2.5, 3.3333, 4.9, 5.6, 6.9, 7.1, 8.05, 9.5, 11.0]
    expected = Independent(data).run(EVENTS, times)
    # The limits must bind, or the case shows nothing.
    assert expected.pop("switches")[0] >= switches
    parameters = read_parameters(path)
    found = replay(parameters, parameters.events["a"], times, 0.0025)
    for name, values in expected.items():
        tolerance = {"w": 1e-8, "V": 2e-8, "P": 2e-6}[name[0]]
        assert np.abs(found[name] - values).max() < tolerance, name
