"""`python -m agents.shipped`: trains the policies of `agents/policies` again and exports them to a folder of choice."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import NamedTuple

from agents.command import Parser, note, run_command
from agents.runs import RUN_FILE
from wtg_gym.progress import Progress
from wtg_gym.ranges import require_range

_FOLDER = Path(__file__).parent / "policies"
_AUTHORS = "The wtg_gym authors"

_DESCRIPTION = """\
Trains the policies of agents/policies, three or five seeds each, and exports them; without --only or --all, lists them
with the time that the training of each took. A run that is there already goes on from its last checkpoint, or is
exported at once. The output of a run goes to the file NAME.log beside its folder."""


class Shipped(NamedTuple):
    """A set-up that is ranked."""

    key: str  # name of its folders, without the seed
    name: str  # of its row
    description: str
    options: tuple[str, ...]  # of its training
    n_seeds: int = 5  # training seeds, from 0 on
    command: str = "agents.train"


_V0 = ("--suite", "standard")
#: In v1 agents modulate the law that is tuned to the grid.
_V1 = ("--suite", "standard-v1", "--strategy", "coordinated-tuned", "--validation-episodes", "200")
_TAU_CONFIG = "agents/configs/ppo_tau.yml"
SHIPPED = (
    Shipped(
        "ppo-k+tau", "PPO (k, τ)", "PPO that modulates k and τ.", ("--algo", "ppo", "--action-mode", "k+tau", *_V0)
    ),
    Shipped("ppo-k", "PPO (k)", "PPO that modulates k alone.", ("--algo", "ppo", "--action-mode", "k", *_V0)),
    Shipped(
        "ppo-tau",
        "PPO (τ)",
        "PPO that modulates τ alone.",
        ("--algo", "ppo", "--action-mode", "tau", "--config", _TAU_CONFIG, *_V0),
    ),
    Shipped(
        "sac-k+tau", "SAC (k, τ)", "SAC that modulates k and τ.", ("--algo", "sac", "--action-mode", "k+tau", *_V0)
    ),
    Shipped("ppo-v1", "PPO", "PPO on top of the tuned law.", ("--algo", "ppo", *_V1), 3),
    Shipped(
        "recurrent-ppo-v1",
        "recurrent PPO",
        "PPO with LSTMs on top of the tuned law.",
        ("--algo", "recurrent_ppo", *_V1),
        3,
    ),
    Shipped("sac-v1", "SAC", "SAC on top of the tuned law.", ("--algo", "sac", *_V1), 3),
    Shipped(
        "gradient",
        "gradient MLP (k, τ)",
        "An MLP trained by gradients of whole episodes.",
        ("--validation-episodes", "100", *_V0),
        command="agents.gradient",
    ),
    Shipped(
        "gradient-v1",
        "gradient LSTM",
        "An LSTM on top of the tuned law, trained by gradients of whole episodes.",
        ("--lstm", "32", "--hidden", "32", *_V1, "--timesteps", "2880000"),
        command="agents.gradient",
    ),
)


def names() -> dict[str, tuple[Shipped, int]]:
    """Return set-up and training seed of every policy by the name of its folder."""
    return {f"{shipped.key}-{seed}": (shipped, seed) for shipped in SHIPPED for seed in range(shipped.n_seeds)}


def _time_taken(name: str) -> str:
    """Return how long the training of a policy took [s], as its model card says."""
    card = (_FOLDER / name / "README.md").read_text(encoding="utf-8")
    found = re.search(r"^\| wall time \| ([\d,]+) s", card, re.MULTILINE)
    return found[1] if found else "unknown"


def _make(name: str, runs: Path, policies: Path) -> None:
    """Train a policy and export it.

    Raises:
        ValueError: one of the two commands failed; the message names the log.
    """
    shipped, seed = names()[name]
    run, log = runs / name, runs / f"{name}.log"
    new = [*shipped.options, "--seed", str(seed), "--output", str(run)]
    described = ["--name", shipped.name, "--description", shipped.description, "--authors", _AUTHORS]
    commands = (
        [shipped.command, *(["--resume", str(run)] if (run / RUN_FILE).is_file() else new)],
        ["agents.export", str(run), "--output", str(policies / name), "--overwrite", *described],
    )
    # Several trainings at a time on one thread each are faster than one after another on all of them.
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with log.open("a", encoding="utf-8") as stream:
        for command in commands:
            done = subprocess.run([sys.executable, "-m", *command], stdout=stream, stderr=stream, env=environment)
            if done.returncode:
                raise ValueError(f"{' '.join(command)} failed; its last words are in {log}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.shipped", description=_DESCRIPTION)
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--only", nargs="+", metavar="NAME", help="train these")
    chosen.add_argument("--all", action="store_true", help="train all of them")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="trainings at a time, 1 … 64 (default: 1)")
    parser.add_argument("--runs", default="runs", metavar="FOLDER", help="of the runs (default: runs)")
    parser.add_argument(
        "--policies", default="runs/policies", metavar="FOLDER", help="of the exports (default: runs/policies)"
    )

    def work() -> None:
        given = parser.parse_args(argv)
        if not given.only and not given.all:
            for name, (shipped, _) in names().items():
                print(f"{name:20}  {shipped.name:20}  training took {_time_taken(name)} s")
            return
        chosen = list(names()) if given.all else list(dict.fromkeys(given.only))
        unknown = [name for name in chosen if name not in names()]
        if unknown:
            raise ValueError(f"--only: unknown {', '.join(unknown)}; known: {', '.join(names())}")
        require_range("--jobs", given.jobs, 1, 64, "")
        runs, policies = Path(given.runs), Path(given.policies)
        runs.mkdir(parents=True, exist_ok=True)
        with Progress("policies") as progress, ThreadPoolExecutor(given.jobs) as pool:
            progress.update("training", 0, len(chosen))
            made = {pool.submit(_make, name, runs, policies): name for name in chosen}
            for done, future in enumerate(as_completed(made), start=1):
                future.result()
                progress.update(f"made {made[future]}", done, len(chosen))
        note(f"wrote {len(chosen)} policies to {policies}")

    return run_command(work, "the same command goes on")


if __name__ == "__main__":
    sys.exit(main())
