"""The command of a training: its options, the run that it begins or goes on with, and errors in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter, Token

from agents.run import RUN_FILE, Run, RunSettings, held
from wtg_gym.files import one_line
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.scenarios import DEFAULT_SUITE


def _whole(_: Any, tokens: Sequence[Token]) -> int:
    # Without this, 2.5 would be rounded.
    return int(tokens[0].value)


Whole = Annotated[int, Parameter(converter=_whole)]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """The options that every training shares."""

    output: Path | None = None
    """folder of the new run"""
    resume: Path | None = None
    """go on with the run in this folder, with its own settings"""
    action_mode: Literal["k", "tau", "k+tau"] = "k+tau"
    """what the policy modulates"""
    observation_mode: Literal["local", "privileged"] = "local"
    """what it sees"""
    suite: str = DEFAULT_SUITE
    """suite to train and validate on"""
    strategy: str = REFERENCE_STRATEGY
    """law that the actions modulate"""
    seed: Whole = 0
    """seed of everything random"""
    timesteps: Whole | None = None
    """steps of all environments together; default: the learner's"""
    n_envs: Whole | None = None
    """environments side by side, or scenarios of a generation; default: the learner's"""
    interval: Whole = 0
    """steps between validations; 0: a 20th of all"""
    validation_episodes: Whole = 50
    """scenarios of a validation"""

    def settings(self, algo: str, hyperparameters: Mapping[str, Any], *, timesteps: int, n_envs: int) -> RunSettings:
        """Return the settings of a new run; `timesteps` and `n_envs` are used where no option gives them."""
        options = {key: value for key, value in vars(self).items() if key in RunSettings.__dataclass_fields__}
        named = {key: value for key, value in options.items() if value is not None}
        defaults = {"timesteps": timesteps, "n_envs": n_envs}
        return RunSettings(**{**defaults, **named, "algo": algo, "hyperparameters": hyperparameters})


def note(text: str) -> None:
    """Print a line that is no result: on stderr."""
    print(text, file=sys.stderr)


def run_command(command: Callable[..., None], name: str, argv: Sequence[str] | None, after_interrupt: str) -> int:
    """Run the command `python -m NAME` and return its exit code: 0 fine, 2 bad input, 130 interrupted."""
    words = sys.argv[1:] if argv is None else list(argv)
    app = App(name=f"python -m {name}", help_format="plaintext", version_flags=(), suppress_keyboard_interrupt=False)
    app.default(command)
    try:
        options = {word.partition("=")[0] for word in words if word.startswith("--")}
        if "--resume" in options and (others := sorted(options - {"--resume"})):
            raise ValueError(f"--resume goes on with the run's own settings; leave out {', '.join(others)}")
        app(words, exit_on_error=False, print_error=False, result_action="return_value")
    except (CycloptsError, ValueError, OSError) as error:
        note(f"error: {one_line(error)}")
        return 2
    except KeyboardInterrupt:
        note(f"interrupted; {after_interrupt}")
        return 130
    return 0


def begin_or_go_on(
    options: RunOptions, algos: Container[str], settings: Callable[[], RunSettings], train: Callable[[Run], None]
) -> None:
    """Train in the folder that the options name, which is held meanwhile, and say how it ended.

    Args:
        options: those of the command.
        algos: what the command trains.
        settings: returns the settings of a new run.
        train: trains a run to its end.

    Raises:
        ValueError: the folder cannot be used.
    """
    if options.resume is not None:
        folder, algo = options.resume, Run.read(options.resume).settings.algo
        if algo not in algos:
            raise ValueError(f"{folder} is a run of {algo}: go on with it by the command that began it")
    elif options.output is not None:
        folder, run = options.output, Run.new(options.output, settings())
        if (folder / RUN_FILE).exists():
            raise ValueError(f"{folder} holds a run already; give a new folder, or --resume {folder}")
        folder.mkdir(parents=True, exist_ok=True)
    else:
        raise ValueError("--output FOLDER is needed, or --resume FOLDER")
    with held(folder):
        if options.resume is not None:
            # Read again, now that no other process can change it.
            run = Run.read(folder)
            run.go_on()
        train(run)
    note(f"best validation score {run.best['score']:.1f} at step {run.best['timesteps']}; wrote {folder}")
