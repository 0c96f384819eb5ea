"""The lanes that policies are trained in: their reward, and the points of their episodes at which they start."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorWrapper

from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.score import COST_OFFSET
from wtg_gym.physics.scenario import Scenario

Floats = npt.NDArray[np.float64]


#: Episodes that a law plays at a time: as many as share a block of lanes.
_AT_ONCE = 16
#: Training scenarios of a stratum that its mean cost is estimated from.
_PER_STRATUM = 30


def law_costs(lanes: TaskLanes, scenarios: Sequence[Scenario]) -> Floats:
    """Return what the law of lanes pays in each step of scenarios, (n_scenarios, n_steps); nothing after a failure."""
    n_steps = round(lanes.duration_s / lanes.settings.control_dt)
    costs, zero = np.zeros((len(scenarios), n_steps)), np.zeros((lanes.n_lanes, lanes.n_action))
    for first in range(0, len(scenarios), lanes.n_lanes):
        own = costs[first : first + lanes.n_lanes]
        lanes.start(range(len(own)), scenarios[first : first + len(own)])
        running = np.ones(len(own), dtype=np.bool_)
        for step in range(n_steps):
            lanes.step(zero)
            own[running, step] = -lanes.rewards[: len(own)][running]
            running &= ~np.logical_or(*lanes.ended())[: len(own)]
            if not running.any():
                break
    return costs


def stratum_costs(settings: EnvSettings, law: str) -> dict[str, float]:
    """Return the mean cost of a law in each stratum of the settings' suite, over its first training scenarios.

    A suite without strata has one, "". Episodes are as long as the suite's.
    """
    lanes = TaskLanes(replace(settings, strategy=law, split="train", duration_s=None, scenario=None), _AT_ONCE)
    suite, means = lanes.suite, {}
    for name in suite.strata or ("",):
        seeds = list(itertools.islice((seed for seed in suite.train if suite.stratum(seed) == name), _PER_STRATUM))
        means[name] = float(law_costs(lanes, lanes.scenarios(seeds)).sum(axis=1).mean())
    lanes.simulator.close()
    return means


def stratum_scales(settings: EnvSettings) -> dict[str, float]:
    """Return by how much the mean costs of the two anchors of the score differ in each stratum.

    Raises:
        ValueError: the zero is not worse than the hundred in a stratum, so that there is no scale.
    """
    benchmark = settings.benchmark()
    zero, hundred = (stratum_costs(settings, law) for law in benchmark.anchors)
    scales = {name: zero[name] - hundred[name] for name in zero}
    for name, scale in scales.items():
        if not scale > 0.0:
            raise ValueError(
                f"{benchmark.zero} (mean cost {zero[name]:.4g}) must cost more than {benchmark.hundred} "
                f"({hundred[name]:.4g}) in the training scenarios of {settings.suite} {name}"
            )
    return scales


class Gains:
    """Gains of lanes over the reference, in each step: 100 (c_ref - c) / S.

    The reference is the law that scores 100: in v0 the zero action, in v1 that law tuned to its grid. c is the step's
    cost, and c_ref the reference's in the same step of the same scenario. Loads and wind cause most of the cost, alike
    for both: the difference leaves what the actions changed (common random numbers).

    S is what the score divides by. Where it compares mean costs, S is :func:`stratum_scales` of the scenario's stratum:
    a sum over an episode is what the score of a stratum gains by it. Where it compares logarithms, S = J_ref + J0 with
    the reference's sum over the episode and the score's offset: to first order a sum is what the score gains at the
    reference.

    A failure that ends an episode forfeits what c_ref would still have brought, besides its own cost. So this is
    deliberately another objective than the cost.

    Args:
        lanes: the episodes. The reference plays the scenario of each once, when it begins.

    Raises:
        ValueError: as for :func:`stratum_scales`.
    """

    def __init__(self, lanes: TaskLanes) -> None:
        self._lanes = lanes
        settings = lanes.settings
        benchmark = settings.benchmark()
        at_once = min(lanes.n_lanes, _AT_ONCE)
        self._reference = TaskLanes(replace(settings, strategy=benchmark.hundred), at_once)
        self.n_steps = round(settings.episode_duration_s() / settings.control_dt)
        self._costs = np.zeros((lanes.n_lanes, self.n_steps))
        #: The cost that counts one per cent.
        self._units = np.ones(lanes.n_lanes)
        #: The same by stratum, where it is the same for all its scenarios.
        self._of_stratum: dict[str, float] | None = None
        if benchmark.scores_mean:
            self._of_stratum = {name: scale / 100.0 for name, scale in stratum_scales(settings).items()}

    def follow(self, lanes: Iterable[int]) -> None:
        """Let the reference play the scenarios that lanes play now."""
        places = list(lanes)
        if not places:
            return
        seeds = self._lanes.scenario_seeds[places].tolist()
        self._costs[places] = law_costs(self._reference, self._lanes.scenarios(seeds))
        if self._of_stratum is None:
            self._units[places] = (self._costs[places].sum(axis=1) + COST_OFFSET) / 100.0
        else:
            self._units[places] = [self._of_stratum[self._lanes.suite.stratum(seed)] for seed in seeds]

    def reference_costs(self) -> Floats:
        """Return the reference's costs in the step that each lane takes next, (n_lanes,)."""
        simulator = self._lanes.simulator
        steps = np.rint(simulator.lane_values("step") / simulator.plant.n_substeps).astype(np.int64)
        # An episode that is over takes no more.
        costs: Floats = self._costs[np.arange(self._lanes.n_lanes), np.minimum(steps, self.n_steps - 1)]
        return costs

    def of(self, reference_costs: Floats, rewards: Floats) -> Floats:
        """Return the gains of a step [%], (n_lanes,), from :meth:`reference_costs` before it and its rewards."""
        gains: Floats = (reference_costs + rewards) / self._units
        return gains

    def close(self) -> None:
        """Release the worker threads."""
        self._reference.simulator.close()


def stagger(env: GFMWTGVectorEnv) -> npt.NDArray[np.float32]:
    """Spread lanes that have just been reset evenly over an episode, under the zero action.

    Lanes that start together stay together as long as episodes are equally long: a rollout would show the same few
    seconds of all of them, and the learner would swing from one part of an episode to the next.

    Returns:
        the observations (num_envs, n_observation) to go on from.
    """
    n_steps = round(env.settings.episode_duration_s() / env.settings.control_dt)
    starts = np.arange(env.num_envs) * n_steps // env.num_envs
    actions = np.zeros(env.action_space.shape or (), dtype=np.float32)
    for step in range(n_steps):
        mask = starts == step
        if mask.any():
            env.reset(options={"reset_mask": mask})
        observations, _, terminated, truncated, _ = env.step(actions)
    over = terminated | truncated
    if env.autoreset_mode == AutoresetMode.NEXT_STEP and over.any():
        # What a reset returns may not be over already.
        observations, _ = env.reset(options={"reset_mask": over})
    return observations


class GainEnvs(VectorWrapper):
    """The native vector environment with :class:`Gains` as rewards, and lanes that every reset spreads.

    Spreading starts the lanes anew, so that reset options are lost, and the first info is empty.
    """

    env: GFMWTGVectorEnv

    def __init__(self, env: GFMWTGVectorEnv) -> None:
        super().__init__(env)
        self.gains = Gains(env.lanes)
        self._within_step = env.autoreset_mode == AutoresetMode.SAME_STEP
        self._ended = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start and spread the lanes; returns the observations (num_envs, n_observation)."""
        self.env.reset(seed=seed)
        observations = stagger(self.env)
        self._ended[:] = False
        self.gains.follow(range(self.num_envs))
        return observations, {}

    def step(self, actions: npt.NDArray[Any]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step as the native one does, with other rewards."""
        beginning, references = self._ended, self.gains.reference_costs()
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        if self._within_step:
            # Stable-Baselines3 has them in single precision.
            rewards = rewards.astype(np.float32).astype(np.float64)
        # A lane that only begins its next episode gains nothing.
        gains = np.where(beginning, 0.0, self.gains.of(references, rewards))
        over = terminated | truncated
        self.gains.follow(np.flatnonzero(over if self._within_step else beginning).tolist())
        self._ended = over & (not self._within_step)
        return observations, gains, terminated, truncated, infos

    def close(self, **kwargs: Any) -> None:
        """Release the worker threads."""
        self.gains.close()
        super().close(**kwargs)
