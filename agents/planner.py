"""A planner that knows the exact state and nothing of the future; `python -m agents.planner` plays and scores it.

Every few seconds it plans the actions of the next minute by the gradients of wtg_gym.gradients, as if wind and load
noise stayed, a load ramp ended now, and no further event came; of a fault or trip that has begun it knows when it is
cleared or recloses. It sees how failures come, by the stand-ins of :class:`agents.gradient.Failures`, and does not know
that the episode ends. What it scores can be had with the exact state; :mod:`agents.dagger` learns from it.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from cyclopts import Parameter
from torch import Tensor

from agents import run as runs
from agents.gradient import Failures
from agents.run import Whole
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.gradients.torch import TorchEpisodes
from wtg_gym.physics.scenario import SERIES_DT, Event, LoadRamp, Scenario
from wtg_gym.progress import Progress
from wtg_gym.ranges import Checked, design, whole_steps
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite

Floats = npt.NDArray[np.float64]
#: Of the optimiser of a plan, and the share by which its steps shrink until the last.
_BETAS, _SHRINKS = (0.7, 0.9), 0.7


@Parameter(name="*")
@dataclass(frozen=True)
class PlannerOptions(Checked):
    """How it plans."""

    horizon_s: float = design(60.0, "s", "", 1.0, 600.0)
    """how far it looks ahead"""
    interval_s: float = design(10.0, "s", "", 0.1, 60.0)
    """time between two plans"""
    knot_s: float = design(5.0, "s", "", 0.1, 60.0)
    """time between two actions of a plan; in between they are interpolated"""
    iterations: Whole = design(5, "-", "", 1, 1000)
    """gradients of a plan, which begins as the plan before"""
    step: float = design(0.1, "-", "", 1e-6, 10.0)
    """first step of the optimiser, in the argument of tanh"""

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


class Planner:
    """Plans for episodes side by side.

    Args:
        settings: of the environment.
        n_lanes: number of episodes.
        options: how it plans.
        n_threads: threads to step with; None for one per processor.
    """

    def __init__(
        self,
        settings: EnvSettings,
        n_lanes: int,
        options: PlannerOptions = PlannerOptions(),
        n_threads: int | None = None,
    ) -> None:
        self.options = options
        length_s = settings.episode_duration_s()
        self._episodes = TorchEpisodes(
            replace(settings, duration_s=length_s + options.horizon_s, reward="cost"), n_lanes, n_threads
        )
        lanes, step_s = self._episodes.tape.lanes, settings.step_s
        self._step_s, self._failures = step_s, Failures(self._episodes)
        #: Control steps of an episode, and between two plans.
        self.n_steps = whole_steps("duration_s", length_s, step_s, "control step")
        self.n_between = whole_steps("interval_s", options.interval_s, step_s, "control step")
        n_knots = round((length_s + options.horizon_s) / options.knot_s) + 2
        self._knots_shape = (n_knots, n_lanes, lanes.n_action)

    def start(self, scenarios: Sequence[Scenario]) -> None:
        """Begin episodes of one scenario each."""
        self._scenarios, self._taken = list(scenarios), list[Tensor]()
        self._knots = torch.zeros(self._knots_shape, dtype=torch.float64)

    def take(self, actions: Floats) -> None:
        """Tell the planner the actions of a step that was made (n_lanes, n_action)."""
        self._taken.append(torch.tensor(actions, dtype=torch.float64))

    def plan(self) -> Floats:
        """Return actions from now until the next plan (n_between, n_lanes, n_action).

        Of all iterations a scenario gets the actions with its lowest predicted cost.
        """
        o, first = self.options, len(self._taken)
        scenarios = [without_foresight(each, first * self._step_s, o.horizon_s) for each in self._scenarios]
        knots = self._knots.clone().requires_grad_(True)
        optimizer = torch.optim.Adam([knots], lr=o.step, betas=_BETAS)
        lowest, best = torch.full((len(scenarios),), torch.inf, dtype=torch.float64), self._knots.clone()
        for iteration in range(o.iterations + 1):
            terms, least = self._predicted(scenarios, knots)
            costs = terms.detach().sum(dim=1)
            best = torch.where((costs < lowest)[:, None], knots.detach(), best)
            lowest = torch.minimum(costs, lowest)
            if iteration == o.iterations:
                break
            optimizer.param_groups[0]["lr"] = o.step * (1.0 - _SHRINKS * iteration / o.iterations)
            optimizer.zero_grad()
            self._failures.costs(terms, least).sum().backward()  # type: ignore[no-untyped-call]
            knots.grad = self._direction(knots.grad, first)
            optimizer.step()
        self._knots = best
        return np.array([self._action(best, step).numpy() for step in range(first, first + self.n_between)])

    def _predicted(self, scenarios: Sequence[Scenario], knots: Tensor) -> tuple[Tensor, Tensor]:
        """Return what episodes cost (n_lanes, n_terms), and the least of what failures depend on."""
        self._episodes.start(scenarios)
        with torch.no_grad():
            spent = [self._episodes.step(actions)[1] for actions in self._taken]
        self._episodes.detach()
        watched, first = [], len(self._taken)
        for step in range(first, first + round(self.options.horizon_s / self._step_s)):
            spent.append(self._episodes.step(self._action(knots, step))[1])
            watched.append(self._failures.watched(self._episodes.outputs))
        return torch.stack(spent).sum(dim=0), torch.stack(watched).amin(dim=0)

    def _action(self, knots: Tensor, step: int) -> Tensor:
        index, share = divmod(step * self._step_s / self.options.knot_s, 1.0)
        return torch.tanh((1.0 - share) * knots[int(index)] + share * knots[int(index) + 1])

    def _direction(self, gradient: Any, first: int) -> Tensor:
        """Return the gradients of all episodes at the same length; what is past stays as it is."""
        gradient = torch.nan_to_num(gradient)
        gradient[: int(first * self._step_s / self.options.knot_s)] = 0.0
        direction: Tensor = gradient / (gradient.square().sum(dim=(0, 2), keepdim=True).sqrt() + 1e-12)
        return direction


def drive(
    planner: Planner,
    lanes: TaskLanes,
    scenarios: Sequence[Scenario],
    driver: Callable[[Floats], Floats] = lambda plan: plan,
    on_progress: Callable[[int, int], None] = lambda done, n: None,
) -> Floats:
    """Play episodes and return the actions that were taken (n_steps, n_lanes, n_action).

    Args:
        planner: plans from where the episodes are.
        lanes: of as many episodes, with the planner's settings.
        scenarios: one per episode.
        driver: returns the actions to take, (n_lanes, n_action) like the plan that it gets.
        on_progress: called with the steps done, and all.
    """
    planner.start(scenarios)
    lanes.start(range(lanes.n_lanes), scenarios)
    taken: list[Floats] = []
    while len(taken) < planner.n_steps:
        for plan in planner.plan()[: planner.n_steps - len(taken)]:
            actions = np.ascontiguousarray(np.clip(driver(plan), -1.0, 1.0))
            lanes.step(actions)
            planner.take(actions)
            taken.append(actions)
        on_progress(len(taken), planner.n_steps)
    return np.array(taken)


class Course:
    """A policy whose actions are fixed in advance (n_steps, n_lanes, n_action), for one batch of the same episodes."""

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
    lanes = TaskLanes(settings, len(seeds))
    actions = drive(Planner(settings, len(seeds), options), lanes, lanes.scenarios(seeds), on_progress=on_progress)
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

    A scenario takes three seconds of one core.

    Args:
        episodes: so many scenarios, side by side
        suite: of version v1
        strategy: law that the actions modulate
    """
    seeds = list(get_suite(suite).seeds("validation")[:episodes])
    with Progress("steps") as progress:
        entry = planned(suite, strategy, seeds, options, functools.partial(progress.update, "planner"))
    print(evaluate([entry, strategy], suite, "validation", seeds=seeds, batch=len(seeds)))


#: Runs the command with some words, by default those of the command line, and returns its exit code.
main = functools.partial(runs.run_command, command, "agents.planner", "nothing was written")

if __name__ == "__main__":
    sys.exit(main())
