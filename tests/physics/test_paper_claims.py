"""Pinned numbers of the paper's two cases, with GENROU machines and exciters.

The comparison with the paper, claim by claim, is that of the claims' own tests.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.converter import Corners, tracking_coefficient
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.physics.wind_turbine import turbine_constants, turbine_equilibrium
from wtg_gym.scenarios import get_suite

INCREASE, DECREASE = (get_suite("paper").scenario(i) for i in range(2))
#: Available power of the groups, at 11.4 and 8 m/s [p.u.].
AVAILABLE = np.array([1.01722, 0.35154])


@pytest.fixture(scope="module")
def increase() -> dict[str, Trajectory]:
    """+75 MW at bus 2 at 5 s and at bus 3 at 30 s."""
    return {name: simulate(INCREASE, law) for name, law in STRATEGIES.items()}


@pytest.fixture(scope="module")
def decrease() -> dict[str, Trajectory]:
    """Buses 4 and 9 lose their loads."""
    return {name: simulate(DECREASE, law) for name, law in STRATEGIES.items()}


def test_coordinated_law_settles_at_0_996_and_stays_stable(increase: dict[str, Trajectory]) -> None:
    run = increase["coordinated-piecewise"]
    assert run.status == Status.RUNNING
    assert round(run.frequency_hz[-1] / 50.0, 3) == 0.996
    assert run.rotor_speed_pu[-1] == pytest.approx([1.055, 0.740], abs=0.005)
    # Nothing drifts any more.
    assert np.ptp(run.frequency_hz[-200:]) < 1e-3
    assert np.ptp(run.rotor_speed_pu[-200:], axis=0).max() < 1e-4


def test_low_wind_group_stalls_under_the_other_strategies_one_after_the_other(increase: dict[str, Trajectory]) -> None:
    mppt, low, high = (increase[name] for name in ("mppt", "deloaded-5", "deloaded-10"))
    for run in (mppt, low, high):
        assert run.status == Status.STALL
        assert run.tip_speed_ratio[-1, 1] < 3.5 < run.tip_speed_ratio[-1, 0]
    assert 30.0 < mppt.time_s[-1] < low.time_s[-1] < high.time_s[-1] < 120.0
    assert mppt.time_s[-1] == pytest.approx(47.0, abs=4.0)
    assert low.time_s[-1] == pytest.approx(72.0, abs=8.0)
    # The high-wind group is then still right of its optimum.
    assert [run.rotor_speed_pu[-1, 0] for run in (low, high)] == pytest.approx([1.036, 1.099], abs=0.01)


def test_coordinated_law_steps_higher_and_dips_slightly_lower(increase: dict[str, Trajectory]) -> None:
    ours, deloaded = increase["coordinated-piecewise"], increase["deloaded-5"]
    first = ours.time_s < 30.0
    peaks, nadirs = zip(
        *((run.power_pu[: first.sum(), 0].max(), run.frequency_hz[: first.sum()].min()) for run in (ours, deloaded)),
        strict=True,
    )
    assert peaks[0] > peaks[1] + 0.05
    assert 0.0 < nadirs[1] - nadirs[0] < 0.05


def test_coordinated_law_settles_sooner() -> None:
    """Into the usual 2 % of the final value after the first event alone, which leaves all strategies stable.

    In a 1 % band the power of group 1 takes longer (11.5 s against 6.8 s): it follows the governor's slow recovery.
    """
    scenario = dataclasses.replace(INCREASE, events=INCREASE.events[:1], duration_s=300.0)
    runs = [simulate(scenario, STRATEGIES[name]) for name in ("coordinated-piecewise", "deloaded-5", "deloaded-10")]
    assert {run.status for run in runs} == {Status.RUNNING}
    for quantity in ("power_pu", "rotor_speed_pu"):
        for group in range(2):
            values = [getattr(run, quantity)[:, group] for run in runs]
            ours, *others = (runs[0].time_s[np.abs(value / value[-1] - 1.0) > 0.02][-1] for value in values)
            assert ours < min(others)


@pytest.mark.parametrize(
    ("strategy", "powers", "inside"),
    [
        ("deloaded-10", [0.874, 0.273], [False, False]),
        ("deloaded-5", [0.935, 0.299], [True, False]),
        ("coordinated-piecewise", [0.955, 0.330], [True, True]),
    ],
)
def test_powers_after_the_load_decrease_lie_inside_the_regulation_range_or_below(
    decrease: dict[str, Trajectory], strategy: str, powers: list[float], inside: list[bool]
) -> None:
    end = decrease[strategy].power_pu[-1]
    assert end == pytest.approx(powers, abs=0.003)
    assert (end > 0.9 * AVAILABLE).tolist() == inside
    assert strategy != "deloaded-5" or end[1] < 0.3


@pytest.mark.parametrize(("frequency_pu", "share"), [(0.992, 1.0), (1.0, 0.95), (1.008, 0.90)])
@pytest.mark.parametrize("wind", [6.0, 8.0, 11.0])
def test_coordinated_law_captures_its_share_of_the_available_power(
    frequency_pu: float, share: float, wind: float
) -> None:
    law = STRATEGIES["coordinated-piecewise"]
    k = tracking_coefficient(frequency_pu, law.k_min, law.k_nominal, law.k_max, Corners(0.992, 1.0, 1.008))
    plant = PlantSettings()
    turbine = turbine_constants(plant.turbine, plant.pitch, plant.control, plant.protection)
    rotor, pitch, found = turbine_equilibrium(wind, k, turbine, np.zeros((0, 0, 16)))
    assert found and pitch == 0.0
    assert k * rotor**3 == pytest.approx(share * float(available_power_pu(wind)), rel=1e-6)
