"""Facts about recordings: they agree with the score, the simulator and the policy's actions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wtg_gym.envs import EnvSettings
from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.evaluation.recording import record
from wtg_gym.physics.scenario import LoadStep, Scenario
from wtg_gym.physics.tracking_law import coordinated_piecewise
from wtg_gym.physics.trajectory import simulate
from wtg_gym.scenarios import get_suite

SEEDS = (20_000, 20_001, 20_002)
SETTINGS = EnvSettings(suite="standard", split="test", duration_s=8.0)


class Steady:
    """Full action on k of the first group, half on its τ; nothing for the second."""

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        return np.tile([1.0, 0.5, 0.0, 0.0], (len(observation), 1)), state


def scenarios() -> list[Scenario]:
    return get_suite("standard").scenarios(SEEDS, duration_s=8.0)


def test_recorded_costs_are_those_that_are_scored() -> None:
    entry = Entry(name="steady", policy=Steady())
    costs = record(entry, SETTINGS, scenarios()).cost_terms.sum(axis=1)
    scored = evaluate([entry], "standard", "test", seeds=SEEDS, duration_s=8.0).episodes_of("steady")
    assert costs.tolist() == pytest.approx([episode.metrics["cost"] for episode in scored], rel=1e-12)


def test_recording_of_a_law_is_the_simulators_trajectory() -> None:
    recording, law = record(Entry(name="coordinated-piecewise"), SETTINGS, scenarios()), coordinated_piecewise()
    run = simulate(scenarios()[1], law)
    assert recording.time_s == pytest.approx(run.time_s)
    assert recording.frequency_hz[1] == pytest.approx(run.frequency_hz, abs=1e-9)
    for name in ("rotor_speed_pu", "tip_speed_ratio", "power_pu", "coefficient_pu", "wind_m_s"):
        assert getattr(recording, name)[1] == pytest.approx(getattr(run, name), abs=1e-9), name
    assert recording.deviation_hz[1] == pytest.approx(run.wtg_frequency_hz - 50.0, abs=1e-9)
    assert recording.filter_hz[1] == pytest.approx(50.0 * run.filter_pu, abs=1e-9)
    assert not recording.offset_pu.any() and (recording.time_constant_s == law.damping_time_constant_s).all()


def test_k_and_tau_are_what_the_policy_decided() -> None:
    recording, law = record(Entry(name="steady", policy=Steady()), SETTINGS, scenarios()), coordinated_piecewise()
    full = 0.5 * (law.k_min - law.k_max)
    assert np.allclose(recording.offset_pu[:, 1:], [full, 0.0])
    assert np.allclose(recording.time_constant_s[:, 1:, 0], 2.0 * law.damping_time_constant_s)
    k = recording.coefficient_pu - recording.offset_pu
    assert ((k > law.k_max - 1e-9) & (k < law.k_min + 1e-9)).all()


def test_recording_is_not_a_number_after_an_early_end() -> None:
    events = (LoadStep(time_s=1.0, bus=3, power_mw=75.0), LoadStep(time_s=2.0, bus=2, power_mw=75.0))
    stalls = Scenario(name="stalls", wind_speed=np.array([[8.0], [6.0]]), duration_s=60.0, events=events)
    calm = Scenario(name="calm", wind_speed=np.array([[9.0], [9.0]]), duration_s=60.0)
    recording = record(Entry(name="mppt", strategy="mppt"), EnvSettings(version="v0"), [stalls, calm])
    assert recording.cost_terms[0, -1] > 0.0 == recording.cost_terms[1, -1]
    running = np.isfinite(recording.frequency_hz)
    assert running[1].all() and running[0, 0] and not running[0, -1] and (np.diff(running[0].astype(int)) <= 0).all()
    assert (np.isfinite(recording.power_pu).all(axis=2) == running).all()
    # A law without transient damping has no τ.
    assert np.isnan(recording.time_constant_s).all()
    alone = record(Entry(name="mppt", strategy="mppt"), EnvSettings(version="v0"), [stalls])
    assert alone.time_s.size == recording.time_s.size == 601
