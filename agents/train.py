"""`python -m agents.train`: trains a policy with Stable-Baselines3 on the native vector environment."""

from __future__ import annotations

import argparse
import functools
import itertools
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from agents import multi_agent
from agents.command import (
    Parser,
    Progress,
    add_folder_options,
    add_plant_options,
    add_training_options,
    given_options,
    opened_run,
    run_command,
    settings_of,
)
from agents.entry_file import entry_values, write_entry
from agents.folders import CHECKPOINTS, folders
from agents.hyperparameters import ALGORITHMS, CONFIG_FOLDER, parse, read_config
from agents.learners import build_model, load_checkpoint, save_checkpoint, save_policy
from agents.onnx_graph import to_onnx
from agents.runs import Run, RunSettings
from wtg_gym.policies.load import POLICY_FILE
from wtg_gym.policies.sb3_archive import NormalizedPolicy
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite

_DESCRIPTION = """\
Trains a policy and writes everything about it to a folder: run.json, TensorBoard's files, the policy with the best
validation score, and a checkpoint to go on from with --resume after an interruption of any kind.

With "ippo" and "mappo" every WTG group plays the same policy by itself, from what it measures itself: "ippo" is
independent PPO with shared parameters, "mappo" learns with a value function that sees the whole grid. A lane is then
one group of one episode: one step of an episode is as many steps as it has groups."""
_EXAMPLES = """\
examples:
  python -m agents.train --algo ppo --output runs/ppo-0 --seed 0
  python -m agents.train --algo sac --action-mode k --timesteps 200000 --output runs/sac-k
  python -m agents.train --algo ippo --groups 4 --output runs/ippo-4
  python -m agents.train --resume runs/ppo-0
  tensorboard --logdir runs"""

#: The algorithms to choose from, the multi-agent ones last.
TRAINED = (*ALGORITHMS, *multi_agent.ALGORITHMS)
#: Called with (timesteps, score) after each validation; an exception that it raises ends the run.
OnScore = Callable[[int, float], None]


def start(run: Run) -> BaseAlgorithm:
    """Return a new run's learner.

    Raises:
        ValueError: a hyperparameter is unknown or out of range, or makes a policy that cannot be exported.
    """
    # Sums over several threads depend on which of them ends first, those that draw the first weights among them, and
    # networks this small gain nothing from them.
    torch.set_num_threads(1)
    settings = run.settings
    hyperparameters = parse(multi_agent.base_algorithm(settings.algo), settings.hyperparameters)
    env: VecEnv = VecMonitor(multi_agent.training_env(settings))
    hyperparameters = multi_agent.with_central_critic(settings, hyperparameters, env)
    if hyperparameters.normalize is not None:
        env = VecNormalize(env, **hyperparameters.normalize)
    try:
        algo = multi_agent.base_algorithm(settings.algo)
        model = build_model(algo, hyperparameters, env, seed=settings.seed, device=settings.device)
        # A policy that cannot be written is refused now rather than after the training.
        to_onnx(multi_agent.joint_network(settings, _policy_of(model)))
    except ValueError:
        env.close()
        raise
    return model


def _policy_of(model: BaseAlgorithm) -> NormalizedPolicy:
    return NormalizedPolicy(model.policy, model.get_vec_normalize_env())


def train(run: Run, folder: Path | None = None, on_score: OnScore | None = None) -> None:
    """Train until the run's timesteps are done, from its last checkpoint on if there is one.

    Args:
        run: its curve grows here.
        folder: for checkpoints, the best policy, TensorBoard's files and run.json; None to write nothing.
        on_score: called with (timesteps, score) after every validation; an exception that it raises ends the run.

    Raises:
        ValueError: a hyperparameter is wrong, or the run's checkpoint is gone or damaged.
    """
    torch.set_num_threads(1)
    checkpoints = folders(folder / CHECKPOINTS) if folder is not None else []
    if run.curve and not checkpoints:
        raise ValueError(f"{folder} has validations, but no checkpoint to go on from; begin anew in another folder")
    settings = run.settings
    algo = multi_agent.base_algorithm(settings.algo)
    model = load_checkpoint(checkpoints[-1], algo, settings.device) if checkpoints else start(run)
    restored_at = model.num_timesteps if checkpoints else None
    if folder is not None:
        # First of all, so that a run can go on whenever it is interrupted.
        run.write(folder)
    outputs = (None, []) if folder is None else (str(folder / "tensorboard"), ["tensorboard"])
    model.set_logger(configure(*outputs))
    env = model.get_env()
    assert env is not None
    try:
        with Progress("thousand steps") as progress:
            supervision = _Supervision(run, folder, progress, on_score, restored_at)
            supervision.init_callback(model)
            left = settings.timesteps - model.num_timesteps
            if left > 0:
                # A new learner starts its environments all the same; one from a checkpoint, be it of step 0, goes on.
                model.learn(left, callback=supervision, reset_num_timesteps=False)
            run.finished = True
            if run.curve[-1]["timesteps"] < model.num_timesteps:
                supervision.take_stock()
                model.logger.dump(model.num_timesteps)
            elif folder is not None:
                run.write(folder)
    finally:
        env.close()


class _Supervision(BaseCallback):
    """Measures, validates and saves while a learner learns.

    Args:
        restored_at: timesteps of the checkpoint that the learner is from; None for a new one.
    """

    def __init__(
        self, run: Run, folder: Path | None, progress: Progress, on_score: OnScore | None, restored_at: int | None
    ) -> None:
        super().__init__()
        self._run = run
        self._folder = folder
        self._progress = progress
        self._on_score = on_score
        self._restored_at = restored_at
        self._first = restored_at or 0
        self._began = time.monotonic() - (run.curve[-1]["wall_time_s"] if run.curve else 0.0)

    def _on_step(self) -> bool:
        for info in itertools.compress(self.locals["infos"], self.locals["dones"]):
            for key, value in info["metrics"].items():
                self.logger.record_mean(f"episode/{key}", value)
        run = self._run
        name = f"{run.settings.algo}, score {run.curve[-1]['score']:.1f}, best {run.best['score']:.1f}"
        # Counted from where this process began, so that the remaining time follows from its own speed.
        done, total = self.num_timesteps - self._first, run.settings.timesteps - self._first
        self._progress.update(name, done / 1000, round(total / 1000))
        return True

    def _on_rollout_start(self) -> None:
        # Here, and not in the middle of a rollout, the learner is at rest and can be saved whole.
        if self._run.is_due(self.num_timesteps):
            self.take_stock()

    def take_stock(self) -> None:
        """Validate, keep the best policy, and write a checkpoint."""
        run, model = self._run, self.model
        policy = multi_agent.joint_policy(run.settings, _policy_of(model))
        metrics = run.validate(policy, model.num_timesteps, time.monotonic() - self._began)
        for key, value in metrics.items():
            self.logger.record(f"validation/{key}", value)
        if self._folder is not None:
            run.keep(self._folder, self._write_best, functools.partial(save_checkpoint, model=model))
        if model.num_timesteps != self._restored_at and getattr(model, "use_sde", False):
            # A learner draws the noise of its next rollout before it calls us, and once more after a resumption.
            actor: Any = model.policy
            actor.reset_noise(model.n_envs)
        if self._on_score is not None:
            self._on_score(model.num_timesteps, metrics["score"])

    def _write_best(self, folder: Path) -> None:
        """Write the policy as an entry: an archive for `wtg-gym evaluate --trust-pickle`; of many agents ONNX."""
        settings = self._run.settings
        entry = entry_values(settings, self.model.num_timesteps)
        if settings.algo in multi_agent.ALGORITHMS:
            # An archive takes what one group sees, and is for the export alone.
            (folder / multi_agent.ARCHIVE_FOLDER).mkdir()
            save_policy(folder / multi_agent.ARCHIVE_FOLDER, self.model)
            content = to_onnx(multi_agent.joint_network(multi_agent.entry_settings(settings), _policy_of(self.model)))
            (folder / POLICY_FILE).write_bytes(content)
        else:
            save_policy(folder, self.model)
            entry["algorithm"] = type(self.model).__name__
        write_entry(folder, entry)


def add_sb3_options(parser: argparse.ArgumentParser, algos: Sequence[str]) -> None:
    """Add the options that training and tuning share; `algos` are the algorithms to choose from."""
    parser.add_argument("--algo", choices=tuple(algos), help="the algorithm")
    add_training_options(parser, timesteps="the file's")
    add_plant_options(parser)
    parser.add_argument("--n-envs", type=int, metavar="N", help="lanes side by side (default: the file's)")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="where the networks are (default: cpu)")
    parser.add_argument(
        "--config",
        metavar="FILE",
        help="hyperparameters (default: agents/configs/<algo>.yml, of td3 and tqc for v0 only)",
    )


def sb3_settings(given: Mapping[str, Any]) -> RunSettings:
    """Return the settings that the options of :func:`add_sb3_options` and the hyperparameter file ask for.

    Raises:
        ValueError: a value is missing, unknown or out of range.
    """
    if "algo" not in given:
        raise ValueError(f"--algo is needed: {', '.join(TRAINED)}")
    algo = given["algo"]
    env_id = get_suite(given.get("suite", DEFAULT_SUITE)).benchmark.env_id
    # Both have the same hyperparameters, whatever their critics see.
    path = Path(given.get("config", CONFIG_FOLDER / f"{'ippo' if algo in multi_agent.ALGORITHMS else algo}.yml"))
    raw = read_config(path, env_id)
    try:
        file = parse(multi_agent.base_algorithm(algo), raw)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return settings_of(given, algo, raw, timesteps=file.n_timesteps, n_envs=given.get("n_envs", file.n_envs))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.train", description=_DESCRIPTION, epilog=_EXAMPLES)
    add_sb3_options(parser, TRAINED)
    add_folder_options(parser)

    def work() -> None:
        given = given_options(parser.parse_args(argv))
        with opened_run(given, TRAINED, lambda: sb3_settings(given)) as (run, folder):
            train(run, folder)

    return run_command(work, "go on with --resume")


if __name__ == "__main__":
    sys.exit(main())
