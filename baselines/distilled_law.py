"""A control law of five numbers, which a person can read, distilled from the best policy.

    P_st = (g(ω) + A (K_opt - K_pr) u) ω_m³ + D_p x
    u = u_0 + a mean(Δf) + b mean(Δf)' + c (ω_m' - 1 p.u.) + d (v' - 10 m/s)    in -1 … 1

A is the authority of the action, mean(Δf) the mean deviation of the frequency over all groups, ω_m the rotor speed and
v the wind. Primes mark filtered quantities: frequency and speed with 15 s, wind with 40 s. The law asks for more power
where the rotor is slow for the wind, and for less where it is fast. The terms are those that explain most of the
actions of the policy that agents.dagger trains; their numbers were then tuned by the score. It sees what the sensors
say, with their delay and noise.

Source: the law is that of Chen et al.; the terms are the benchmark's own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from wtg_gym.evaluation import Entry
from wtg_gym.files import sha256
from wtg_gym.tasks import V1
from wtg_gym.tasks.measured_observation import MeasuredObservation
from wtg_gym.tasks.observation import FREQUENCY_UNIT_HZ, ROTOR_SPEED_UNIT_PU, of_groups

from . import COORDINATED_SOURCE

#: Time constants of frequency, rotor speed and wind [s].
FILTERS_S = (15.0, 15.0, 40.0)


class Gains(NamedTuple):
    """Numbers of the law."""

    offset: float  # u_0
    frequency: float  # a [1/Hz]
    filtered_frequency: float  # b [1/Hz]
    speed: float  # c [1/p.u.]
    wind: float  # d [s/m]


#: From `docs/studies/policies.py`.
GAINS = Gains(0.0, 0.28, -0.65, -1.66, 0.122)


def terms(seen: MeasuredObservation, before: Any = None) -> tuple[Any, Any]:
    """Return what the numbers multiply (..., n_wtg, 5), and filtered quantities (..., n_wtg, 3) from those before."""
    deviations_hz = FREQUENCY_UNIT_HZ * np.asarray(seen.frequency_deviation)
    mean_hz = np.broadcast_to(deviations_hz.mean(axis=-1, keepdims=True), deviations_hz.shape)
    now = np.stack([mean_hz, ROTOR_SPEED_UNIT_PU * seen.rotor_speed, 5.0 * seen.wind], axis=-1)
    filtered = now if before is None else now + np.exp(-V1.control_dt / np.array(FILTERS_S)) * (before - now)
    ones = np.ones_like(mean_hz)
    return np.concatenate([np.stack([ones, mean_hz], axis=-1), filtered], axis=-1), filtered


class DistilledLaw:
    """The law as a policy; gains that broadcast to (..., n_wtg, 5) are several policies at once."""

    def __init__(self, gains: Any = GAINS) -> None:
        self.gains = gains

    def act(self, seen: MeasuredObservation, before: Any = None) -> tuple[Any, Any]:
        """Return the actions on k in [-1, 1] (..., n_wtg), and what :func:`terms` filters."""
        values, filtered = terms(seen, before)
        return np.clip((np.asarray(self.gains) * values).sum(axis=-1), -1.0, 1.0), filtered

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (num_envs, n_wtg) on k in [-1, 1], filtered quantities (num_envs, n_wtg, 3))."""
        seen = of_groups(np.asarray(observation, dtype=np.float64), MeasuredObservation, "k")
        if state is not None and episode_start is not None:
            fresh = np.asarray(episode_start, dtype=bool)[:, np.newaxis, np.newaxis]
            state = np.where(fresh, terms(seen)[1], state)
        return self.act(seen, state)


ENTRY = Entry(
    name="distilled-law",
    strategy="coordinated-free",
    policy=DistilledLaw(),
    action_mode="k",
    environment=V1.env_id,
    learned=False,
    description="Five numbers that were distilled from the policy that DAgger trains.",
    source=f"{COORDINATED_SOURCE}, with terms added",
    fingerprint=sha256(Path(__file__).read_bytes()),
)
