"""Version v0: the paper's system, observed exactly."""

from wtg_gym.physics.units import Joining
from wtg_gym.systems.programs import Here
from wtg_gym.tasks import cost, episode, observation
from wtg_gym.tasks.task import Task

#: 0 is maximum power point tracking, 100 the paper's law.
V0 = Task(
    version="v0",
    k_authority=0.5,
    act=(episode.act_on_k, episode.act_on_tau, episode.note_active),
    charge=(
        episode.count_interval,
        episode.shift_history,
        episode.rate_of_change,
        cost.charge_frequency,
        cost.find_deviations,
        cost.charge_group,
        episode.remember_group,
        Here(Joining.CHARGE),
        cost.charge_interval,
        cost.charge_lane,
    ),
    observe=(
        observation.observe_group,
        observation.show_actions,
        observation.observe_machine,
        observation.start_torque,
        observation.add_torque,
        observation.observe_grid,
        Here(Joining.OBSERVE),
        observation.inform,
        observation.inform_of_places,
    ),
    of_groups=(observation.OBSERVED, "observed", "wtg"),
    anchors=("mppt", "coordinated-piecewise"),
)
