"""`python -m agents.train`: trains a policy with Stable-Baselines3 on the native vector environment."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from agents.command import run_command
from agents.hyperparameters import ALGORITHMS, CONFIG_FOLDER, parse, read_config
from agents.runs import Run, RunSettings, held, new_folder
from agents.training import resume, start, train
from wtg_gym.cli.output import note
from wtg_gym.cli.parser import Parser
from wtg_gym.envs.settings import ACTION_MODES, OBSERVATION_MODES

_DESCRIPTION = """\
Trains a policy and writes everything about it to a folder: run.json, TensorBoard's files, the policy with the best
validation score, and a checkpoint to go on from with --resume after an interruption of any kind."""
_EXAMPLES = """\
examples:
  python -m agents.train --algo ppo --output runs/ppo-0 --seed 0
  python -m agents.train --algo sac --action-mode k --timesteps 200000 --output runs/sac-k
  python -m agents.train --resume runs/ppo-0
  tensorboard --logdir runs"""


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that training and tuning share."""
    parser.add_argument("--algo", choices=tuple(ALGORITHMS), help="the algorithm")
    parser.add_argument("--action-mode", choices=tuple(ACTION_MODES), help="what the policy modulates (default: k+tau)")
    parser.add_argument("--observation-mode", choices=OBSERVATION_MODES, help="what it sees (default: local)")
    parser.add_argument("--suite", metavar="NAME", help="suite to train and validate on (default: standard)")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of everything random (default: 0)")
    parser.add_argument("--timesteps", type=int, metavar="N", help="environment steps in all (default: the file's)")
    parser.add_argument("--n-envs", type=int, metavar="N", help="episodes side by side (default: the file's)")
    parser.add_argument("--interval", type=int, metavar="N", help="steps between validations (default: a 20th of all)")
    parser.add_argument("--validation-episodes", type=int, metavar="N", help="scenarios per validation (default: 50)")
    parser.add_argument("--device", choices=("cpu", "cuda"), help="where the networks are (default: cpu)")
    parser.add_argument("--config", metavar="FILE", help="hyperparameters (default: agents/configs/<algo>.yml)")


def run_settings(arguments: argparse.Namespace) -> RunSettings:
    """Return what the options of :func:`add_run_options` and the hyperparameter file ask for.

    Raises:
        ValueError: a value is missing, unknown or out of range.
    """
    if arguments.algo is None:
        raise ValueError(f"--algo is needed: {', '.join(ALGORITHMS)}")
    raw = read_config(Path(arguments.config or CONFIG_FOLDER / f"{arguments.algo}.yml"))
    hyperparameters = parse(arguments.algo, raw)
    names = ("action_mode", "observation_mode", "suite", "seed", "validation_episodes", "device")
    given = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    timesteps = hyperparameters.n_timesteps if arguments.timesteps is None else arguments.timesteps
    return RunSettings(
        algo=arguments.algo,
        hyperparameters=raw,
        timesteps=timesteps,
        n_envs=hyperparameters.n_envs if arguments.n_envs is None else arguments.n_envs,
        interval=max(1, timesteps // 20) if arguments.interval is None else arguments.interval,
        **given,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.train", description=_DESCRIPTION, epilog=_EXAMPLES)
    add_run_options(parser)
    parser.add_argument("--output", metavar="FOLDER", help="folder of the new run")
    parser.add_argument(
        "--resume", metavar="FOLDER", help="go on with the run in this folder; takes only the next option"
    )
    parser.add_argument(
        "--allow-other-versions",
        action="store_true",
        default=None,
        help="resume with other sources, suite or packages than before, which run.json then says",
    )
    return run_command(lambda: _train(parser.parse_args(argv)), "go on with --resume")


def _train(arguments: argparse.Namespace) -> None:
    if arguments.resume is not None:
        allowed = ("resume", "allow_other_versions")
        others = sorted(key for key, value in vars(arguments).items() if value is not None and key not in allowed)
        if others:
            raise ValueError(f"--resume goes on with the run's own settings; leave out {', '.join(others)}")
        folder = Path(arguments.resume)
        # Once to see that it is a run's folder, and again when nobody else can change it.
        Run.read(folder)
        with held(folder):
            run = Run.read(folder)
            model, metrics = resume(run, folder, allow_other_versions=bool(arguments.allow_other_versions))
            train(run, model, metrics, folder)
    else:
        if arguments.output is None:
            raise ValueError("--output FOLDER is needed, or --resume FOLDER")
        if arguments.allow_other_versions:
            raise ValueError("--allow-other-versions is for --resume")
        run = Run.new(run_settings(arguments))
        with new_folder(Path(arguments.output)) as folder:
            model, metrics = start(run)
            train(run, model, metrics, folder)
    best, wall_time_s = run.best, run.curve[-1]["wall_time_s"]
    note(f"best validation score {best['score']:.1f} at step {best['timesteps']}; {wall_time_s:.0f} s in all")
    note(f"wrote {folder}")


if __name__ == "__main__":
    sys.exit(main())
