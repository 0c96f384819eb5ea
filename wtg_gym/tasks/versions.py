"""The two versions: v0, the paper's system observed exactly; v1, a grid that depends on the wind, seen by sensors."""

from wtg_gym.physics.units import Joining
from wtg_gym.systems.programs import Here
from wtg_gym.tasks import cost, episode, observation, task
from wtg_gym.tasks import measured_observation as measured

#: What both versions do.
_ACT = (episode.act_on_k, episode.act_on_tau, episode.note_active)
_CHARGE_FREQUENCY = (episode.count_interval, episode.shift_history, episode.rate_of_change, cost.charge_frequency)
_OBSERVE = (
    observation.observe_group,
    observation.show_actions,
    observation.show_duty,
    observation.observe_machine,
    observation.start_torque,
    observation.add_torque,
    observation.observe_grid,
    Here(Joining.OBSERVE),
    observation.inform,
    observation.inform_of_places,
)
#: 0 is maximum power point tracking, 100 the paper's law.
V0 = task.Task(
    version="v0",
    k_authority=0.5,
    act=_ACT,
    charge=(
        *_CHARGE_FREQUENCY,
        cost.find_deviations,
        cost.charge_group,
        episode.remember_group,
        Here(Joining.CHARGE),
        cost.charge_interval,
        cost.charge_env,
    ),
    observe=_OBSERVE,
    of_groups=(observation.OBSERVED, "observed", "wtg"),
    anchors=("mppt", "coordinated-piecewise"),
)
#: 0 is the paper's law, 100 the same law tuned to this grid.
V1 = task.Task(
    version="v1",
    # Half of the range of a search with foresight, whose actions had a standard deviation of 0.2 in it.
    k_authority=0.5,
    tau_authority=0.5,
    control_dt=0.5,
    interval_s=0.1,
    rewards_score=True,
    act=_ACT,
    charge=(
        *_CHARGE_FREQUENCY,
        cost.start_largest_deviation,
        cost.compare_machine,
        cost.compare_group,
        cost.charge_largest_deviation,
        cost.find_deviations_at_grid_frequency,
        cost.filter_duty,
        cost.charge_group,
        episode.remember_group,
        Here(Joining.CHARGE),
        cost.charge_interval_partly_capped,
        cost.charge_env,
    ),
    start_sensors=(measured.draw_noise, measured.start_sensors, measured.measure_group, measured.start_measurements),
    measure=(
        measured.draw_noise,
        measured.advance_sensors,
        measured.measure_group,
        measured.shift_measurements,
        measured.keep_measurement,
    ),
    observe=_OBSERVE,
    of_groups=(measured.SENSED, "shown", "wtg"),
    privileged=((observation.OBSERVED, "observed", "exact"), (observation.OBSERVED_DUTY, "shown_duty", "exact")),
    # Duty costs as much as frequency, since the wind is most of the power. RoCoF weighs five times as much as in v0,
    # since the synchronous machines have 0.82 instead of 2.86 GWs of inertia on average. The effort weighs as much per
    # change of k and τ as in v0.
    weights=cost.CostWeights(rocof=20.0, duty=0.3, rotor=20.0, cap=15.0, effort=0.0125),
    duty_time_s=15.0,
    on_failure="trip",
    failure_costs_whole_episode=True,
    # About the cost of an episode under the reference at 100: smaller costs count almost as in a mean.
    cost_offsets={"ample": 40.0, "tight": 200.0, "short": 1000.0, "": 300.0},
    anchors=("coordinated-piecewise", "coordinated-tuned"),
    # Mean loss of the published law against the reference at 100 over the strata of standard-v1 (law_means.json).
    scale=0.5824,
    variates=("coordinated-piecewise", "coordinated-free"),
)
