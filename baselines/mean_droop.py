"""The tuned law with a droop on the mean measured frequency, and a protection of slow rotors: three numbers.

    P_st = (g(ω) + A (K_opt - K_pr) u) ω_m³ + D_p x,    u = -mean(Δf)/F + G min(ω_m - ω_1, 0) in -1 … 1

A is the authority of the action. The mean over all groups has less noise than a group's own frequency, and outlasts a
sensor that hangs. Below the rotor speed ω_1 a group gives less, whatever the frequency, before it has to trip.

It sees what the sensors say, with their delay and noise.

Source: the law is that of Chen et al.; droop and protection are the benchmark's own.
"""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.evaluation import Entry
from wtg_gym.files import sha256
from wtg_gym.tasks import V1
from wtg_gym.tasks.observation import FREQUENCY_UNIT_HZ, ROTOR_SPEED_UNIT_PU, of_groups
from wtg_gym.tasks.sensing import MeasuredObservation

from . import COORDINATED_SOURCE

#: F: mean deviation of the frequency that takes the whole authority [Hz].
FULL_ACTION_HZ = 0.53
#: ω_1: rotor speed below which a group gives less [p.u.], and G: how much less [1/p.u.].
SLOW_ROTOR_PU, ROTOR_GAIN = 0.67, 3.3


class MeanDroop:
    """The droop and the protection as a policy.

    Args:
        full_action_hz: mean deviation of the frequency that takes the whole authority [Hz].
        slow_rotor_pu: rotor speed below which a group gives less [p.u.].
        rotor_gain: action that a rotor slower by 1 p.u. takes back [1/p.u.].

    Each may be an array that broadcasts to (..., n_wtg), for several policies at once.
    """

    def __init__(
        self, full_action_hz: Any = FULL_ACTION_HZ, slow_rotor_pu: Any = SLOW_ROTOR_PU, rotor_gain: Any = ROTOR_GAIN
    ) -> None:
        self.full_action_hz, self.slow_rotor_pu, self.rotor_gain = full_action_hz, slow_rotor_pu, rotor_gain

    def act(self, frequency_deviation: Any, rotor_speed: Any) -> npt.NDArray[np.float64]:
        """Return the actions on k in [-1, 1], (..., n_wtg), from what the groups observe, (..., n_wtg) each."""
        deviation_hz = FREQUENCY_UNIT_HZ * frequency_deviation.mean(axis=-1, keepdims=True)
        slower = np.minimum(1.0 + ROTOR_SPEED_UNIT_PU * rotor_speed - self.slow_rotor_pu, 0.0)
        actions: npt.NDArray[np.float64] = -deviation_hz / self.full_action_hz + self.rotor_gain * slower
        return np.clip(actions, -1.0, 1.0)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (n_lanes, n_wtg) on k in [-1, 1], no state)."""
        seen = of_groups(np.asarray(observation, dtype=np.float64), MeasuredObservation, "k")
        return self.act(seen.frequency_deviation, seen.rotor_speed), state


ENTRY = Entry(
    name="mean-droop",
    strategy="coordinated-tuned",
    policy=MeanDroop(),
    action_mode="k",
    environment=V1.env_id,
    learned=False,
    description="The tuned law with a droop on the mean measured frequency and a protection of slow rotors.",
    source=f"{COORDINATED_SOURCE}, with a droop and a protection added",
    fingerprint=sha256(Path(__file__).read_bytes()),
)
