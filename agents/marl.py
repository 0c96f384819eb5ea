"""`python -m agents.marl`: trains one policy that every WTG group plays by itself, with Stable-Baselines3's PPO."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from agents.command import Parser, add_folder_options, given_options, opened_run, run_command
from agents.groups import ALGORITHMS, LEARNER
from agents.runs import RunSettings
from agents.train import add_learner_options, learner_settings, train

_DESCRIPTION = """\
Trains one policy for many agents: every WTG group plays it by itself, from what it measures itself. "ippo" is
independent PPO with shared parameters; "mappo" learns with a value function that sees the whole grid. A lane is one
group of one episode, and steps are counted in all lanes, as many as groups for one step of an episode. The rest is as
of `python -m agents.train`; the best policy is a folder that `wtg-gym evaluate` takes."""
_EXAMPLES = """\
examples:
  python -m agents.marl --algorithm ippo --output runs/ippo-0 --seed 0
  python -m agents.marl --algorithm mappo --suite standard-v1 --strategy coordinated-tuned --output runs/mappo-0
  python -m agents.marl --algorithm ippo --groups 4 --output runs/ippo-4
  wtg-gym evaluate --entries runs/ippo-0/best/* --suite standard
  python -m agents.export runs/ippo-0 --output agents/policies/ippo-0 --name IPPO --authors 'Jane Doe'"""


def _settings(given: Mapping[str, Any]) -> RunSettings:
    if "algorithm" not in given:
        raise ValueError(f"--algorithm is needed: {', '.join(ALGORITHMS)}")
    return learner_settings(given, given["algorithm"], LEARNER)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.marl", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--algorithm", choices=ALGORITHMS, help="the algorithm")
    add_learner_options(parser, config=LEARNER)
    add_folder_options(parser)

    def work() -> None:
        given = given_options(parser.parse_args(argv))
        with opened_run(given, ALGORITHMS, lambda: _settings(given)) as (run, folder):
            train(run, folder)

    return run_command(work, "go on with --resume")


if __name__ == "__main__":
    sys.exit(main())
