"""`python -m agents.rllib`: trains a policy with PPO of Ray RLlib, on one machine or on a Ray cluster."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from agents.command import opened_run, run_command, settings_of, training_parser
from agents.runs import RunSettings

#: The algorithm's name in run.json.
NAME = "rllib_ppo"
_TIMESTEPS = 10_000_000
_DESCRIPTION = """\
Trains a policy with PPO of Ray RLlib: several runners, each with many episodes at once, collect what one or more
learners learn from. A folder gets run.json, the policy with the best validation score, and RLlib's checkpoint
to go on from with --resume after an interruption of any kind."""
#: Options, their defaults, their least values, and what they are.
_PROCESSES = {
    "num_env_runners": (2, 1, "processes that play episodes"),
    "envs_per_runner": (128, 1, "episodes side by side in each of them"),
    "num_learners": (0, 0, "processes that learn; 0: the command's own"),
}


def _settings(given: Mapping[str, Any]) -> RunSettings:
    processes = {name: given.get(name, default) for name, (default, _, _) in _PROCESSES.items()}
    for name, (_, least, _) in _PROCESSES.items():
        if processes[name] < least:
            raise ValueError(f"{name} must be {least} or more, got {processes[name]}")
    n_envs = processes["num_env_runners"] * processes["envs_per_runner"]
    return settings_of(given, NAME, processes, timesteps=_TIMESTEPS, n_envs=n_envs)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = training_parser("agents.rllib", _DESCRIPTION, timesteps=str(_TIMESTEPS))
    parser.add_argument("--address", help="Ray cluster to join, such as auto or HOST:6379 (default: start Ray here)")
    for name, (default, _, text) in _PROCESSES.items():
        option = f"--{name.replace('_', '-')}"
        parser.add_argument(option, type=int, metavar="N", help=f"{text} (default: {default})")

    def work() -> None:
        given = vars(parser.parse_args(argv))
        # The only option that a resumed run takes as well.
        address = given.pop("address", None)
        with opened_run(given, (NAME,), lambda: _settings(given)) as (run, folder):
            try:
                from agents.rllib.learner import train
            except ImportError as error:
                advice = "install -c constraints-rllib.txt -e '.[rllib]', or run make rllib"
                raise ValueError(f"ray is needed: {advice} ({error})") from error
            train(run, folder, address)

    return run_command(work, "go on with --resume")


if __name__ == "__main__":
    sys.exit(main())
