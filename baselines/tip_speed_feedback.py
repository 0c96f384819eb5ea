"""The coordinated law with a proportional feedback of the tip-speed ratio, in a few lines by hand.

    P_st = (g(ω) + κ (λ - λ*(ω))) ω_m³

g(ω) asks for a power that is right when the rotor rests where the law wants it. In turbulence it never rests: it is too
fast or too slow for the wind of the moment, captures more or less than was asked for, and drifts back by itself. κ
brings it back sooner: more power from a rotor that is too fast, less from one that is too slow. λ*(ω) is the tip-speed
ratio at which the turbine captures what the characteristic asks at that frequency: all of the available power at ω_min,
95 % at ω_st, 90 % at ω_max, linear in between.

It needs an estimate of the wind, which the law does not, and it limits no overload.

Source: the law is that of Chen et al.; the feedback is the benchmark's own, found by looking at what policies learned.
"""

from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.evaluation import Entry
from wtg_gym.files import sha256
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.tasks import V0
from wtg_gym.tasks.observation import FREQUENCY_UNIT_HZ, WtgObservation, of_groups

from . import COORDINATED_SOURCE

#: Action per (λ - λ_opt)/(λ_pr - λ_opt): the whole authority at a sixth of that range.
GAIN = 6.0


class TipSpeedFeedback:
    """The feedback as a policy: it adds to k, the same in every group."""

    def __init__(self, gain: float = GAIN) -> None:
        self._gain = gain
        control = GridFormingParameters()
        limits = (control.frequency_min_pu, control.frequency_setpoint_pu, control.frequency_max_pu)
        deloading = np.linspace(0.0, control.deloading_limit, 101)
        ratio = np.array([tracking_point(share).tip_speed_ratio for share in deloading.tolist()])
        self._deviation_hz = np.interp(
            deloading, (0.0, control.deloading_nominal, control.deloading_limit), np.multiply(limits, 50.0) - 50.0
        )
        #: λ* as the observation counts it: 0 at λ_opt, 1 at λ_pr.
        self._target = (ratio - ratio[0]) / (ratio[-1] - ratio[0])

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return (actions (num_envs, n_wtg) on k in [-1, 1], no state)."""
        seen = of_groups(np.asarray(observation, dtype=np.float64), WtgObservation, "k")
        target = np.interp(FREQUENCY_UNIT_HZ * seen.frequency_deviation, self._deviation_hz, self._target)
        return np.clip(self._gain * (seen.tip_speed_ratio - target), -1.0, 1.0), state


ENTRY = Entry(
    name="tip-speed-feedback",
    policy=TipSpeedFeedback(),
    action_mode="k",
    environment=V0.env_id,
    learned=False,
    description="The coordinated law with a proportional feedback of the tip-speed ratio, by hand.",
    source=f"{COORDINATED_SOURCE}, with a feedback added",
    fingerprint=sha256(Path(__file__).read_bytes()),
)
