"""An episode: its constants, how actions move k and τ, and the history of frequencies and actions.

Cost, sensors and observations (:mod:`wtg_gym.tasks.cost`, :mod:`wtg_gym.tasks.measured_observation`,
:mod:`wtg_gym.tasks.observation`) follow this history.
"""

import math
from typing import NamedTuple

from wtg_gym.physics.units import ENV
from wtg_gym.physics.wind_turbine import WtgOutput, WtgState, frequency_of
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.elementary import clip, select
from wtg_gym.systems.systems import Kind, system

#: Action modes and which of (k, τ) each of them modulates.
ACTION_MODES: dict[str, tuple[bool, bool]] = {"k": (True, False), "tau": (False, True), "k+tau": (True, True)}
#: Full action multiplies or divides the damping time constant by this to the power of the task's `tau_authority`.
TIME_CONSTANT_RATIO = 4.0
#: Window of the rate of change of frequency [s].
ROCOF_WINDOW_S = 0.5


def rocof_window(interval_s: float) -> int:
    """Return the RoCoF window in control intervals, at least one."""
    return max(1, round(ROCOF_WINDOW_S / interval_s))


class TaskConstants(NamedTuple):
    """Constants of a task."""

    modulates_k: bool
    modulates_tau: bool
    share_min: float  # share of the usable power to capture at ω_min, ω_st, ω_max
    share_nominal: float
    share_max: float
    interval_s: float  # [s]
    nominal_hz: float
    inv_load: float  # 1 / load of the case [1/p.u.]
    n_window: int  # of the RoCoF, in control intervals
    n_groups: int
    n_actions: int  # of all groups
    n_substeps: int  # simulation steps per control interval
    duty_gain: float  # of the filter that the duty is charged behind, 1 - exp(-Δt / T) [-]
    tau_authority: float


class Reach(NamedTuple):
    """Constants of the task that a group's turbine decides."""

    k_authority: float  # offset on k at full action [p.u.]
    k_low: float  # K_pr
    k_span: float  # K_opt - K_pr


class Acted(NamedTuple):
    """Actions of a WTG group."""

    on_k: float
    on_tau: float


class GroupRows(NamedTuple):
    """Rows of the task per WTG group."""

    base_inv_tau: float  # of its law [1/s]
    last_speed: float  # its frequency at the last observation [p.u.]
    rocof: float  # of its own frequency over the last control interval [Hz/s]
    last_action_k: float
    last_action_tau: float
    action_k: float  # that acts now
    action_tau: float


#: The task of an environment.
TASK = Kind(
    name="tasks",
    rows={
        "end_step": float,  # simulation step at which the episode is over
        "interval": float,  # control interval of the newest frequency in the history
        "rocof": float,  # over the window [Hz/s]
        "largest_rocof": float,
    },
    scratch={
        "was_active": float,  # before the step
        "begins": float,  # 1 where the newest interval is a new one
    },
    constants={"task": TaskConstants},
    sees={"env": ENV},
    conditions=("modulates k", "modulates tau", "privileged", "observes exactly"),
)
#: The frequency of the centre of inertia at the ends of the latest control intervals, the oldest first.
HISTORY = Kind(name="history", rows={"frequency": float})
#: Neighbours in the history: each takes the place of the one before it.
SHIFTS = Kind(name="shifts", sees={"this_": HISTORY, "next_": HISTORY, "task": TASK})
#: Both ends of the history.
WINDOW = Kind(name="window", sees={"oldest_": HISTORY, "newest_": HISTORY, "task": TASK, "env": ENV})
#: The task of a WTG group.
ACTING = Kind(
    name="acting groups",
    rows={"group": GroupRows},
    scratch={"wanted": Acted},
    constants={"reach": Reach},
    sees={"group": GROUPS, "task": TASK, "env": ENV},
)


@system(ACTING, "action_k", "k_offset", when="modulates k")
def act_on_k(wanted_on_k: float, reach: Reach) -> tuple[float, float]:
    """Turn an action into an offset on k; zero leaves the law to the last bit."""
    action = clip(wanted_on_k, -1.0, 1.0)
    return action, reach.k_authority * action


@system(ACTING, "action_tau", "inv_tau", when="modulates tau")
def act_on_tau(wanted_on_tau: float, base_inv_tau: float, task: TaskConstants) -> tuple[float, float]:
    """Turn an action into a scale on τ; zero leaves the law to the last bit."""
    action = clip(wanted_on_tau, -1.0, 1.0)
    return action, base_inv_tau * TIME_CONSTANT_RATIO ** -(task.tau_authority * action)


@system(TASK, "was_active")
def note_active(active: float) -> float:
    return active


@system(TASK, "interval", "begins")
def count_interval(was_active: float, interval: float, step: float, task: TaskConstants) -> tuple[float, float]:
    """Count control intervals; a run that ends early in one has not begun another."""
    newest = select(was_active > 0.5, _rounded(step / task.n_substeps), interval)
    return newest, select(newest > interval, 1.0, 0.0)


def _rounded(value: float) -> float:
    """Return the nearest whole number, the even one of two."""
    up = math.floor(value + 0.5)
    odd = up - 2.0 * math.floor(0.5 * up)
    return select((up - value == 0.5) & (odd == 1.0), up - 1.0, up)


@system(SHIFTS, "this_frequency")
def shift_history(this_frequency: float, next_frequency: float, begins: float) -> float:
    """Move the history on where an interval begins; else the newest frequency is replaced."""
    return select(begins > 0.5, next_frequency, this_frequency)


@system(WINDOW, "newest_frequency", "task_rocof", "largest_rocof")
def rate_of_change(
    oldest_frequency: float,
    newest_frequency: float,
    coi: float,
    was_active: float,
    task_rocof: float,
    largest_rocof: float,
    task: TaskConstants,
) -> tuple[float, float, float]:
    """Put the new frequency into the history, and find its rate of change over the window [Hz/s]."""
    ran = was_active > 0.5
    change = (coi - oldest_frequency) * task.nominal_hz
    new = select(ran, change / (task.n_window * task.interval_s), task_rocof)
    return select(ran, coi, newest_frequency), new, max(largest_rocof, abs(new))


@system(ACTING, "group")
def remember_group(
    group: GroupRows, state: WtgState, output: WtgOutput, was_active: float, task: TaskConstants
) -> GroupRows:
    ran, speed = was_active > 0.5, frequency_of(state, output)
    change = (speed - group.last_speed) / task.interval_s
    return group._replace(
        last_speed=select(ran, speed, group.last_speed),
        rocof=select(ran, change * task.nominal_hz, group.rocof),
        last_action_k=select(ran, group.action_k, group.last_action_k),
        last_action_tau=select(ran, group.action_tau, group.last_action_tau),
    )


@system(TASK, "active")
def end_episode(active: float, was_active: float, step: float, end_step: float) -> float:
    """Let an environment at its end stand still until it is started again."""
    return select((was_active > 0.5) & (step >= end_step - 0.5), 0.0, active)
