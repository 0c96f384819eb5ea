"""A trained learner of Stable-Baselines3 as a network for the export."""

from __future__ import annotations

from typing import Any

import numpy as np
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3.common.distributions import DiagGaussianDistribution, StateDependentNoiseDistribution
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents.networks import Normalization, PolicyNetwork, flat_layers


def network_of(policy: BasePolicy, vec_normalize: VecNormalize | None) -> PolicyNetwork:
    """Return the network that a policy's deterministic `predict` evaluates.

    Raises:
        ValueError: it has a layer that the export cannot write.
    """
    lstm: nn.LSTM | None = None
    if isinstance(policy, ActorCriticPolicy):
        distribution = policy.action_dist
        squashed = isinstance(distribution, StateDependentNoiseDistribution) and distribution.bijector is not None
        if not isinstance(distribution, (DiagGaussianDistribution, StateDependentNoiseDistribution)) or squashed:
            raise ValueError(f"cannot export actions of {type(distribution).__name__} that are not a plain mean")
        extractor = policy.pi_features_extractor
        layers = flat_layers([policy.mlp_extractor.policy_net, policy.action_net])
        if isinstance(policy, RecurrentActorCriticPolicy):
            lstm = _plain(policy.lstm_actor)
    else:
        actor: Any = policy.actor
        extractor = actor.features_extractor
        # TD3's `mu` is the whole network and ends in Tanh; SAC and TQC squash what theirs gives.
        layers = flat_layers([actor.latent_pi, actor.mu, nn.Tanh()] if hasattr(actor, "latent_pi") else [actor.mu])
    if not isinstance(extractor, FlattenExtractor):
        raise ValueError(f"cannot export the features of {type(extractor).__name__}, only plain observations")
    shape = policy.observation_space.shape
    assert shape is not None
    return PolicyNetwork(n_observation=shape[0], normalization=_normalization(vec_normalize), lstm=lstm, layers=layers)


def _plain(lstm: nn.LSTM) -> nn.LSTM:
    given = {name: getattr(lstm, name) for name in ("bias", "bidirectional", "proj_size")}
    if given != {"bias": True, "bidirectional": False, "proj_size": 0}:
        raise ValueError(f"cannot export an LSTM with {given}, only with bias, one direction and no projection")
    return lstm


def _normalization(vec_normalize: VecNormalize | None) -> Normalization | None:
    if vec_normalize is None or not vec_normalize.norm_obs:
        return None
    statistics = vec_normalize.obs_rms
    assert isinstance(statistics, RunningMeanStd)
    std = np.sqrt(statistics.var + vec_normalize.epsilon)
    return Normalization(mean=statistics.mean, std=std, bound=vec_normalize.clip_obs)


__all__ = ["network_of"]
