"""The single-machine loops: published margins, and what holds for every loop."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.reproduce.loops import LINEAR_UNDAMPED, SingleMachine, ideal_source_loop, single_machine

LINEAR = STRATEGIES["coordinated-linear"]


@pytest.mark.parametrize(
    ("loop", "margin_deg"),
    [
        (ideal_source_loop(), 48.8),
        (single_machine(STRATEGIES["deloaded-5"], 11.4), 46.7),
        (single_machine(STRATEGIES["deloaded-10"], 11.4), 46.9),
        (single_machine(LINEAR_UNDAMPED, 11.4), 29.1),
        (single_machine(LINEAR, 11.4), 55.4),
        (single_machine(LINEAR_UNDAMPED, 8.0), 10.1),
    ],
    ids=["ideal", "deloaded-5", "deloaded-10", "undamped", "damped", "undamped at 8 m/s"],
)
def test_phase_margins_are_those_of_the_paper(loop: SingleMachine, margin_deg: float) -> None:
    assert loop.margins().phase_margin_deg == pytest.approx(margin_deg, abs=0.05)


@given(st.floats(4.0, 11.0), st.floats(0.2, 5.0), st.floats(0.05, 20.0), st.sampled_from(["under", "over"]))
def test_margins_agree_with_a_fine_sweep_and_with_the_poles(wind: float, k_p: float, tau: float, side: str) -> None:
    law = dataclasses.replace(STRATEGIES["coordinated-piecewise"], name="x", damping_time_constant_s=tau)
    loop = single_machine(law, wind, k_p, side=side)  # type: ignore[arg-type]
    found = loop.margins()
    sweep = np.logspace(-4, 3, 20_001)
    gain = np.abs(loop.response(sweep))
    crossings = np.flatnonzero((gain[:-1] - 1.0) * (gain[1:] - 1.0) <= 0.0)
    margins = [180.0 + np.degrees(np.unwrap(np.angle(loop.response(sweep))))[i] for i in crossings]
    margins = [(margin + 180.0) % 360.0 - 180.0 for margin in margins]
    if not found.stable:
        assert math.isnan(found.phase_margin_deg) and loop.closed_loop_poles().real.max() >= 0.0
        return
    assert found.phase_margin_deg == pytest.approx(min(margins), abs=0.5)
    assert abs(loop.response(found.crossover_rad_s)) == pytest.approx(1.0, abs=1e-9)
    # One crossover and a rolling-off loop: Nyquist says the sign of the margin decides.
    assert found.phase_margin_deg > 0.0


def test_impossible_questions_are_named() -> None:
    with pytest.raises(ValueError, match=r"synchronising coefficient = 0 p.u./rad is outside .* 0.01 … 100"):
        single_machine(LINEAR, 11.4, 0.0)
    with pytest.raises(ValueError, match=r"the pitch protection holds the rotor at 13 m/s"):
        single_machine(LINEAR, 13.0)
    greedy = TrackingLaw(name="greedy", k_min=3.0, k_nominal=3.0, k_max=3.0)
    with pytest.raises(ValueError, match=r"'greedy' has no equilibrium at 8 m/s"):
        single_machine(greedy, 8.0)
