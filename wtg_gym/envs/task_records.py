"""Records of the task: its constants, and what it keeps per lane and WTG group."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from wtg_gym.physics.sensors import DELAY_MAX_S


class Weights(NamedTuple):
    """Weights of the cost's terms and their cap [1/s]; see :class:`~wtg_gym.envs.settings.CostWeights`."""

    frequency: float
    rocof: float
    duty: float
    rotor: float
    overload: float
    effort: float
    cap: float
    unserved: float
    failure: float


class Task(NamedTuple):
    """Constants of the task."""

    modulates_k: bool
    modulates_tau: bool
    share_min: float  # share of the usable power to capture at ω_min, ω_st, ω_max
    share_nominal: float
    share_max: float
    weights: Weights
    control_dt: float  # [s]
    nominal_hz: float
    inv_load: float  # 1 / load of the case [1/p.u.]
    inv_torque: float  # 1 / what the machines' torque is counted in [1/p.u.]
    n_window: int  # of the RoCoF, in control intervals
    n_groups: int
    n_actions: int  # of all groups
    n_substeps: int  # simulation steps per control interval
    duty_gain: float  # of the filter that the duty is charged behind, 1 - exp(-Δt / T) [-]


class Reach(NamedTuple):
    """Constants of the task that a group's turbine decides."""

    k_authority: float  # offset on k at full action [p.u.]
    k_low: float  # K_pr
    k_span: float  # K_opt - K_pr


class CostTerms(NamedTuple):
    """Terms of the cost."""

    frequency: float
    rocof: float
    duty: float
    rotor: float
    overload: float
    effort: float
    failure: float


class GroupRows(NamedTuple):
    """Rows of the task per WTG group."""

    base_inv_tau: float  # of its law [1/s]
    last_speed: float  # its frequency at the last observation [p.u.]
    rocof: float  # of its own frequency over the last control interval [Hz/s]
    last_action_k: float
    last_action_tau: float
    action_k: float  # that acts now
    action_tau: float


class GroupDeviations(NamedTuple):
    """Deviations of one WTG group, in the units of its costs, and its available power [p.u.]."""

    duty: float  # captured less prescribed power, 0.05 of the available power
    rotor: float  # tip-speed ratio outside its band, 0.1 λ_opt
    overload: float  # power beyond the converter's limit, 0.1 p.u.
    available: float


class Acted(NamedTuple):
    """Actions of a WTG group."""

    on_k: float
    on_tau: float


class WtgObservation(NamedTuple):
    """Local measurements of a WTG group, each with its unit and meaning."""

    frequency_deviation: Annotated[float, "0.5 Hz", "frequency of the converter minus the nominal one"]
    rocof: Annotated[float, "Hz/s", "rate of change of that frequency over the last control interval"]
    tip_speed_ratio: Annotated[float, "0 at λ_opt, 1 at λ_pr", "speed of the blade tips over wind speed"]
    rotor_speed: Annotated[float, "0.25 p.u. from 1 p.u.", "rotor speed; the nominal one is 1 p.u."]
    power: Annotated[float, "p.u.", "power into the grid, of the group's rating"]
    wind: Annotated[float, "5 m/s from 10 m/s", "wind, averaged over the rotor"]
    coefficient: Annotated[float, "0 at K_pr, 1 at K_opt", "k in use"]
    filter_state: Annotated[float, "0.5 Hz", "state of the damping filter"]


class MachineObservation(NamedTuple):
    """A synchronous machine, in the privileged observation."""

    speed: Annotated[float, "0.5 Hz", "speed as a frequency, minus the nominal one"]
    power: Annotated[float, "rating", "power into the grid"]
    voltage: Annotated[float, "0.1 p.u. from 1 p.u.", "voltage at the terminal"]


class GridObservation(NamedTuple):
    """The grid, in the privileged observation."""

    frequency_deviation: Annotated[float, "0.5 Hz", "frequency of the centre of inertia minus the nominal one"]
    rocof: Annotated[float, "Hz/s", "rate of change of the frequency of the centre of inertia over 0.5 s"]
    torque: Annotated[float, "100 MVA", "mechanical torque of all machines; on other grids in 39 % of the load"]


class MeasuredObservation(NamedTuple):
    """Measurements of the sensors of a WTG group."""

    frequency_deviation: Annotated[float, "0.5 Hz", "filtered frequency of the converter minus the nominal one"]
    rocof: Annotated[float, "Hz/s", "rate of change of the frequency, filtered"]
    tip_speed_ratio: Annotated[float, "0 at λ_opt, 1 at λ_pr", "measured speed of the blade tips over measured wind"]
    rotor_speed: Annotated[float, "0.25 p.u. from 1 p.u.", "rotor speed; the nominal one is 1 p.u."]
    power: Annotated[float, "p.u.", "power into the grid, of the group's rating"]
    wind: Annotated[float, "5 m/s from 10 m/s", "wind, with a constant and a slow error"]


class Info(NamedTuple):
    """The numbers of `info`, with their units and meanings."""

    time_s: Annotated[float, "s", "time since the start of the episode"]
    frequency_hz: Annotated[float, "Hz", "frequency of the centre of inertia"]
    rocof_hz_s: Annotated[float, "Hz/s", "rate of change of the frequency of the centre of inertia over 0.5 s"]
    cost: Annotated[
        float,
        "-",
        "1 for a step with a failure, an overload, a frequency beyond 50 ± 0.8 Hz or a tip-speed ratio outside its "
        "range, else 0: the cost of safe reinforcement learning",
    ]
    cost_frequency: Annotated[float, "-", "terms of the cost of this step: frequency deviation, in v1 the worst unit's"]
    cost_rocof: Annotated[float, "-", "rate of change of frequency"]
    cost_duty: Annotated[float, "-", "captured power away from the prescribed power; in v1 filtered with 15 s"]
    cost_rotor: Annotated[float, "-", "tip-speed ratio outside its range"]
    cost_overload: Annotated[float, "-", "power above 1.05 p.u., in v0 1.1 p.u."]
    cost_effort: Annotated[float, "-", "actions and their changes"]
    cost_failure: Annotated[float, "-", "what a failure costs at the end, in v1 also load that is not served"]


class LocalInfo(NamedTuple):
    """What `info` has besides in extended physics."""

    worst_frequency_hz: Annotated[float, "Hz", "frequency of the bus or unit that is farthest from nominal"]
    shed_energy_mws: Annotated[float, "MW s", "load not served since the start, at 1 p.u. of voltage"]


#: Window of the rate of change of frequency [s].
ROCOF_WINDOW_S = 0.5
COST_TERMS = CostTerms._fields


def rocof_window(control_dt: float) -> int:
    """Return the RoCoF window in control intervals, at least one."""
    return max(1, round(ROCOF_WINDOW_S / control_dt))


def n_delayed(control_dt: float) -> int:
    """Return how many measurements a lane keeps for the longest delay."""
    return math.ceil(DELAY_MAX_S / control_dt - 1e-9) + 1
