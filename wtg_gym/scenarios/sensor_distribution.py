"""The distribution that the errors of a run's sensors are drawn from."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wtg_gym.physics.scenario import trusted
from wtg_gym.physics.sensors import DELAY_MAX_S, Sensors
from wtg_gym.ranges import Checked, design, require_known
from wtg_gym.scenarios.stream import seed_streams

#: The delay is drawn from whole numbers of these [s].
DELAY_STEP_S = 0.1
#: A drawn bias lies within this many standard deviations.
_MOST_DEVIATIONS = 2.5


@dataclass(frozen=True, kw_only=True)
class SensorDistribution(Checked):
    """Distribution of the sensors' errors; a value without a meaning of its own is that of every run's `Sensors`."""

    delay_s: tuple[float, float] = design(
        (0.1, 0.3), "s", "whole numbers of 0.1 s; every one between is as likely", 0.0, DELAY_MAX_S
    )
    frequency_filter_s: float = 0.1
    frequency_noise_hz: float = 0.005
    rocof_filter_s: float = 0.2
    rocof_noise_hz_s: float = 0.05
    rotor_speed_noise_pu: float = 0.003
    power_noise_pu: float = 0.01
    wind_bias: float = design(
        0.01, "-", "standard deviation of each group's; none is larger than 2.5 times this", 0.0, 0.2
    )
    wind_noise: float = 0.01
    wind_noise_correlation_s: float = 3.0
    wind_sensor: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(abs(delay / DELAY_STEP_S - round(delay / DELAY_STEP_S)) > 1e-6 for delay in self.delay_s):
            raise ValueError(f"delay_s must be whole numbers of {DELAY_STEP_S:g} s, got {self.delay_s} s")
        # Checks the values that are the same in every scenario.
        Sensors(**{**vars(self), "seed": 0, "delay_s": 0.0, "wind_bias": (0.0,)})

    def replaced(self, changes: Mapping[str, Any]) -> SensorDistribution:
        """Return the distribution with some of its values replaced; a ValueError lists the known names."""
        require_known("values of the sensors", changes, [field.name for field in dataclasses.fields(self)])
        return dataclasses.replace(self, **changes)

    def delays_s(self) -> list[float]:
        """Return every delay that may be drawn [s]."""
        shortest, longest = (round(delay / DELAY_STEP_S) for delay in self.delay_s)
        return [round(DELAY_STEP_S * steps, 9) for steps in range(shortest, longest + 1)]

    def draw_many(self, name: str, seeds: Sequence[int], n_wtg: int) -> list[Sensors]:
        """Draw the sensors of several seeds; `name` is that of the scenarios' distribution.

        What is drawn scales with the distribution: with twice the `wind_bias`, every bias is twice as large.
        """
        streams = seed_streams(seeds, zlib.crc32(f"{name}/sensors".encode()))
        uniform = np.array([stream.random(2 + 12 * n_wtg) for stream in streams]).reshape(len(seeds), 2 + 12 * n_wtg)
        delays = self.delays_s()
        # The sum of twelve uniform numbers is nearly normal; platforms agree on its last bit.
        deviations = uniform[:, 2:].reshape(len(seeds), n_wtg, 12).sum(axis=2) - 6.0
        biases = self.wind_bias * np.clip(deviations, -_MOST_DEVIATIONS, _MOST_DEVIATIONS)
        shared = {name: value for name, value in vars(self).items() if name not in ("delay_s", "wind_bias")}
        return [
            trusted(
                Sensors,
                **shared,
                seed=int(own[0] * 2**31),
                delay_s=delays[int(own[1] * len(delays))],
                wind_bias=tuple(bias),
            )
            for own, bias in zip(uniform.tolist(), biases.tolist(), strict=True)
        ]
