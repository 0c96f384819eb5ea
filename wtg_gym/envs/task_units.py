"""Kinds of unit of the task: what it keeps of a lane, of its WTG groups and machines, and of their sensors."""

from __future__ import annotations

from wtg_gym.envs.task_records import (
    Acted,
    CostTerms,
    GridObservation,
    GroupDeviations,
    GroupRows,
    Info,
    LocalInfo,
    MachineObservation,
    MeasuredObservation,
    Reach,
    Task,
    WtgObservation,
)
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.sensors import Noise, SensorInput, SensorState
from wtg_gym.physics.units import LANE
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.systems import Kind

#: The task of a lane.
TASK = Kind(
    name="tasks",
    rows={
        "end_step": float,  # simulation step at which the episode is over
        "interval": float,  # control interval of the newest frequency in the history
        "rocof": float,  # over the window [Hz/s]
        "largest_rocof": float,
        "sums": CostTerms,  # of the cost over the episode
        "terms": CostTerms,  # of the cost of the last step
        "cost": float,  # of the last step
        "constraint": float,  # 1 where the last step violated a constraint
        "constraint_sum": float,
        "available_energy": float,  # of all groups [p.u. s of the system base]
        "duty_error": float,  # ∫ |captured - prescribed| / available dt, mean over groups [s]
    },
    scratch={
        "was_active": float,  # before the step
        "begins": float,  # 1 where the newest interval is a new one
        "term_rates": CostTerms,  # of the step that is being charged [1/s]
        "new_terms": CostTerms,  # what it costs
        "farthest": float,  # largest deviation of the frequency of any unit [p.u.]
        "elapsed": float,  # how long that step lasted [s]
        "violated": float,  # 1 where it violated a constraint
        "error": float,  # its duty error, mean over groups [-]
        "total_torque": float,  # of all machines [p.u.]
        "grid_observed": GridObservation,
        "info": Info,
        "local_info": LocalInfo,  # follows it
    },
    constants={"task": Task},
    sees={"lane": LANE},
    conditions=(
        *("modulates k", "modulates tau"),
        *("exact observation", "privileged"),
        *("charges worst", "charges capped"),  # frequency: of the worst unit, or of the centre of inertia with a cap
    ),
)

#: The frequency of the centre of inertia at the ends of the latest control intervals, the oldest first.
HISTORY = Kind(name="history", rows={"frequency": float})
#: Neighbours in the history: each takes the place of the one before it.
SHIFTS = Kind(name="shifts", sees={"this_": HISTORY, "next_": HISTORY, "task": TASK})
#: Both ends of the history.
WINDOW = Kind(name="window", sees={"oldest_": HISTORY, "newest_": HISTORY, "task": TASK, "lane": LANE})

#: The task of a WTG group.
ACTING = Kind(
    name="acting groups",
    rows={"group": GroupRows},
    scratch={
        "wanted": Acted,
        "shown_actions": Acted,
        "observed": WtgObservation,
        "deviations": GroupDeviations,
        "charged_duty": float,  # in v1 filtered
        "there": float,  # 0 for a group that an event has disconnected, else 1
    },
    constants={"reach": Reach},
    sees={"group": GROUPS, "task": TASK, "lane": LANE},
)

#: The task of a synchronous machine.
WATCHED = Kind(
    name="watched machines",
    scratch={"machine_observed": MachineObservation},
    sees={"machine": MACHINES, "task": TASK, "lane": LANE},
)

#: The sensors that all WTG groups of a lane have.
SENSORS = Kind(name="sensors", rows={"sensor_input": SensorInput})
#: The sensors of a WTG group.
SENSED = Kind(
    name="sensed groups",
    rows={
        "sensors": SensorState,
        "wind_bias": float,
        "leaves_at": float,  # simulation step at which an event disconnects it
        "returns_at": float,  # and at which it comes back
        "mean_duty": float,  # signed duty error behind its filter, 0.05 of the available power
    },
    scratch={
        "noise": Noise,
        "seen": MeasuredObservation,  # what is measured now
        "shown": MeasuredObservation,  # the newest measurement that has arrived
        "shown_duty": float,
    },
    constants={"group_number": float},
    sees={"acting": ACTING, "group": GROUPS, "sensors": SENSORS, "task": TASK, "lane": LANE},
)
#: The latest measurements of all groups, one after the other in a ring.
RING = Kind(name="ring", rows={"measurement": MeasuredObservation})
