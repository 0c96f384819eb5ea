"""The coordinated law with a fast proportional droop on k: one gain, of the measured frequency.

    P_st = (g(ω) + A (K_opt - K_pr) u) ω_m³ + D_p x,    u = -Δf / 0.25 Hz in -1 … 1

A is the authority of the action. A turbine gives more than the law asks for when the frequency is low, at once and for
as long as it is low, even beyond K_opt, which the rotor pays for, and less when it is high.

It sees what the sensors say, with their delay and noise.

Source: the law is that of Chen et al.; the droop is the benchmark's own.
"""

from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.evaluation import Entry
from wtg_gym.files import sha256
from wtg_gym.tasks import V1
from wtg_gym.tasks.measured_observation import MeasuredObservation
from wtg_gym.tasks.observation import FREQUENCY_UNIT_HZ, of_groups

from . import COORDINATED_SOURCE

#: Deviation of the frequency that takes the whole authority [Hz].
FULL_ACTION_HZ = 0.25


class FastDroop:
    """The droop as a policy: it adds to k, in every group after its own measured frequency."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (num_envs, n_wtg) on k in [-1, 1], no state)."""
        seen = of_groups(np.asarray(observation, dtype=np.float64), MeasuredObservation, "k")
        deviation_hz = FREQUENCY_UNIT_HZ * seen.frequency_deviation
        return np.clip(-deviation_hz / FULL_ACTION_HZ, -1.0, 1.0), state


ENTRY = Entry(
    name="fast-droop",
    policy=FastDroop(),
    action_mode="k",
    environment=V1.env_id,
    learned=False,
    description="The coordinated law with a fast droop on k, one gain of the measured frequency.",
    source=f"{COORDINATED_SOURCE}, with a droop added",
    fingerprint=sha256(Path(__file__).read_bytes()),
)
