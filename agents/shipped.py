"""`python -m agents.shipped`: trains the policies of `agents/policies` again and exports them to a folder of choice."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from agents.command import make_parser, note, run_command
from agents.runs import RUN_FILE
from wtg_gym.policies.load import ENTRY_FILE
from wtg_gym.policies.submission_folder import parse_submission

_DESCRIPTION = """\
Trains the named policies of agents/policies and exports them to runs/policies; without a name, lists them all. A run
that is there already goes on from its last checkpoint, or is exported at once. Its output goes to runs/NAME.log.
Eight at a time:

  python -m agents.shipped | xargs -P 8 -n 1 python -m agents.shipped"""
_POLICIES = Path(__file__).parent / "policies"
_V0 = "--suite standard"
#: In v1 agents modulate the law that is tuned to the grid.
_V1 = "--suite standard-v1 --strategy coordinated-tuned --validation-episodes 200"
#: What trains a set-up, by the name of its folders, and its number of training seeds.
SHIPPED = {
    "ppo-k+tau": (f"agents.train --algo ppo --action-mode k+tau {_V0}", 5),
    "ppo-k": (f"agents.train --algo ppo --action-mode k {_V0}", 5),
    "ppo-tau": (f"agents.train --algo ppo --action-mode tau --config agents/configs/ppo_tau.yml {_V0}", 5),
    "sac-k+tau": (f"agents.train --algo sac --action-mode k+tau {_V0}", 5),
    "ppo-v1": (f"agents.train --algo ppo {_V1}", 3),
    "recurrent-ppo-v1": (f"agents.train --algo recurrent_ppo {_V1}", 3),
    "sac-v1": (f"agents.train --algo sac {_V1}", 3),
    "gradient": (f"agents.gradient --validation-episodes 100 {_V0}", 5),
    "gradient-v1": (f"agents.gradient --lstm 32 --hidden 32 {_V1} --timesteps 2880000", 5),
}


def commands() -> dict[str, list[str]]:
    """Return what trains every policy, by the name of its folder."""
    return {
        f"{key}-{seed}": [*command.split(), "--seed", str(seed), "--output", f"runs/{key}-{seed}"]
        for key, (command, n_seeds) in SHIPPED.items()
        for seed in range(n_seeds)
    }


def make(name: str) -> None:
    """Train a policy and export it under the name and with the texts that it has now.

    Raises:
        ValueError: one of the two commands failed; the message names the log.
    """
    run, log = Path("runs", name), Path("runs", f"{name}.log")
    module, *new = commands()[name]
    entry = parse_submission((_POLICIES / name / ENTRY_FILE).read_bytes())
    texts = ["--name", entry.name, "--description", entry.description, "--authors", *entry.authors]
    run.parent.mkdir(exist_ok=True)
    # Several trainings at a time on one thread each are faster than one after another on all of them.
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with log.open("a", encoding="utf-8") as stream:
        for command in (
            [module, *(["--resume", str(run)] if (run / RUN_FILE).is_file() else new)],
            ["agents.export", str(run), "--output", f"runs/policies/{name}", "--overwrite", *texts],
        ):
            done = subprocess.run([sys.executable, "-m", *command], stdout=stream, stderr=stream, env=environment)
            if done.returncode:
                raise ValueError(f"{' '.join(command)} failed; its last words are in {log}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = make_parser("agents.shipped", _DESCRIPTION)
    parser.add_argument("names", nargs="*", default=[], metavar="NAME", help="of the policies")

    def work() -> None:
        chosen = parser.parse_args(argv).names
        if unknown := [name for name in chosen if name not in commands()]:
            raise ValueError(f"unknown {', '.join(unknown)}; known: {', '.join(commands())}")
        for name in chosen:
            make(name)
            note(f"wrote runs/policies/{name}")
        if not chosen:
            print("\n".join(commands()))

    return run_command(work, "the same command goes on")


if __name__ == "__main__":
    sys.exit(main())
