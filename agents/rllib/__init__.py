"""PPO of Ray RLlib, on one machine or on a Ray cluster: its hyperparameters. Only the learner needs Ray."""

from __future__ import annotations

from dataclasses import dataclass

from wtg_gym.ranges import require_range

#: The algorithm's name in run.json.
NAME = "rllib_ppo"


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """Hyperparameters; a ValueError if a number of processes or lanes is out of range.

    The discount looks 7 s ahead; the first exploration is a third of the full action, because zero action is already a
    good controller. Observations and rewards are scaled and clipped as :mod:`agents.rllib.runner_envs` says.
    """

    num_env_runners: int = 2  # processes that play episodes
    envs_per_runner: int = 128  # lanes of each
    num_learners: int = 0  # processes that learn; 0: the command itself does
    n_steps: int = 300  # steps per lane in an update: half an episode
    n_minibatches: int = 8  # parts of them, each learned from in turn
    n_epochs: int = 5  # times that each part is learned from
    gamma: float = 0.985  # discount per step of 0.1 s
    gae_lambda: float = 0.95  # decay of the advantage estimate
    learning_rate: float = 1e-3  # at the start; it falls linearly to zero at the last step
    clip_range: float = 0.2  # of the ratio of new to old probability
    max_grad_norm: float = 0.5
    vf_coef: float = 0.5  # weight of the value function's error; policy and value function share no layer
    hidden: int = 64  # width of the two layers of tanh in the policy and in the value function
    log_std_init: float = -1.0  # logarithm of the first exploration's standard deviation [full action]

    def __post_init__(self) -> None:
        for name, least in (("num_env_runners", 1), ("envs_per_runner", 1), ("num_learners", 0)):
            require_range(name, getattr(self, name), least, 10_000, "")

    @property
    def n_envs(self) -> int:
        """Lanes of all runners together."""
        return self.num_env_runners * self.envs_per_runner
