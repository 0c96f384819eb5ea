"""The training of `python -m agents.rllib`: PPO and the network are RLlib's own.

Runners scale observations and rewards by what was measured beforehand, so that the weights and these scales are the
policy: playing it needs no Ray.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

import numpy as np
import ray
import torch
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.models.base import ACTOR, ENCODER_OUT
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.tune.registry import register_env
from torch import Tensor, nn

from agents.folders import loading
from agents.rllib.runner_envs import CLIP, RunnerEnvs, Scales, measure_scales
from agents.runs import Run, RunSettings
from agents.training import Training, last_checkpoint
from wtg_gym.progress import Progress

_LANES = "wtg_gym-lanes"
#: Discount per step of 0.1 s: it looks 7 s ahead.
_GAMMA = 0.985
#: Logarithm of the first exploration's standard deviation: a third of the full action, because zero action is already a
#: good controller.
_LOG_STD = -1.0
#: Steps per lane in an update, half an episode; parts that they are learned from in turn; width of the hidden layers.
_N_STEPS, _N_MINIBATCHES, _HIDDEN = 300, 8, 64


class CalmModule(DefaultPPOTorchRLModule):  # type: ignore[misc]
    """RLlib's own network, which starts almost as the reference controller and explores as little as it is told."""

    def setup(self) -> None:
        """Build the networks."""
        super().setup()
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                nn.init.orthogonal_(layer.weight, 2**0.5)
                nn.init.zeros_(layer.bias)
        # Almost zero: the reference controller.
        nn.init.orthogonal_(self.pi.net.mlp[-1].weight, 0.01)
        nn.init.constant_(self.pi.log_std, self.model_config["log_std_init"])


class PolicyNetwork(nn.Module):
    """The deterministic action for a raw observation."""

    mean: Tensor
    std: Tensor

    def __init__(self, module: CalmModule, scales: Scales) -> None:
        super().__init__()
        self.module = module
        self.register_buffer("mean", torch.tensor(scales.mean, dtype=torch.float64))
        self.register_buffer("std", torch.tensor(scales.std, dtype=torch.float64))

    def forward(self, observation: Tensor) -> Tensor:
        """Return the actions (batch, n_action) for observations (batch, n_observation)."""
        seen = ((observation.double() - self.mean) / self.std).clamp(-CLIP, CLIP).float()
        actions: Tensor = self.module.pi.net(self.module.encoder({Columns.OBS: seen})[ENCODER_OUT][ACTOR])
        return actions


class RLlibLearner:
    """An algorithm of RLlib, for :class:`agents.training.Training`."""

    def __init__(self, algorithm: Algorithm, spec: RLModuleSpec, scales: Scales) -> None:
        self.algorithm, self._spec, self._scales = algorithm, spec, scales

    def network(self, _settings: RunSettings) -> nn.Module:
        """Return the policy as the learner has it now."""
        module = self._spec.build()
        module.set_state(self.algorithm.learner_group.get_weights()[DEFAULT_MODULE_ID])
        return PolicyNetwork(module, self._scales)

    def save(self, folder: Path) -> None:
        """Write everything that training goes on from."""
        # RLlib wants an absolute path.
        self.algorithm.save_to_path(folder.resolve())


def module_spec(settings: RunSettings, scales: Scales) -> RLModuleSpec:
    """Return the network of a run."""
    with_spaces = RunnerEnvs(1, scales=scales, **settings.env_arguments)
    with_spaces.close()
    return RLModuleSpec(
        module_class=CalmModule,
        observation_space=with_spaces.single_observation_space,
        action_space=with_spaces.single_action_space,
        model_config={
            "fcnet_hiddens": [_HIDDEN, _HIDDEN],
            "fcnet_activation": "tanh",
            "vf_share_layers": False,
            "free_log_std": True,
            "log_std_init": _LOG_STD,
        },
    )


def ppo_config(settings: RunSettings, scales: Scales, spec: RLModuleSpec, resumed: int = 0) -> PPOConfig:
    """Return RLlib's configuration of a run.

    Args:
        resumed: how many times it has gone on; the scenarios and the exploration are others each time.
    """
    processes = settings.hyperparameters
    per_learner = _N_STEPS * settings.n_envs // max(1, processes["num_learners"])
    register_env(_LANES, lambda config: RunnerEnvs(**config))
    seed = int(np.random.SeedSequence((settings.seed, resumed)).generate_state(1)[0] >> 2)
    return (
        PPOConfig()
        .framework("torch")
        # One thread per runner, which is one CPU for Ray. The environment clips actions itself.
        .environment(
            _LANES,
            env_config={**settings.env_arguments, "scales": scales, "n_threads": 1},
            normalize_actions=False,
            clip_actions=False,
        )
        .env_runners(
            num_env_runners=processes["num_env_runners"],
            num_envs_per_env_runner=processes["envs_per_runner"],
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=_N_STEPS,
        )
        .learners(num_learners=processes["num_learners"], num_gpus_per_learner=0)
        .rl_module(rl_module_spec=spec)
        .training(
            train_batch_size_per_learner=per_learner,
            minibatch_size=max(1, per_learner // _N_MINIBATCHES),
            num_epochs=5,
            gamma=_GAMMA,
            lambda_=0.95,
            # The learning rate falls to zero at the last step.
            lr=[[0, 1e-3], [settings.timesteps, 0.0]],
            clip_param=0.2,
            use_kl_loss=False,
            entropy_coeff=0.0,
            vf_loss_coeff=0.5,
            vf_clip_param=float("inf"),
            grad_clip=0.5,
            grad_clip_by="global_norm",
        )
        .debugging(seed=seed, log_level="ERROR")
    )


def _connect(address: str | None, n_processes: int) -> None:
    """Join a Ray cluster, or start one of this machine alone; a ValueError if it has too few CPUs."""
    # Nothing about a run is reported to anybody, unless the user says otherwise.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    logging.getLogger("ray.rllib").setLevel(logging.ERROR)
    here: dict[str, Any] = {"num_cpus": max(2, n_processes), "include_dashboard": False} if address is None else {}
    ray.init(address or "local", logging_level="ERROR", log_to_driver=False, **here)
    n_cpus = int(ray.cluster_resources().get("CPU", 0))
    if n_cpus < n_processes:
        ray.shutdown()
        raise ValueError(f"{n_processes} runners and learners need a CPU each, but the cluster has {n_cpus}")


def train(run: Run, folder: Path, address: str | None = None) -> None:
    """Train until the run's timesteps are done, from its last checkpoint on if it has one."""
    settings, processes = run.settings, run.settings.hyperparameters
    torch.set_num_threads(1)
    _connect(address, processes["num_env_runners"] + processes["num_learners"])
    try:
        # The first use of the kernels on a machine compiles them: here, before the runners all do so at once.
        noise = float(np.exp(_LOG_STD))
        scales = measure_scales(settings.env_arguments, noise=noise, gamma=_GAMMA, seed=settings.seed)
        spec = module_spec(settings, scales)
        algorithm = ppo_config(settings, scales, spec, len(run.resumptions)).build_algo()
        try:
            steps = first = 0
            if saved := last_checkpoint(run, folder):
                steps = first = int(saved.name)
                with loading(saved):
                    algorithm.restore_from_path(str(saved.resolve()))
            training = Training(run, folder, RLlibLearner(algorithm, spec, scales))
            with Progress("thousand steps") as progress:
                while steps < settings.timesteps:
                    training.take_stock(steps)
                    progress.update(training.title, (steps - first) / 1000, round((settings.timesteps - first) / 1000))
                    steps = int(algorithm.train()["num_env_steps_sampled_lifetime"])
                training.take_stock(steps, finished=True)
        finally:
            algorithm.stop()
    finally:
        ray.shutdown()
