"""What extended plants refuse."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from tests.physics.extended import LAW, plant, scenario, started
from wtg_gym.physics.parameters import (
    ConverterLimitParameters,
    ProtectionParameters,
    SheddingStage,
    VoltageControlParameters,
)
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.trajectory import simulate


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"voltage": VoltageControlParameters(integral_gain=1000.0)},
            r"eigenvalue -98\d.* 1/s \(mainly wtg[01].internal_voltage\) .* at most 0.0025\d s",
        ),
        ({"voltage": VoltageControlParameters(takeover_gain=100.0)}, r"mainly wtg[01].internal_voltage\)"),
        # It switches at 0.5 p.u. a step once the power exceeds its limit.
        ({"limits": ConverterLimitParameters(power_gain=1.0)}, r"mainly wtg[01].angle\)"),
    ],
)
def test_controls_that_are_too_fast_for_the_step_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=r"simulation_dt = 0.025 s is too long for this plant.*" + message):
        Simulator(plant(**options))


def stages(*shares: float) -> tuple[SheddingStage, ...]:
    return tuple(SheddingStage(frequency_pu=0.98, share=share) for share in shares)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"limits": {"power_max_pu": 1.3}}, r"power_max_pu = 1.3 p.u. exceeds current_max_pu = 1.2"),
        ({"limits": {"current_max_pu": 0.0}}, r"current_max_pu = 0 p.u. is outside"),
        ({"limits": {"power_min_pu": 0.1}}, r"power_min_pu = 0.1 p.u. is outside"),
        ({"limits": {"power_gain": float("nan")}}, r"power_gain = nan p.u./p.u. is outside"),
        ({"limits": {"power_integral_gain": -1.0}}, r"power_integral_gain = -1 .* is outside"),
        ({"voltage_control": {"integral_gain": 0.0}}, r"integral_gain = 0 .* is outside"),
        ({"voltage_control": {"reactive_max_pu": -0.1}}, r"reactive_max_pu = -0.1 p.u. is outside"),
        ({"voltage_control": {"internal_voltage_min_pu": 1.1}}, r"internal_voltage_min_pu = 1.1 p.u. is outside"),
        ({"voltage_control": {"internal_voltage_max_pu": 0.9}}, r"internal_voltage_max_pu = 0.9 p.u. is outside"),
        ({"shedding": stages(0.6, 0.5)}, r"the shedding stages disconnect 110 % of the load"),
        ({"shedding": {"share": -0.1}}, r"share .*= -0.1 is outside"),
        ({"shedding": {"frequency_pu": 1.1}}, r"frequency_pu .*= 1.1 p.u. is outside"),
        ({"shedding": {"delay_s": float("inf")}}, r"delay_s .*= inf s is outside"),
        ({"protection": {"rotor_speed_min_pu": 1.5}}, r"rotor_speed_min_pu = 1.5 p.u. is outside"),
    ],
)
def test_contradicting_settings_are_refused_in_one_line(settings: dict[str, Any], message: str) -> None:
    kinds: dict[str, Any] = {
        "limits": ConverterLimitParameters,
        "voltage_control": VoltageControlParameters,
        "protection": ProtectionParameters,
        "shedding": lambda **values: (SheddingStage(**values),),
    }
    with pytest.raises(ValueError, match=message) as refused:
        PlantSettings(
            **{name: kinds[name](**value) if isinstance(value, dict) else value for name, value in settings.items()}
        )
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"limits": ConverterLimitParameters(power_max_pu=0.5, current_max_pu=3.0)},
            r"cannot start: WTG group 0 at bus 2 .*converter's limits: power 0 … 0.5 p.u.",
        ),
        (
            {"limits": ConverterLimitParameters(power_max_pu=0.8, current_max_pu=0.8)},
            r"cannot start: WTG group 0 at bus 2 .*current at most 0.8 p.u.",
        ),
        (
            {"voltage": VoltageControlParameters(internal_voltage_max_pu=1.1)},
            r"cannot start: .*1.32 p.u. behind X_g, beyond the limits 0.5 … 1.1 p.u.",
        ),
    ],
)
def test_a_start_beyond_a_limit_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        started(plant(**options), scenario())


def test_a_rotor_that_would_start_below_the_under_speed_trip_is_refused() -> None:
    slow = scenario(wind=[[8.0], [4.5]])
    message = (
        r"scenario 'x' cannot start: the rotor of WTG group 1 at bus 2 would start at 0.4\d+ p.u. in a wind of "
        r"4.5 m/s, below the under-speed trip at 0.5 p.u."
    )
    with pytest.raises(ValueError, match=message):
        simulate(slow, LAW, plant(protection=ProtectionParameters(rotor_speed_min_pu=0.5)))
    # Without the trip it runs.
    assert simulate(dataclasses.replace(slow, duration_s=1.0), LAW, plant()).status == Status.RUNNING
