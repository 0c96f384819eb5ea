"""Planning without foresight: at every moment the best course of actions for the future that is to be expected.

A planner copies the running episode into a population of lanes, lets the wind go on as its observer expects and no
further event strike, and searches a course of actions on top of a feedback by the cross-entropy method (R. Rubinstein,
1999). It plays the first actions, and plans again. Planners differ in what they know of the wind:

* `exact`: the wind of the moment; turbulence is expected to die away towards the mean of the last seconds.
* `measured`: what the sensors said, late and wrong; an observer corrects their error by the rotor's own balance.

Both know the state of grid and rotors exactly, and outages that have struck. They minimise the episode's cost as it is
charged, not the score: a few hard scenarios count for more. `conditions.py` plays them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from rollouts import between, positions, time_left

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, Results
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.metrics import Recorder, measure
from wtg_gym.physics.aerodynamics import power_coefficient
from wtg_gym.physics.kernel_data import EVENT, NO_EVENT, LaneData
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.simulator import PreparedLanes
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks.observation import N_LOCAL, N_MEASURED

#: Winds that an observer believes in [m/s].
_WIND_RANGE = (3.5, 24.5)
#: Time constants of the observer's filters: rotor speed and power, the wind sensor, its correction [s].
_ROTOR_FILTER_S, _SENSOR_FILTER_S, _CORRECTION_S = 2.0, 2.0, 10.0
#: Candidates that the next generation is drawn around.
_N_ELITE = 6


@dataclass(frozen=True, kw_only=True)
class Planning:
    """Effort of a planner."""

    knowledge: str = "exact"  # of the wind, "exact" or "measured"
    horizon_s: float = 30.0  # how far ahead a plan looks [s]
    interval_s: float = 2.0  # how often it plans again [s], at most the horizon
    population: int = 24  # candidates of a search
    generations: int = 4  # of a search
    n_knots: int = 4  # of a course of actions, linear in between
    gain: float = 0.5  # of the feedback that the course is added to: action on k per 0.5 Hz
    spread: float = 0.25  # standard deviation of the first candidates
    wind_memory_s: float = 20.0  # time constant of the mean that the wind returns to [s]
    wind_decay_s: float = 10.0  # time constant with which it returns [s]
    seed: int = 0  # of the search


class WindObserver:
    """Estimates the wind of every lane and group, and its mean.

    Where the wind is only measured, the sensor says how it changes, and the rotor how large it is: the power balance
    p_w = p + 2H_m ω_m ω̇_m of measured power and speed gives the wind that the rotor must have seen, slowly but without
    bias. While the blades may be turned, that is not known.
    """

    def __init__(self, lanes: TaskLanes, planning: Planning) -> None:
        self._lanes, self._planning = lanes, planning
        self._dt = lanes.settings.control_dt
        sensors = lanes.settings.sensor_distribution()
        self._has_sensor = sensors is None or sensors.wind_sensor
        turbine = lanes.simulator.settings.turbine
        self._two_h = 2.0 * turbine.inertia_constant_s
        #: Wind per rotor speed, and the captured power per cubed rotor speed that belongs to it.
        self._ratio = turbine.tip_speed_ratio_per_speed_m_s / np.linspace(20.0, 3.5, 400)
        coefficient = power_coefficient(
            turbine.tip_speed_ratio_per_speed_m_s / self._ratio, 0.0, turbine.power_coefficient
        )
        self._power = np.maximum.accumulate(
            turbine.wind_power_pu_per_cubic_wind * self._ratio**3 * np.asarray(coefficient)
        )
        speed, power, wind = self._measured()
        self._speed, self._power_now = speed, power
        self._correction = np.zeros_like(wind)
        self.now = self.mean = self._seen()

    def _measured(self) -> tuple[Floats, Floats, Floats]:
        """Rotor speed [p.u.], power [p.u.] and wind [m/s] as the sensors say, (n_lanes, n_wtg) each."""
        n_wtg = self._lanes.n_wtg
        own = self._lanes.observations[:, : n_wtg * (self._lanes.n_local + 2)].reshape(-1, n_wtg, N_MEASURED + 2)
        values = own.astype(np.float64)
        return 1.0 + 0.25 * values[..., 3], values[..., 4], 10.0 + 5.0 * values[..., 5]

    def _low_pass(self, old: Floats, new: Floats, time_s: float) -> Floats:
        share = np.exp(-self._dt / time_s)
        return share * old + (1.0 - share) * new

    def _seen(self) -> Floats:
        if self._planning.knowledge == "exact":
            return self._lanes.simulator.wtg_values("wind")
        speed, power, wind = self._measured()
        rate = (speed - self._speed) / _ROTOR_FILTER_S
        self._speed = self._low_pass(self._speed, speed, _ROTOR_FILTER_S)
        self._power_now = self._low_pass(self._power_now, power, _ROTOR_FILTER_S)
        captured = self._power_now + self._two_h * self._speed * rate
        of_rotor = self._speed * np.interp(captured / self._speed**3, self._power, self._ratio)
        if not self._has_sensor:
            return np.clip(of_rotor, *_WIND_RANGE)
        wind = np.clip(wind, *_WIND_RANGE)
        known = (captured < 0.9) & (self._speed < 1.05)
        error = np.where(known, np.log(np.maximum(of_rotor, 1.0) / wind), self._correction)
        self._correction = self._low_pass(self._correction, error, _CORRECTION_S)
        return np.clip(wind * np.exp(self._correction), *_WIND_RANGE)

    def update(self) -> None:
        """Take in the newest measurement."""
        seen = self._seen()
        self.now = seen if self._planning.knowledge == "exact" else self._low_pass(self.now, seen, _SENSOR_FILTER_S)
        self.mean = self._low_pass(self.mean, seen, self._planning.wind_memory_s)

    def expected(self, n_steps: int) -> Floats:
        """Return the wind from now on, (n_lanes, n_wtg, n_steps + 1) [m/s]."""
        decay = np.exp(-self._dt / self._planning.wind_decay_s * np.arange(n_steps + 1))
        ahead = self.mean[..., None] + (self.now - self.mean)[..., None] * decay
        return np.clip(ahead, *_WIND_RANGE)


def plan(lanes: TaskLanes, planning: Planning) -> Iterator[npt.NDArray[np.bool_]]:
    """Play the started episodes of all lanes to their ends; after every step, yield which lanes made it, (n_lanes,).

    The lanes must have both actions and the privileged observation.
    """
    imagined = TaskLanes(lanes.settings, lanes.n_lanes * planning.population)
    with closing(imagined.simulator):
        planner = _Planner(lanes, imagined, planning)
        running = np.ones(lanes.n_lanes, dtype=np.bool_)
        n_steps = round(lanes.duration_s / lanes.settings.control_dt)
        for step in range(n_steps):
            if not running.any():
                return
            lanes.step(planner.act(step, n_steps))
            yield running
            terminated, truncated = lanes.ended()
            running = ~(terminated | truncated)


def imagine(imagined: TaskLanes, lanes: TaskLanes, source: npt.NDArray[np.int64], wind: Floats) -> None:
    """Continue running episodes in other lanes, without future events; ramps go on, and so does the load noise.

    Args:
        imagined: the lanes that continue, several, with the settings of `lanes`.
        lanes: the running episodes.
        source: the lane of `lanes` that each of the others continues, (n_imagined,).
        wind: from now on, one value per control interval, the last one holds, (n_imagined, n_wtg, n_ahead + 1) [m/s].
    """
    own = lanes.simulator
    rows = own.blocks.reshape(len(own.blocks), -1, own.width)[source // own.width, :, source % own.width]
    step = rows[:, own.layout.lane("step")]
    # The network is reduced anew at once: what was due may have been forgotten.
    rows[:, own.layout.lane("next_change")] = step
    data = LaneData._make(array[source] for array in own.data)
    data.events[data.events[..., EVENT.start] >= step[:, np.newaxis]] = NO_EVENT
    for lane, first in enumerate((step / own.plant.n_substeps).astype(np.int64).tolist()):
        ahead = min(wind.shape[2], own.n_intervals + 1 - first)
        data.wind[lane, :, first : first + ahead] = wind[lane, :, :ahead]
        data.wind[lane, :, first + ahead :] = wind[lane, :, ahead - 1 : ahead]
        data.noise[lane, first:] = data.noise[lane, max(first - 1, 0)]
    imagined.simulator.start(range(imagined.n_lanes), PreparedLanes(rows, data))
    for theirs, ours in zip(imagined.outputs, lanes.outputs, strict=True):
        theirs[:] = ours[source]


class _Planner:
    """Plans for every lane; `imagined` has `planning.population` times as many lanes for its rollouts."""

    def __init__(self, lanes: TaskLanes, imagined: TaskLanes, planning: Planning) -> None:
        self._lanes, self._imagined, self._planning = lanes, imagined, planning
        dt = lanes.settings.control_dt
        self._interval = round(planning.interval_s / dt)
        self._positions = positions(planning.n_knots, round(planning.horizon_s / dt))
        self._observer = WindObserver(lanes, planning)
        self._rng = np.random.default_rng(planning.seed)
        self._plan = np.zeros((lanes.n_lanes, planning.n_knots, lanes.n_wtg, 2))

    def act(self, step: int, n_steps: int) -> Floats:
        """Return the actions of a step, (n_lanes, n_action); the episode has `n_steps`."""
        if step:
            self._observer.update()
        if step % self._interval == 0:
            if step:
                self._plan = _shifted(self._plan, self._positions, self._interval)
            self._search(min(len(self._positions), n_steps - step))
        course = between(self._plan, self._positions[step % self._interval])
        return _actions(self._lanes, course, self._planning.gain)

    def _search(self, n_ahead: int) -> None:
        """Search the best course by the cross-entropy method, starting from the present plan."""
        p, lanes, imagined = self._planning, self._lanes, self._imagined
        n, rows = lanes.n_lanes, np.arange(lanes.n_lanes)
        source = np.repeat(rows, p.population)
        wind = np.repeat(self._observer.expected(n_ahead), p.population, axis=0)
        paid = lanes.cost_sums().sum(axis=1)[:, np.newaxis]
        mean, deviation = self._plan, np.full_like(self._plan, p.spread)
        best, best_cost = self._plan.copy(), np.full(n, np.inf)
        for _ in range(p.generations):
            noise = self._rng.standard_normal((n, p.population, *mean.shape[1:]))
            asked = np.clip(mean[:, np.newaxis] + deviation[:, np.newaxis] * noise, -2.0, 2.0)
            # The best course so far is kept, and the feedback alone is always tried.
            asked[:, 0], asked[:, 1], asked[:, 2] = best, mean, 0.0
            imagine(imagined, lanes, source, wind)
            flat = asked.reshape(n * p.population, *mean.shape[1:])
            for position in self._positions[:n_ahead]:
                imagined.step(_actions(imagined, between(flat, position), p.gain))
            charged = imagined.cost_sums().sum(axis=1) + time_left(imagined)
            costs = charged.reshape(n, p.population) - paid
            elite = np.take_along_axis(asked, costs.argsort(axis=1)[:, :_N_ELITE, None, None, None], axis=1)
            mean = 0.3 * mean + 0.7 * elite.mean(axis=1)
            deviation = np.maximum(0.03, 0.4 * deviation + 0.6 * elite.std(axis=1))
            least = costs.argmin(axis=1)
            better = costs[rows, least] < best_cost
            best[better] = asked[rows[better], least[better]]
            best_cost = np.minimum(best_cost, costs[rows, least])
        self._plan = best


def _shifted(plan: Floats, steps: Sequence[float], interval: int) -> Floats:
    """The same course, an interval later; `steps` are the positions of its steps."""
    last = len(steps) - 1
    later = np.minimum(np.linspace(0, last, plan.shape[1]).astype(np.int64) + interval, last)
    return np.stack([between(plan, steps[step]) for step in later], axis=1)


def _actions(lanes: TaskLanes, course: Floats, gain: float) -> Floats:
    """Actions of a course (n_lanes, n_wtg, 2) on top of the feedback of the exact frequency."""
    first, n = lanes.n_wtg * (lanes.n_local + 2), N_LOCAL + 1
    exact = lanes.observations[:, first : first + lanes.n_wtg * n].reshape(lanes.n_lanes, lanes.n_wtg, n)
    actions = course.copy()
    actions[..., 0] -= gain * exact[..., 0].astype(np.float64)
    return np.ascontiguousarray(np.clip(actions, -1.0, 1.0).reshape(lanes.n_lanes, -1))


def played_by_planner(suite: str, split: str, seeds: Sequence[int], planning: Planning) -> list[Episode]:
    """Play scenarios of version v1 with a planner each, and measure the episodes."""
    modes = {"action_mode": "k+tau", "observation_mode": "privileged"}
    settings = EnvSettings(suite=suite, split=split, strategy=get_suite(suite).task.hundred, **modes)
    lanes = TaskLanes(settings, len(seeds))
    with closing(lanes.simulator), Progress("steps") as progress:
        scenarios = lanes.scenarios(seeds)
        lanes.start(range(len(seeds)), scenarios)
        recorder, n_steps = Recorder(lanes), round(lanes.duration_s / settings.control_dt)
        for step, stepped in enumerate(plan(lanes, planning), start=1):
            recorder.record(stepped)
            progress.update(f"planner-{planning.knowledge}", step, n_steps)
        return [
            Episode(
                entry=f"planner-{planning.knowledge}",
                training_seed=None,
                seed=int(lanes.scenario_seeds[lane]),
                scenario=scenario.name,
                duration_s=min(scenario.duration_s, lanes.duration_s),
                **measure(lanes, recorder, lane),
            )
            for lane, scenario in enumerate(scenarios)
        ]


class _NoPolicy:
    """Stands for a planner in its entry's data: it needs more than an observation."""

    def predict(self, *_, **__):
        raise TypeError("a planner is played by docs/studies/planner.py")


def with_planners(results: Results, plannings: Sequence[Planning]) -> Results:
    """Return results with planners beside their entries."""
    for planning in plannings:
        entry = Entry(
            name=f"planner-{planning.knowledge}",
            policy=_NoPolicy(),
            observation_mode="privileged",
            learned=False,
            description=f"Plans every {planning.interval_s:g} s over {planning.horizon_s:g} s without foresight; "
            f"knows the state exactly, the wind: {planning.knowledge}.",
        )
        episodes = played_by_planner(results.suite, results.split, results.seeds, planning)
        results = replace(results, entries=(*results.entries, entry.to_dict()), episodes=(*results.episodes, *episodes))
    return results
