"""Training on gains: a reward that is the gain over the law that scores 100, for any library with vector environments.

On the environment's own reward a few extreme scenarios outweigh all ordinary minutes, which the score counts alike; and
loads and wind cause most of the cost, whatever the policy does. Scores are computed without all of this.
"""

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
from wtg_gym.evaluation.score import score_scales
from wtg_gym.physics.scenario import Scenario
from wtg_gym.signals import undivided

Floats = npt.NDArray[np.float64]


#: Episodes that a law plays at a time: as many as share a block of lanes.
_AT_ONCE = 16
#: Training scenarios of a stratum that its scale is estimated from.
_PER_STRATUM = 60
#: See :class:`Gains`.
_MOST = 5.0


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


def stratum_scales(settings: EnvSettings) -> dict[str, float]:
    """Return the score's Λ of each stratum of the settings' suite, by its name, over its first training scenarios.

    A suite without strata has one, "". Episodes are as long as the suite's.
    """
    task, suite, costs = settings.task, settings.resolved_suite, []
    names = suite.strata or ("",)
    if task.scale is not None:
        return dict.fromkeys(names, task.scale)
    seeds = [
        list(itertools.islice((seed for seed in suite.train if suite.stratum(seed) == name), _PER_STRATUM))
        for name in names
    ]
    for law in task.anchors:
        lanes = TaskLanes(replace(settings, strategy=law, split="train", duration_s=None, scenario=None), _AT_ONCE)
        costs.append(law_costs(lanes, lanes.scenarios(list(itertools.chain(*seeds)))).sum(axis=1))
        lanes.simulator.close()
    groups = {name: i * _PER_STRATUM + np.arange(_PER_STRATUM) for i, name in enumerate(names)}
    zero, hundred = costs
    return dict(zip(names, score_scales(zero, hundred, task, groups), strict=True))


class ScoreUnits:
    """J0 of the score, and Λ by :func:`stratum_scales`, in the strata of scenarios; Λ is 1 where there are none.

    Raises:
        NoScaleError: the zero is not worse than the hundred in a stratum.
    """

    def __init__(self, settings: EnvSettings) -> None:
        self._suite = settings.resolved_suite
        self._offsets = dict(self._suite.task.cost_offsets)
        self._scales = stratum_scales(settings) if self._suite.strata else {"": 1.0}

    def of(self, seeds: Iterable[int]) -> tuple[Floats, Floats]:
        """Return J0 and Λ of the scenarios with these seeds, (n_scenarios,) each."""
        strata = [self._suite.stratum(seed) for seed in seeds]
        return np.array([self._offsets[name] for name in strata]), np.array([self._scales[name] for name in strata])


class Gains:
    """Gains of lanes over the reference, in each step: 100 (c_ref - c) / ((J_ref + J0) Λ).

    The reference is the law that scores 100: in v0 the zero action, in v1 that law tuned to its grid. c is the step's
    cost, c_ref the reference's in the same step of the same scenario, J_ref its sum over the episode, J0 and Λ its
    :class:`ScoreUnits`.

    - Loads and wind cause most of the cost, alike for both: the difference leaves what the actions changed (common
      random numbers).
    - To first order the sum over an episode is what the score of its stratum gains at the reference.

    A failure that ends an episode forfeits what c_ref would still have brought, besides its own cost; where there are
    strata, a step costs no more than :data:`_MOST` times J_ref + J0, about what the score's logarithm makes of a
    failure. So this is deliberately another objective than the cost.

    Args:
        lanes: the episodes. The reference plays the scenario of each once, when it begins.

    Raises:
        NoScaleError: the zero is not worse than the hundred in a stratum.
    """

    def __init__(self, lanes: TaskLanes) -> None:
        self._lanes = lanes
        settings = lanes.settings
        task = settings.task
        at_once = min(lanes.n_lanes, _AT_ONCE)
        self._reference = TaskLanes(replace(settings, strategy=task.hundred), at_once)
        self.n_steps = round(settings.episode_duration_s() / settings.control_dt)
        self._costs = np.zeros((lanes.n_lanes, self.n_steps))
        #: J_ref + J0, and Λ.
        self._sizes, self._scales = np.ones(lanes.n_lanes), np.ones(lanes.n_lanes)
        self._units, self._most = ScoreUnits(settings), _MOST if lanes.suite.strata else np.inf

    def follow(self, lanes: Iterable[int]) -> None:
        """Let the reference play the scenarios that lanes play now."""
        places = list(lanes)
        if not places:
            return
        seeds = self._lanes.scenario_seeds[places].tolist()
        self._costs[places] = law_costs(self._reference, self._lanes.scenarios(seeds))
        offsets, self._scales[places] = self._units.of(seeds)
        self._sizes[places] = self._costs[places].sum(axis=1) + offsets

    def reference_costs(self) -> Floats:
        """Return the reference's costs in the step that each lane takes next, (n_lanes,)."""
        # An episode that is over takes no more.
        costs: Floats = self._costs[np.arange(self._lanes.n_lanes), np.minimum(self._lanes.n_steps(), self.n_steps - 1)]
        return costs

    def of(self, reference_costs: Floats, rewards: Floats) -> Floats:
        """Return the gains of a step [%], (n_lanes,), from :meth:`reference_costs` before it and its rewards."""
        gains: Floats = 100.0 * np.maximum((reference_costs + rewards) / self._sizes, -self._most) / self._scales
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

    `GainEnvs(gym.make_vec("wtg_gym:GFMWTG-14bus-v1", num_envs=64, strategy="coordinated-tuned"))`. The first info of
    spread lanes is empty.

    Args:
        env: the native batch, as `gym.make_vec` or :class:`wtg_gym.envs.GFMWTGVectorEnv` makes it; other wrappers go
            around this one.

    Raises:
        ValueError: the environment is another one, wrapped, does not start again by itself, or plays one scenario; or
            a reset has options.
    """

    env: GFMWTGVectorEnv

    def __init__(self, env: GFMWTGVectorEnv) -> None:
        if not isinstance(env, GFMWTGVectorEnv):
            raise ValueError(f"GainEnvs goes around the native batch alone, other wrappers around it; got {env}")
        if env.autoreset_mode == AutoresetMode.DISABLED:
            raise ValueError("GainEnvs needs lanes that start again by themselves, got autoreset_mode DISABLED")
        if env.settings.scenario is not None:
            raise ValueError("GainEnvs plays the scenarios of a suite: leave out the scenario")
        super().__init__(env)
        self.gains = Gains(env.lanes)
        self._within_step = env.autoreset_mode == AutoresetMode.SAME_STEP
        self._ended = np.zeros(env.num_envs, dtype=np.bool_)

    @undivided
    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start and spread the lanes; returns the observations (num_envs, n_observation)."""
        if options:
            raise ValueError(f"GainEnvs has no reset options, got {options!r:.80}")
        self.env.reset(seed=seed)
        observations = stagger(self.env)
        self._ended[:] = False
        self.gains.follow(range(self.num_envs))
        return observations, {}

    @undivided
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
