"""What the commands of `agents` share: options, runs to begin or to go on with, and errors in one line."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import sys
from collections.abc import Callable, Container, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

from agents.folders import held, new_folder
from agents.runs import Run, RunSettings
from wtg_gym.envs.settings import ACTION_MODES, OBSERVATION_MODES
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.scenarios import DEFAULT_SUITE

#: Options that are settings of a run under the same name.
_SETTINGS = ("action_mode", "observation_mode", "suite", "strategy", "groups", "sensors", "seed", "validation_episodes")


class Parser(argparse.ArgumentParser):
    """A parser whose help keeps its line breaks, and whose errors are a ValueError of one line."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **arguments)

    def error(self, message: str) -> NoReturn:
        """Raise a ValueError instead of printing the usage."""
        raise ValueError(f"{message} (see: {self.prog} --help)")


def note(text: str) -> None:
    """Print a line that is no result: on stderr."""
    print(text, file=sys.stderr)


def run_command(work: Callable[[], None], after_interrupt: str) -> int:
    """Do the work of a command and return its exit code: 0 fine, 2 bad input, 130 interrupted.

    Args:
        work: raises ValueError or OSError for bad input; the message is shown on one line.
        after_interrupt: how to go on after an interruption.
    """
    try:
        work()
    except (ValueError, OSError) as error:
        note(f"error: {' '.join(str(error).split())}")
        return 2
    except KeyboardInterrupt:
        note(f"interrupted; {after_interrupt}")
        return 130
    return 0


def require_package(package: str, requirement: str) -> None:
    """Raise a ValueError that says what to install if a package cannot be imported."""
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise ValueError(f"{package} is needed: pip install {requirement} ({error})") from error


def add_training_options(parser: argparse.ArgumentParser, *, timesteps: str) -> None:
    """Add the options that every training shares; all of them are None where they are not given."""
    add = parser.add_argument
    add("--output", metavar="FOLDER", help="folder of the new run")
    add("--resume", metavar="FOLDER", help="go on with the run in this folder, with its own settings")
    add("--allow-other-versions", action="store_true", default=None, help="resume with other sources or packages")
    add("--action-mode", choices=tuple(ACTION_MODES), help="what the policy modulates (default: k+tau)")
    add("--observation-mode", choices=OBSERVATION_MODES, help="what it sees (default: local)")
    add("--suite", metavar="NAME", help=f"suite to train and validate on (default: {DEFAULT_SUITE})")
    add("--strategy", metavar="NAME", help=f"law that the actions modulate (default: {REFERENCE_STRATEGY})")
    add("--seed", type=int, metavar="N", help="seed of everything random (default: 0)")
    add("--timesteps", type=int, metavar="N", help=f"environment steps in all (default: {timesteps})")
    add("--interval", type=int, metavar="N", help="steps between validations (default: a 20th of all)")
    add("--validation-episodes", type=int, metavar="N", help="scenarios per validation (default: 50)")


def add_plant_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that replace groups and sensors of the suite."""
    parser.add_argument("--groups", type=int, metavar="N", help="WTG groups at bus 2 (default: the suite's)")
    text = "\"exact\", or what replaces the suite's, such as '{\"delay_s\": [0, 0]}' (default: the suite's)"
    parser.add_argument("--sensors", type=_sensors, metavar="VALUES", help=text)


def _sensors(text: str) -> Any:
    """Return the sensors that an option names; the environment says what it takes."""
    with contextlib.suppress(json.JSONDecodeError):
        return json.loads(text)
    return text


def given_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options that are on the command line."""
    return {key: value for key, value in vars(arguments).items() if value is not None}


def settings_of(
    given: Mapping[str, Any], algo: str, hyperparameters: Mapping[str, Any], *, timesteps: int, n_envs: int
) -> RunSettings:
    """Return the settings of a new run, those of its options and these defaults.

    Raises:
        ValueError: a value is unknown or out of range.
    """
    timesteps = given.get("timesteps", timesteps)
    return RunSettings(
        algo=algo,
        hyperparameters=hyperparameters,
        timesteps=timesteps,
        n_envs=given.get("n_envs", n_envs),
        interval=given.get("interval", max(1, timesteps // 20)),
        **{name: given[name] for name in (*_SETTINGS, "device") if name in given},
    )


@contextlib.contextmanager
def opened_run(
    given: Mapping[str, Any], algos: Container[str], settings: Callable[[], RunSettings]
) -> Iterator[tuple[Run, Path]]:
    """Hold the folder of the run that the options name; after the training, say how it ended.

    Args:
        given: options on the command line, those of :func:`add_training_options` among them.
        algos: the algorithms that the command trains.
        settings: returns the settings of a new run.

    Yields:
        the run and its folder.

    Raises:
        ValueError: options do not go together, or the folder cannot be used.
    """
    if "resume" in given:
        others = sorted(given.keys() - {"resume", "allow_other_versions"})
        if others:
            named = ", ".join(f"--{key.replace('_', '-')}" for key in others)
            raise ValueError(f"--resume goes on with the run's own settings; leave out {named}")
        folder = Path(given["resume"])
        # Read once before anything is written into the folder, and again when no other process can change it.
        algo = Run.read(folder).settings.algo
        if algo not in algos:
            raise ValueError(f"{folder} is a run of {algo}: go on with it by the command that began it")
        with held(folder):
            run = Run.read(folder)
            run.go_on(allow_other_versions="allow_other_versions" in given)
            yield run, folder
    else:
        if "output" not in given:
            raise ValueError("--output FOLDER is needed, or --resume FOLDER")
        if "allow_other_versions" in given:
            raise ValueError("--allow-other-versions is for --resume")
        run = Run.new(settings())
        with new_folder(Path(given["output"])) as folder:
            yield run, folder
    note(f"best validation score {run.best['score']:.1f} at step {run.best['timesteps']}; wrote {folder}")
