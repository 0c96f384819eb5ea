"""A planner that knows the exact state and nothing of the future; `python -m agents.planner` plays and scores it.

Every few seconds it plans the actions of the next minute by the gradients of wtg_gym.gradients. It knows what scenarios
the suite draws, but not how this one goes on. So a plan weighs several futures: each has the events and the relative
change of the wind that some training scenario has from now on. Until the next plan all have the same actions. Load
noise stays, and a load ramp ends now; of a fault or trip that has begun the planner knows when it is cleared or
recloses. It sees how failures come, by the stand-ins of :class:`agents.gradient.Failures`, and does not know that the
episode ends. What it scores can be had with the exact state; :mod:`agents.dagger` learns from it.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from agents import run as runs
from agents.gradient import Failures
from agents.run import Whole
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.gradients.torch import TorchEpisodes
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import SERIES_DT, Event, LoadRamp, Scenario
from wtg_gym.progress import Progress
from wtg_gym.ranges import Checked, design, whole_steps
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite
from wtg_gym.tasks.cost import COST_TERMS

#: Of the optimiser of a plan, and the share by which its steps shrink until the last.
_BETAS, _SHRINKS = (0.7, 0.9), 0.7
#: Training scenarios that futures are made of, and how often one is drawn at most until it fits.
_N_OTHERS, _MOST_DRAWS = 300, 20


@runs.options
@dataclass(frozen=True)
class PlannerOptions(Checked):
    """How it plans."""

    horizon_s: float = design(60.0, "s", "how far it looks ahead", 1.0, 600.0)
    interval_s: float = design(10.0, "s", "time between two plans", 0.1, 60.0)
    knot_s: float = design(5.0, "s", "time between two actions of a plan; in between they are interpolated", 0.1, 60.0)
    iterations: Whole = design(5, "-", "gradients of a plan, which begins as the plan before", 1, 1000)
    step: float = design(0.1, "-", "first step of the optimiser, in the argument of tanh", 1e-6, 10.0)
    futures: Whole = design(3, "-", "that a plan weighs; 0: one, in which the wind stays and no event comes", 0, 100)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.horizon_s < self.interval_s:
            raise ValueError(f"horizon_s = {self.horizon_s:g} s must reach to the next plan, in {self.interval_s:g} s")


def begun(events: Iterable[Event], time_s: float) -> Iterator[Event]:
    """Yield the events before a time, load ramps as far as they have come."""
    for event in events:
        passed_s = time_s - event.time_s
        if isinstance(event, LoadRamp) and 0.0 < passed_s < event.duration_s:
            share = passed_s / event.duration_s
            power, reactive = share * event.power_mw, share * event.reactive_mvar
            # A ramp cannot be shorter.
            yield replace(event, duration_s=max(passed_s, 0.1), power_mw=power, reactive_mvar=reactive)
        elif passed_s > 0.0:
            yield event


def without_foresight(scenario: Scenario, time_s: float, longer_s: float) -> Scenario:
    """Return a scenario that goes on longer, in which wind and load noise stay after a time and no event comes."""
    n_wind, n_noise = round(time_s / scenario.wind_dt_s) + 1, round(time_s / SERIES_DT) + 1
    wind, noise = scenario.wind_speed[:, :n_wind], scenario.load_noise_mw[:n_noise]
    n_longer = round((scenario.duration_s + longer_s) / SERIES_DT) + 1 - len(noise)
    return replace(
        scenario,
        duration_s=scenario.duration_s + longer_s,
        wind_speed=wind,
        load_noise_mw=np.append(noise, np.full(n_longer, noise[-1])) if len(noise) else noise,
        events=tuple(begun(scenario.events, time_s)),
    )


class Futures:
    """Draws how scenarios of an environment may go on: as other training scenarios do."""

    def __init__(self, batch: EnvBatch) -> None:
        self._batch, suite = batch, batch.suite
        self._others = batch.scenarios(suite.train[:_N_OTHERS]) if suite.distributions else []
        self._least_margin = min((low for low, _ in suite.margins.values()), default=-math.inf)

    def draw(self, scenario: Scenario, time_s: float, rng: np.random.Generator) -> Scenario:
        """Return a scenario with the events that another has from a time on, and with that one's relative wind.

        Its reserve margin is one that the suite draws. Without training scenarios it stays as it is.
        """
        past = scenario.wind_speed.shape[1]
        for _ in range(_MOST_DRAWS if self._others else 0):
            other = self._others[rng.integers(len(self._others))]
            relative = other.wind_speed[:, past:] / other.wind_speed[:, past - 1 : past]
            wind = np.concatenate([scenario.wind_speed, scenario.wind_speed[:, -1:] * relative], axis=1)
            events = scenario.events + tuple(event for event in other.events if event.time_s > time_s)
            try:
                future = replace(scenario, wind_speed=wind, events=events)
                margin = self._batch.suite.margin(future, self._batch.settings.resolved_plant)
                # NaN where a suite has no margins.
                if not margin < self._least_margin:
                    self._batch.prepare([future])
                    return future
            except ValueError:
                pass  # The wind is beyond its range, or what has happened would happen again: a line opens once.
        return scenario


class Planner:
    """Plans for episodes of an environment side by side."""

    def __init__(self, settings: EnvSettings, num_envs: int, options: PlannerOptions = PlannerOptions()) -> None:
        self.options = options
        length_s, self._step_s = settings.episode_duration_s(), settings.step_s
        #: Of futures that are played for one episode, next to one another.
        self._n_futures = options.futures or 1
        longer = replace(settings, duration_s=length_s + options.horizon_s, reward="cost")
        self._episodes = TorchEpisodes(longer, self._n_futures * num_envs)
        batch = self._episodes.tape.batch
        self._failures, self._futures = Failures(self._episodes), Futures(batch)
        self._suite, self._plant = batch.suite, settings.resolved_plant
        #: Control steps of an episode, and between two plans.
        self.n_steps = whole_steps("duration_s", length_s, self._step_s, "control step")
        self.n_between = whole_steps("interval_s", options.interval_s, self._step_s, "control step")
        n_knots = round((length_s + options.horizon_s) / options.knot_s) + 2
        self._knots_shape = (n_knots, num_envs, batch.n_action)

    def start(self, scenarios: Sequence[Scenario]) -> None:
        """Begin episodes of one scenario each."""
        self._scenarios, self._taken = list(scenarios), list[Tensor]()
        self._knots = torch.zeros(self._knots_shape, dtype=torch.float64)

    def take(self, actions: Floats) -> None:
        """Tell the planner the actions of a step that was made (num_envs, n_action)."""
        self._taken.append(torch.tensor(actions, dtype=torch.float64))

    def plan(self) -> Floats:
        """Return actions from now until the next plan (n_between, num_envs, n_action).

        Of all iterations a scenario gets the actions with the best predicted score, the mean over its futures.
        """
        o, first = self.options, len(self._taken)
        scenarios = [future for scenario in self._scenarios for future in self._foreseen(scenario)]
        offsets = torch.tensor([self._suite.cost_offset(each, self._plant) for each in scenarios], dtype=torch.float64)
        spent = self._play_past(scenarios)
        now = self._episodes.tape.batch.snapshot()
        best = self._knots.repeat_interleave(self._n_futures, dim=1)
        lowest = torch.full((len(self._scenarios), 1), torch.inf, dtype=torch.float64)
        knots = best.clone().requires_grad_(True)
        optimizer = torch.optim.Adam([knots], lr=o.step, betas=_BETAS)
        for iteration in range(o.iterations + 1):
            self._episodes.resume(now)
            terms, least = self._to_come(knots)
            terms = spent + terms
            losses = torch.log(terms.detach().sum(dim=1) + offsets)
            losses = losses.reshape(-1, self._n_futures).mean(dim=1, keepdim=True)
            better = (losses < lowest).repeat_interleave(self._n_futures, dim=0)
            best, lowest = torch.where(better, knots.detach(), best), torch.minimum(losses, lowest)
            if iteration == o.iterations:
                break
            optimizer.param_groups[0]["lr"] = o.step * (1.0 - _SHRINKS * iteration / o.iterations)
            optimizer.zero_grad()
            torch.log(self._failures.costs(terms, least) + offsets).sum().backward()  # type: ignore[no-untyped-call]
            knots.grad = self._direction(knots.grad, first)
            optimizer.step()
        self._knots = self._by_episode(best).mean(dim=2)
        return np.array([self._action(self._knots, step).numpy() for step in range(first, first + self.n_between)])

    def _foreseen(self, scenario: Scenario) -> list[Scenario]:
        time_s = len(self._taken) * self._step_s
        known = without_foresight(scenario, time_s, self.options.horizon_s)
        if not self.options.futures:
            return [known]
        rng = np.random.default_rng((scenario.seed or 0, len(self._taken)))
        return [self._futures.draw(known, time_s, rng) for _ in range(self._n_futures)]

    def _play_past(self, scenarios: Sequence[Scenario]) -> Tensor:
        """Play futures up to now, and return what each has cost (n, n_terms)."""
        self._episodes.start(scenarios)
        spent = torch.zeros((len(scenarios), len(COST_TERMS)), dtype=torch.float64)
        for actions in self._taken:
            spent += self._episodes.step(actions.repeat_interleave(self._n_futures, dim=0))[1]
        return spent

    def _to_come(self, knots: Tensor) -> tuple[Tensor, Tensor]:
        """Return what futures cost from now on (n, n_terms), and the least of what failures depend on."""
        terms, watched, first = [], [], len(self._taken)
        for step in range(first, first + round(self.options.horizon_s / self._step_s)):
            terms.append(self._episodes.step(self._action(knots, step))[1])
            watched.append(self._failures.watched(self._episodes.outputs))
        return torch.stack(terms).sum(dim=0), torch.stack(watched).amin(dim=0)

    def _by_episode(self, values: Tensor) -> Tensor:
        """Return values of all futures (n_knots, n, n_action) as (n_knots, num_envs, n_futures, n_action)."""
        return values.reshape(len(values), -1, self._n_futures, values.shape[2])

    def _action(self, knots: Tensor, step: int) -> Tensor:
        index, share = divmod(step * self._step_s / self.options.knot_s, 1.0)
        return torch.tanh((1.0 - share) * knots[int(index)] + share * knots[int(index) + 1])

    def _direction(self, gradient: Any, first: int) -> Tensor:
        """Return the gradients of all episodes at the same length; past actions stay."""
        gradient = self._by_episode(torch.nan_to_num(gradient))
        gradient[: int(first * self._step_s / self.options.knot_s)] = 0.0
        # Until the next plan all futures of an episode have the same actions.
        common = gradient[: math.ceil((first + self.n_between) * self._step_s / self.options.knot_s) + 1]
        common[:] = common.mean(dim=2, keepdim=True)
        direction: Tensor = gradient / (gradient.square().sum(dim=(0, 2, 3), keepdim=True).sqrt() + 1e-12)
        return direction.flatten(1, 2)


def drive(
    planner: Planner,
    batch: EnvBatch,
    scenarios: Sequence[Scenario],
    driver: Callable[[Floats], Floats] = lambda plan: plan,
    on_progress: Callable[[int, int], None] = lambda done, n: None,
) -> Floats:
    """Play a scenario in each environment, and return the actions that were taken (n_steps, num_envs, n_action).

    The driver returns those of a step, of the plan's shape; `on_progress` is called with steps done, and all.
    """
    planner.start(scenarios)
    batch.start(range(batch.num_envs), scenarios)
    taken: list[Floats] = []
    while len(taken) < planner.n_steps:
        for plan in planner.plan()[: planner.n_steps - len(taken)]:
            actions = np.ascontiguousarray(np.clip(driver(plan), -1.0, 1.0))
            batch.step(actions)
            planner.take(actions)
            taken.append(actions)
        on_progress(len(taken), planner.n_steps)
    return np.array(taken)


class Course:
    """A policy whose actions are fixed in advance (n_steps, num_envs, n_action), for one batch of the same episodes."""

    def __init__(self, actions: Floats) -> None:
        self._actions = actions

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Floats, Any]:
        """Return the actions of the next step, and its number."""
        return self._actions[state or 0], (state or 0) + 1


def planned(
    suite: str,
    strategy: str,
    seeds: Sequence[int],
    options: PlannerOptions = PlannerOptions(),
    on_progress: Callable[[int, int], None] = lambda done, n: None,
) -> Entry:
    """Return an entry that plays the planner's actions in validation scenarios of these seeds, in one batch."""
    settings = EnvSettings(suite=suite, split="validation", strategy=strategy, action_mode="k", reward="cost")
    batch = EnvBatch(settings, len(seeds))
    actions = drive(Planner(settings, len(seeds), options), batch, batch.scenarios(seeds), on_progress=on_progress)
    return Entry(
        name="planner",
        description="Plans by gradients from the exact state, without foresight.",
        policy=Course(actions),
        strategy=strategy,
        action_mode="k",
        observation_mode="privileged",
    )


def command(
    *,
    episodes: Whole = 60,
    suite: str = DEFAULT_SUITE,
    strategy: str = "coordinated-free",
    options: PlannerOptions = PlannerOptions(),
) -> None:
    """Plan for the first validation scenarios of a suite, and score that beside its laws.

    A scenario takes six seconds of one core.

    Args:
        episodes: so many scenarios, side by side
        suite: of version v1
        strategy: law that the actions modulate
    """
    seeds = list(get_suite(suite).seeds("validation")[:episodes])
    with Progress("steps") as progress:
        entry = planned(suite, strategy, seeds, options, functools.partial(progress.update, "planner"))
    print(evaluate([entry, strategy], suite, "validation", seeds=seeds, batch=len(seeds)))


main = functools.partial(runs.run_command, command, "agents.planner", "nothing was written")

if __name__ == "__main__":
    sys.exit(main())
