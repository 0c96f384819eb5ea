"""`python -m agents.rllib_ppo`: PPO of Ray RLlib, on one machine or on a Ray cluster.

This file is the command, and can be imported without Ray; :mod:`agents.rllib_learner` is what runs.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.command import run_command
from agents.runs import Run, RunSettings, held, new_folder
from wtg_gym.cli.output import note
from wtg_gym.cli.parser import Parser
from wtg_gym.envs.settings import ACTION_MODES, OBSERVATION_MODES

#: The algorithm's name in run.json.
NAME = "rllib_ppo"

_DESCRIPTION = """\
Trains a policy with PPO of Ray RLlib: several runners, each with many episodes at once, collect what one or more
learners learn from. A folder gets run.json, TensorBoard's files, the policy with the best validation score, and RLlib's
checkpoint to go on from with --resume after an interruption of any kind."""
_EXAMPLES = """\
examples:
  python -m agents.rllib_ppo --output runs/rllib-0
  python -m agents.rllib_ppo --address auto --num-env-runners 32 --num-learners 2 --output /shared/runs/rllib-0
  python -m agents.rllib_ppo --resume runs/rllib-0
  python -m agents.export runs/rllib-0 --output agents/policies/rllib-0 --name 'RLlib PPO'"""


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """What can be turned. Most values are those of configs/ppo.yml.

    The discount looks 7 s ahead; the first exploration is a third of the full action, because zero action is already a
    good controller. Observations and rewards are scaled and clipped as :mod:`agents.rllib_envs` says.

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


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="python -m agents.rllib_ppo", description=_DESCRIPTION, epilog=_EXAMPLES)
    default = Hyperparameters()
    parser.add_argument("--output", metavar="FOLDER", help="folder of the new run")
    parser.add_argument("--resume", metavar="FOLDER", help="go on with the run in this folder; takes the next two only")
    parser.add_argument(
        "--allow-other-versions",
        action="store_true",
        default=None,
        help="resume with other sources, suite or packages than before, which run.json then says",
    )
    parser.add_argument("--address", help="Ray cluster to join, such as auto or HOST:6379 (default: start Ray here)")
    for option, of_each in (
        ("num-env-runners", f"processes that play episodes (default: {default.num_env_runners})"),
        ("envs-per-runner", f"episodes side by side in each of them (default: {default.envs_per_runner})"),
        ("num-learners", "processes that learn; 0: the command's own (default: 0)"),
        ("timesteps", "environment steps in all (default: 10000000)"),
        ("interval", "steps between validations with a checkpoint each (default: a 20th of all)"),
        ("validation-episodes", "scenarios per validation (default: 50)"),
        ("seed", "seed of everything random (default: 0)"),
    ):
        parser.add_argument(f"--{option}", type=int, metavar="N", help=of_each)
    parser.add_argument("--action-mode", choices=tuple(ACTION_MODES), help="what the policy modulates (default: k+tau)")
    parser.add_argument("--observation-mode", choices=OBSERVATION_MODES, help="what it sees (default: local)")
    parser.add_argument("--suite", metavar="NAME", help="suite to train and validate on (default: standard)")
    return parser


def _run(arguments: argparse.Namespace) -> tuple[Run, Path]:
    """Return the run that the options ask for and its folder, which may not exist yet."""
    given = {key: value for key, value in vars(arguments).items() if value is not None and key != "address"}
    if "resume" in given:
        others = sorted(set(given) - {"resume", "allow_other_versions"})
        if others:
            raise ValueError(f"--resume goes on with the run's own settings; leave out {', '.join(others)}")
        folder = Path(given["resume"])
        run = Run.read(folder)
        if run.settings.algo != NAME:
            raise ValueError(f"{folder} is a run of {run.settings.algo}: go on with it by the command that began it")
        run.go_on(allow_other_versions=bool(given.get("allow_other_versions")))
        return run, folder
    if "allow_other_versions" in given:
        raise ValueError("--allow-other-versions is for --resume")
    if "output" not in given:
        raise ValueError("--output FOLDER is needed, or --resume FOLDER")
    folder = Path(given.pop("output"))
    names = [field.name for field in dataclasses.fields(Hyperparameters) if field.name in given]
    hyperparameters = Hyperparameters(**{name: given.pop(name) for name in names})
    timesteps = given.pop("timesteps", 10_000_000)
    settings = RunSettings(
        algo=NAME,
        hyperparameters=dataclasses.asdict(hyperparameters),
        timesteps=timesteps,
        n_envs=hyperparameters.n_envs,
        interval=given.pop("interval", max(1, timesteps // 20)),
        **given,
    )
    return Run.new(settings), folder


def _train(arguments: argparse.Namespace) -> None:
    run, folder = _run(arguments)
    if importlib.util.find_spec("ray") is None:
        raise ValueError("ray is not installed: pip install -c constraints-rllib.txt -e '.[rllib]', or make rllib")
    from agents.rllib_learner import train

    with new_folder(folder) if arguments.resume is None else held(folder):
        train(run, folder, arguments.address)
    best, wall_time_s = run.best, run.curve[-1]["wall_time_s"]
    note(f"best validation score {best['score']:.1f} at step {best['timesteps']}; {wall_time_s:.0f} s in all")
    note(f"wrote {folder}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    return run_command(lambda: _train(_parser().parse_args(argv)), "go on with --resume")


if __name__ == "__main__":
    sys.exit(main())
