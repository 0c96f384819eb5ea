"""Pinned numbers of the paper's two cases, with GENROU machines and exciters.

The comparison with the paper, claim by claim, is that of the claims' own tests.
"""

from __future__ import annotations

import pytest

from wtg_gym.physics.protection import Status
from wtg_gym.physics.trajectory import simulate
from wtg_gym.scenarios import get_suite


@pytest.mark.parametrize(
    ("strategy", "status", "end_s", "within_s", "rotor_speed"),
    [
        ("mppt", Status.STALL, 47.0, 4.0, None),
        ("deloaded-5", Status.STALL, 72.0, 8.0, 1.036),
        ("deloaded-10", Status.STALL, 83.0, 8.0, 1.099),
        ("coordinated-piecewise", Status.RUNNING, 120.0, 0.0, 1.055),
    ],
)
def test_load_increase_of_the_paper(
    strategy: str, status: Status, end_s: float, within_s: float, rotor_speed: float | None
) -> None:
    """+75 MW at bus 2 at 5 s and at bus 3 at 30 s: the group at 8 m/s stalls, but not under the coordinated law."""
    run = simulate(get_suite("paper").scenario(0), strategy)
    assert run.status == status
    assert run.time_s[-1] == pytest.approx(end_s, abs=within_s + 1e-9)
    assert rotor_speed is None or run.rotor_speed_pu[-1, 0] == pytest.approx(rotor_speed, abs=0.01)
    if status == Status.RUNNING:
        assert run.frequency_hz[-1] / 50.0 == pytest.approx(0.996, abs=0.0005)
        assert run.rotor_speed_pu[-1, 1] == pytest.approx(0.740, abs=0.005)
    else:
        assert run.tip_speed_ratio[-1, 1] < 3.5 < run.tip_speed_ratio[-1, 0]


@pytest.mark.parametrize(
    ("strategy", "powers"),
    [("deloaded-10", [0.874, 0.273]), ("deloaded-5", [0.935, 0.299]), ("coordinated-piecewise", [0.955, 0.330])],
)
def test_powers_after_the_load_decrease_of_the_paper(strategy: str, powers: list[float]) -> None:
    """Buses 4 and 9 lose their loads."""
    run = simulate(get_suite("paper").scenario(1), strategy)
    assert run.power_pu[-1] == pytest.approx(powers, abs=0.003)
