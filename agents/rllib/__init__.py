"""PPO of Ray RLlib, on one machine or on a Ray cluster: its hyperparameters. Only the learner needs Ray."""

from __future__ import annotations

from dataclasses import dataclass

#: The algorithm's name in run.json.
NAME = "rllib_ppo"


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """What can be turned. Most values are those of configs/ppo.yml.

    The discount looks 7 s ahead; the first exploration is a third of the full action, because zero action is already a
    good controller. Observations and rewards are scaled and clipped as :mod:`agents.rllib.environment` says.

    Args:
        num_env_runners: processes that play episodes.
        envs_per_runner: lanes of each.
        num_learners: processes that learn; 0: this one does.
        n_steps: steps per lane that an update learns from; half an episode.
        n_minibatches: parts that the steps are learned from in.
        n_epochs: times that each of them is learned from.
        gamma: discount per step of 0.1 s.
        gae_lambda: decay of the advantage estimate.
        learning_rate: at the start; it falls linearly to zero at the last step.
        clip_range: of the ratio of new to old probability.
        vf_coef: weight of the value function's error; policy and value function share no layer.
        max_grad_norm: largest norm of a gradient.
        hidden: width of the two layers of tanh in the policy and in the value function.
        log_std_init: logarithm of the first exploration's standard deviation [full action].
    """

    num_env_runners: int = 2
    envs_per_runner: int = 128
    num_learners: int = 0
    n_steps: int = 300
    n_minibatches: int = 8
    n_epochs: int = 5
    gamma: float = 0.985
    gae_lambda: float = 0.95
    learning_rate: float = 1e-3
    clip_range: float = 0.2
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5
    hidden: int = 64
    log_std_init: float = -1.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("num_env_runners", 1, 10_000),
            ("envs_per_runner", 1, 10_000),
            ("num_learners", 0, 1_000),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} must be a whole number, {low} … {high}, got {value}")

    @property
    def n_envs(self) -> int:
        """Lanes of all runners together."""
        return self.num_env_runners * self.envs_per_runner
