"""The training of `python -m agents.rllib`: PPO of RLlib, with the network of :mod:`agents.ppo`.

The network holds its own normalisation, so that its weights alone are the policy: the best ones are saved as those of
the PPO in one file are, and neither scoring nor exporting them needs Ray.
"""

from __future__ import annotations

import functools
import logging
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import ray
import torch
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.torch import TorchRLModule
from ray.rllib.utils.metrics import ENV_RUNNER_RESULTS, LEARNER_RESULTS, NUM_ENV_STEPS_SAMPLED_LIFETIME
from ray.tune.registry import register_env
from tensorboardX import SummaryWriter

from agents import ppo
from agents.command import Progress
from agents.folders import CHECKPOINTS, folders, loading
from agents.rllib import Hyperparameters
from agents.rllib.runner_envs import RunnerEnvs, Scales, measure_scales
from agents.runs import Run, RunSettings

_PREFIX = "agent."
_LANES = "wtg_gym-lanes"


class AgentModule(TorchRLModule, ValueFunctionAPI):  # type: ignore[misc]
    """The agent of :mod:`agents.ppo` as RLlib wants to see it.

    Its `model_config` holds `hidden`, `log_std_init`, and `mean` and `std` of the observation.
    """

    def setup(self) -> None:
        """Build the networks."""
        config = self.model_config
        self.agent = ppo.Agent(
            self.observation_space.shape[0],
            self.action_space.shape[0],
            ppo.Hyperparameters(hidden=config["hidden"], log_std_init=config["log_std_init"]),
        )
        # Measured beforehand and never updated.
        self.agent.moments.mean.copy_(torch.tensor(config["mean"], dtype=torch.float64))
        self.agent.moments.var.copy_(torch.tensor(config["std"], dtype=torch.float64).square())

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        """Return mean and logarithm of the standard deviation of the actions, (n, 2 · n_action)."""
        mean = self.agent.actor(self.agent.normalized(batch[Columns.OBS]))
        return {Columns.ACTION_DIST_INPUTS: torch.cat([mean, self.agent.log_std.expand_as(mean)], dim=-1)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> Any:
        """Return the expected scaled returns (n,)."""
        return self.agent.value(self.agent.normalized(batch[Columns.OBS]))


def ppo_config(settings: RunSettings, scales: Scales, resumed: int = 0) -> PPOConfig:
    """Return RLlib's configuration of a run.

    Args:
        resumed: how many times it has gone on; the scenarios and the exploration are others each time.
    """
    h = Hyperparameters(**settings.hyperparameters)
    per_learner = h.n_steps * h.n_envs // max(1, h.num_learners)
    register_env(_LANES, lambda config: RunnerEnvs(**config))
    seed = int(np.random.SeedSequence((settings.seed, resumed)).generate_state(1)[0] >> 2)
    return (
        PPOConfig()
        .framework("torch")
        # One thread per runner, which is one CPU for Ray.
        .environment(
            _LANES,
            env_config={**settings.env_arguments, "reward_scale": scales.reward, "n_threads": 1},
            # The environment clips actions itself.
            normalize_actions=False,
            clip_actions=False,
        )
        .env_runners(
            num_env_runners=h.num_env_runners,
            num_envs_per_env_runner=h.envs_per_runner,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=h.n_steps,
        )
        .learners(num_learners=h.num_learners, num_gpus_per_learner=0)
        .rl_module(
            rl_module_spec=RLModuleSpec(
                module_class=AgentModule,
                model_config={
                    "hidden": h.hidden,
                    "log_std_init": h.log_std_init,
                    "mean": scales.mean,
                    "std": scales.std,
                },
            )
        )
        .training(
            train_batch_size_per_learner=per_learner,
            minibatch_size=max(1, per_learner // h.n_minibatches),
            num_epochs=h.n_epochs,
            gamma=h.gamma,
            lambda_=h.gae_lambda,
            lr=[[0, h.learning_rate], [settings.timesteps, 0.0]],
            clip_param=h.clip_range,
            use_kl_loss=False,
            entropy_coeff=0.0,
            vf_loss_coeff=h.vf_coef,
            vf_clip_param=float("inf"),
            grad_clip=h.max_grad_norm,
            grad_clip_by="global_norm",
        )
        .debugging(seed=seed, log_level="ERROR")
    )


def _connect(address: str | None, h: Hyperparameters) -> None:
    """Join a Ray cluster, or start one of this machine alone.

    Raises:
        ValueError: the cluster does not exist, or has too few CPUs.
    """
    # Nothing about a run is reported to anybody, unless the user says otherwise.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    logging.getLogger("ray.rllib").setLevel(logging.ERROR)
    n_processes = h.num_env_runners + h.num_learners
    options: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
    if address is None:
        ray.init("local", num_cpus=max(2, n_processes), include_dashboard=False, **options)
        return
    try:
        ray.init(address, **options)
    except (ConnectionError, ValueError, SystemExit) as error:
        # Ray ends the process where a cluster that it remembers is gone.
        raise ValueError(f"--address {address}: no Ray cluster answers ({_reason(error)})") from error
    n_cpus = int(ray.cluster_resources().get("CPU", 0))
    if n_cpus < n_processes:
        ray.shutdown()
        raise ValueError(f"{n_processes} runners and learners need a CPU each, but the cluster has {n_cpus}")


def _reason(error: BaseException) -> str:
    # An exit has a number for its reason, if any.
    text = "" if isinstance(error, SystemExit) else str(error).partition("\n")[0]
    return text or type(error).__name__


def _steps_of(algorithm: Algorithm) -> int:
    return int(algorithm.metrics.peek((ENV_RUNNER_RESULTS, NUM_ENV_STEPS_SAMPLED_LIFETIME), default=0))


def _agent_of(algorithm: Algorithm) -> ppo.Agent:
    """Return the agent as the learner has it now."""
    state = algorithm.learner_group.get_weights()[DEFAULT_MODULE_ID]
    weights = {key.removeprefix(_PREFIX): torch.as_tensor(np.array(value)) for key, value in state.items()}
    return ppo.agent_of(weights)


def train(run: Run, folder: Path, address: str | None = None) -> None:
    """Train until the run's timesteps are done, from its last checkpoint on if it has one.

    Args:
        run: its curve grows here.
        folder: where run.json, checkpoints, the best policy and TensorBoard's files go.
        address: of a Ray cluster; None to start one of this machine alone.

    Raises:
        ValueError: the cluster does not exist, or has too few CPUs.
    """
    settings = run.settings
    h = Hyperparameters(**settings.hyperparameters)
    torch.set_num_threads(1)
    _connect(address, h)
    try:
        # The first use of the kernels on a machine compiles them: here, before the runners all do so at once.
        scales = measure_scales(
            settings.env_arguments, noise=float(np.exp(h.log_std_init)), gamma=h.gamma, seed=settings.seed
        )
        algorithm = ppo_config(settings, scales, run.resumed).build_algo()
        try:
            _train(run, folder, algorithm)
        finally:
            algorithm.stop()
    finally:
        ray.shutdown()


def _train(run: Run, folder: Path, algorithm: Algorithm) -> None:
    settings = run.settings
    run.write(folder)
    checkpoints = folders(folder / CHECKPOINTS)
    if checkpoints:
        with loading(checkpoints[-1]):
            algorithm.restore_from_path(str(checkpoints[-1].resolve()))
    steps = first = _steps_of(algorithm)
    # Rows after the checkpoint are of a policy that is lost.
    run.curve = [row for row in run.curve if row["timesteps"] <= steps]
    began = time.monotonic() - (run.curve[-1]["wall_time_s"] if run.curve else 0.0)
    with Progress("thousand steps") as progress, SummaryWriter(str(folder / "tensorboard")) as writer:
        while True:
            run.finished = steps >= settings.timesteps
            if run.is_due(steps) or (run.finished and run.curve[-1]["timesteps"] < steps):
                agent = _agent_of(algorithm)
                run.validate(agent, steps, time.monotonic() - began)
                # RLlib wants an absolute path.
                run.keep(folder.resolve(), functools.partial(ppo.save, agent=agent), algorithm.save_to_path)
            if run.finished:
                return
            name = f"{settings.algo}, score {run.curve[-1]['score']:.1f}, best {run.best['score']:.1f}"
            progress.update(name, (steps - first) / 1000, round((settings.timesteps - first) / 1000))
            result = algorithm.train()
            steps = _steps_of(algorithm)
            for group, values in (
                ("runners", result[ENV_RUNNER_RESULTS]),
                ("learner", result[LEARNER_RESULTS][DEFAULT_MODULE_ID]),
            ):
                for key, value in values.items():
                    if np.isscalar(value) and np.isfinite(value):
                        writer.add_scalar(f"{group}/{key}", value, steps)
