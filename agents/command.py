"""What the commands of `agents` share: options, runs to begin or to go on with, and errors in one line."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import sys
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.folders import held
from agents.runs import RUN_FILE, Run, RunSettings
from wtg_gym.envs.settings import ACTION_MODES, OBSERVATION_MODES
from wtg_gym.files import one_line
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.scenarios import DEFAULT_SUITE


def make_parser(prog: str, description: str) -> argparse.ArgumentParser:
    """Return a parser whose help keeps its line breaks, and that leaves out what is not on the command line."""
    return argparse.ArgumentParser(
        prog=f"python -m {prog}",
        description=description,
        allow_abbrev=False,
        argument_default=argparse.SUPPRESS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def note(text: str) -> None:
    """Print a line that is no result: on stderr."""
    print(text, file=sys.stderr)


def run_command(work: Callable[[], None], after_interrupt: str) -> int:
    """Do the work of a command and return its exit code: 0 fine, 2 bad input, 130 interrupted."""
    try:
        work()
    except (ValueError, OSError) as error:
        note(f"error: {one_line(error)}")
        return 2
    except KeyboardInterrupt:
        note(f"interrupted; {after_interrupt}")
        return 130
    return 0


def training_parser(prog: str, description: str, *, timesteps: str) -> argparse.ArgumentParser:
    """Return a parser with the options that every training shares."""
    parser = make_parser(prog, description)
    add = parser.add_argument
    add("--output", metavar="FOLDER", help="folder of the new run")
    add("--resume", metavar="FOLDER", help="go on with the run in this folder, with its own settings")
    add("--action-mode", choices=tuple(ACTION_MODES), help="what the policy modulates (default: k+tau)")
    add("--observation-mode", choices=OBSERVATION_MODES, help="what it sees (default: local)")
    add("--suite", metavar="NAME", help=f"suite to train and validate on (default: {DEFAULT_SUITE})")
    add("--strategy", metavar="NAME", help=f"law that the actions modulate (default: {REFERENCE_STRATEGY})")
    add("--seed", type=int, metavar="N", help="seed of everything random (default: 0)")
    add("--timesteps", type=int, metavar="N", help=f"environment steps in all (default: {timesteps})")
    add("--interval", type=int, metavar="N", help="steps between validations (default: a 20th of all)")
    add("--validation-episodes", type=int, metavar="N", help="scenarios per validation (default: 50)")
    return parser


def settings_of(
    given: Mapping[str, Any], algo: str, hyperparameters: Mapping[str, Any], *, timesteps: int, n_envs: int
) -> RunSettings:
    """Return the settings of a new run: the options that are settings of the same name, and these defaults."""
    named = {key: value for key, value in given.items() if key in RunSettings.__dataclass_fields__}
    defaults = {"timesteps": timesteps, "n_envs": n_envs}
    return RunSettings(**{**defaults, **named, "algo": algo, "hyperparameters": hyperparameters})


def training_command(
    parser: argparse.ArgumentParser,
    argv: Sequence[str] | None,
    algo: str,
    hyperparameters: type[Any],
    train: Callable[[Run, Path], None],
    *,
    timesteps: int,
    n_envs: int,
) -> int:
    """Train as the options of a command say, and return its exit code.

    Args:
        parser, argv: see :func:`training_parser`.
        algo: name of the algorithm.
        hyperparameters: dataclass of them; options of the same name replace its defaults.
        train: trains a run in its folder.
        timesteps, n_envs: defaults of the run.
    """

    def work() -> None:
        given = vars(parser.parse_args(argv))

        def settings() -> RunSettings:
            names = [field.name for field in dataclasses.fields(hyperparameters)]
            chosen = hyperparameters(**{key: given[key] for key in names if key in given})
            return settings_of(given, algo, dataclasses.asdict(chosen), timesteps=timesteps, n_envs=n_envs)

        with opened_run(given, (algo,), settings) as (run, folder):
            train(run, folder)

    return run_command(work, "go on with --resume")


@contextlib.contextmanager
def opened_run(
    given: Mapping[str, Any], algos: Container[str], settings: Callable[[], RunSettings]
) -> Iterator[tuple[Run, Path]]:
    """Hold the folder of the run that the options name; after the training, say how it ended.

    `settings` returns those of a new run, `algos` are what the command trains. Options that do not go together, or a
    folder that cannot be used, are a ValueError.
    """
    if "resume" in given:
        if others := sorted(given.keys() - {"resume"}):
            named = ", ".join(f"--{key.replace('_', '-')}" for key in others)
            raise ValueError(f"--resume goes on with the run's own settings; leave out {named}")
        folder = Path(given["resume"])
        algo = Run.read(folder).settings.algo
        if algo not in algos:
            raise ValueError(f"{folder} is a run of {algo}: go on with it by the command that began it")
    elif "output" in given:
        folder, run = Path(given["output"]), Run.new(settings())
        if (folder / RUN_FILE).exists():
            raise ValueError(f"{folder} holds a run already; give a new folder, or --resume {folder}")
        folder.mkdir(parents=True, exist_ok=True)
    else:
        raise ValueError("--output FOLDER is needed, or --resume FOLDER")
    with held(folder):
        if "resume" in given:
            # Anew, now that no other process can change it.
            run = Run.read(folder)
            for difference in run.go_on():
                note(f"{difference}: the weights may end otherwise than they would have")
        yield run, folder
    note(f"best validation score {run.best['score']:.1f} at step {run.best['timesteps']}; wrote {folder}")
