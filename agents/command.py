"""Parts that the commands of `agents` share; nothing else here imports the command line of wtg_gym."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.folders import held, new_folder
from agents.runs import Run, RunSettings
from wtg_gym.cli.output import (
    FIGURE_FORMATS,
    check_output_file,
    check_output_folder,
    check_page,
    note,
    one_line,
    print_table,
    require_extra,
    say,
    update_page,
    write_and_say,
)
from wtg_gym.cli.parser import Parser, add_threads_option
from wtg_gym.cli.scoring import chosen_entries, first_seeds
from wtg_gym.cli.suites_command import suite_name
from wtg_gym.envs.settings import ACTION_MODES, OBSERVATION_MODES
from wtg_gym.evaluation import Results, evaluate
from wtg_gym.files import markdown_table
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.progress import Progress
from wtg_gym.ranges import require_range
from wtg_gym.scenarios import DEFAULT_SUITE

#: What :func:`compare` leaves after an interruption, for :func:`run_command`.
KEPT = "the entries that were complete stay; begin anew in another folder"


def run_command(work: Callable[[], None], after_interrupt: str | None = None) -> int:
    """Do the work of a command and return its exit code: 0 fine, 2 bad input, 130 interrupted.

    Args:
        work: raises ValueError or OSError for bad input; the message is shown.
        after_interrupt: message after an interruption; None to pass the interruption on.
    """
    try:
        work()
    except (ValueError, OSError) as error:
        note(f"error: {one_line(error)}")
        return 2
    except KeyboardInterrupt:
        if after_interrupt is None:
            raise
        note(f"interrupted; {after_interrupt}")
        return 130
    return 0


def require_package(package: str, requirement: str) -> None:
    """Raise a ValueError that says what to install if a package cannot be imported."""
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise ValueError(f"{package} is needed: pip install {requirement} ({error})") from error


def add_strategy_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the law under the actions; None where it is not given."""
    parser.add_argument(
        "--strategy", metavar="NAME", help=f"law that the actions modulate (default: {REFERENCE_STRATEGY})"
    )


def add_training_options(parser: argparse.ArgumentParser, *, timesteps: str) -> None:
    """Add the options that every training shares; all of them are None where they are not given."""
    parser.add_argument("--action-mode", choices=tuple(ACTION_MODES), help="what the policy modulates (default: k+tau)")
    parser.add_argument("--observation-mode", choices=OBSERVATION_MODES, help="what it sees (default: local)")
    parser.add_argument(
        "--suite", type=suite_name, metavar="NAME", help=f"suite to train and validate on (default: {DEFAULT_SUITE})"
    )
    add_strategy_option(parser)
    parser.add_argument("--seed", type=int, metavar="N", help="seed of everything random (default: 0)")
    parser.add_argument("--timesteps", type=int, metavar="N", help=f"environment steps in all (default: {timesteps})")
    parser.add_argument("--interval", type=int, metavar="N", help="steps between validations (default: a 20th of all)")
    parser.add_argument("--validation-episodes", type=int, metavar="N", help="scenarios per validation (default: 50)")


def add_plant_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that replace groups and sensors of the suite."""
    parser.add_argument("--groups", type=int, metavar="N", help="WTG groups at bus 2 (default: the suite's)")
    parser.add_argument(
        "--sensors",
        type=_sensors,
        metavar="VALUES",
        help="\"exact\", or what replaces the suite's, such as '{\"delay_s\": [0, 0]}' (default: the suite's)",
    )


def _sensors(text: str) -> Any:
    """Return the sensors that an option names; the environment says what it takes."""
    with contextlib.suppress(json.JSONDecodeError):
        return json.loads(text)
    return text


def add_folder_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name the folder of a new run or of one to go on with, see :func:`opened_run`."""
    parser.add_argument("--output", metavar="FOLDER", help="folder of the new run")
    parser.add_argument("--resume", metavar="FOLDER", help="go on with the run in this folder, with its own settings")
    parser.add_argument(
        "--allow-other-versions",
        action="store_true",
        default=None,
        help="resume with other sources, suite or packages than before, which run.json then says",
    )


def given_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options that are on the command line."""
    return {key: value for key, value in vars(arguments).items() if value is not None}


def option(key: str) -> str:
    """Return an option as it is typed, by its key."""
    return f"--{key.replace('_', '-')}"


@contextlib.contextmanager
def options_named(given: Mapping[str, Any]) -> Iterator[None]:
    """Name the option in an error that begins with the key of a setting, where the setting was given as an option."""
    try:
        yield
    except ValueError as error:
        key, _, rest = str(error).partition(" ")
        if key not in given:
            raise
        raise ValueError(f"{option(key)} {rest}") from error


def settings_of(
    given: Mapping[str, Any], algo: str, hyperparameters: Mapping[str, Any], *, timesteps: int, n_envs: int
) -> RunSettings:
    """Return the settings of a new run.

    Args:
        given: options on the command line, those of :func:`add_training_options` among them.
        algo, hyperparameters: as for :class:`agents.runs.RunSettings`.
        timesteps: environment steps, unless an option says otherwise.
        n_envs: number of lanes.

    Raises:
        ValueError: a value is unknown or out of range.
    """
    of_env = ("action_mode", "observation_mode", "suite", "strategy", "groups", "sensors")
    names = (*of_env, "seed", "validation_episodes", "device")
    timesteps = given.get("timesteps", timesteps)
    return RunSettings(
        algo=algo,
        hyperparameters=hyperparameters,
        timesteps=timesteps,
        n_envs=n_envs,
        interval=given.get("interval", max(1, timesteps // 20)),
        **{name: given[name] for name in names if name in given},
    )


@contextlib.contextmanager
def opened_run(
    given: Mapping[str, Any], algos: Container[str], settings: Callable[[], RunSettings]
) -> Iterator[tuple[Run, Path]]:
    """Hold the folder of the run that the options name; after the training, say how it ended.

    Args:
        given: options on the command line, those of :func:`add_folder_options` among them.
        algos: the algorithms that the command trains.
        settings: returns the settings of a new run.

    Yields:
        the run and its folder.

    Raises:
        ValueError: options do not go together, or the folder cannot be used.
    """
    allow_other_versions = given.get("allow_other_versions", False)
    if "resume" in given:
        others = sorted(given.keys() - {"resume", "allow_other_versions"})
        if others:
            named = ", ".join(map(option, others))
            raise ValueError(f"--resume goes on with the run's own settings; leave out {named}")
        folder = Path(given["resume"])
        # Read once before anything is written into the folder, and again when no other process can change it.
        run = Run.read(folder)
        if run.settings.algo not in algos:
            raise ValueError(f"{folder} is a run of {run.settings.algo}: go on with it by the command that began it")
        with held(folder):
            run = Run.read(folder)
            run.go_on(allow_other_versions=allow_other_versions)
            yield run, folder
    else:
        if "output" not in given:
            raise ValueError("--output FOLDER is needed, or --resume FOLDER")
        if allow_other_versions:
            raise ValueError("--allow-other-versions is for --resume")
        with options_named(given):
            run = Run.new(settings())
        with options_named(given), new_folder(Path(given["output"])) as folder:
            yield run, folder
    note(f"best validation score {run.best['score']:.1f} at step {run.best['timesteps']}; wrote {folder}")


def add_comparison_options(parser: argparse.ArgumentParser, *, scenarios: int) -> None:
    """Add the options of :func:`compare`."""
    parser.add_argument(
        "--scenarios", type=int, default=scenarios, metavar="N", help=f"to score on (default: {scenarios})"
    )
    parser.add_argument("--page", metavar="FILE", help="put the table between this file's markers")
    parser.add_argument(
        "--output",
        required=True,
        metavar="FOLDER",
        help="new folder for the entries' folders; after an interruption, start anew in another one",
    )


def compare(
    given: argparse.Namespace,
    train: Callable[[Path], Sequence[str | Path]],
    suite: str,
    trained: str,
    markers: str,
    more: Mapping[str, Callable[[Results, str], str]] | None = None,
    split: str = "validation",
) -> None:
    """Train entries, score them on scenarios of a suite, and print a table of them, the best first.

    Args:
        given: options, those of :func:`add_comparison_options` among them, which are checked before anything runs.
        train: writes folders of entries into a folder, and returns the entries to compare.
        suite: name of the suite.
        trained: how the entries were trained, for the line over the table.
        markers: name of the page's markers.
        more: further columns: their heads, and what says the number of an entry by its name.
        split: "validation", whose first scenarios are played, or "train", of which the last ones are: training draws
            from two thousand million.

    Raises:
        ValueError: an option is out of range, or a file or folder cannot be used.
    """
    page = check_page("--page", given.page, markers)
    seeds = first_seeds(suite, split, given.scenarios, last=split == "train")
    with new_folder(Path(given.output)) as folder:
        entries = train(folder)
    results = evaluate(list(entries), suite, split, seeds=seeds)
    more = more or {}
    rows = [
        [
            row.name,
            f"{row.score.value:.1f} ({row.score.low:.1f} … {row.score.high:.1f})",
            *(column(results, row.name) for column in more.values()),
            f"{row.failures_percent:.1f}",
        ]
        for row in sorted(results.summaries, key=lambda row: -row.score.value)
    ]
    header = ["entry", "score", *more, "failures [%]"]
    print_table(header, rows)
    if page is not None:
        table = markdown_table(header, rows, right=range(1, len(header)))
        update_page(page, {markers: f"{trained}; {len(seeds)} scenarios of split {split}:\n\n{table}"})


__all__ = [
    "FIGURE_FORMATS",
    "KEPT",
    "Parser",
    "Progress",
    "add_comparison_options",
    "add_folder_options",
    "add_plant_options",
    "add_strategy_option",
    "add_threads_option",
    "add_training_options",
    "check_output_file",
    "check_output_folder",
    "check_page",
    "chosen_entries",
    "compare",
    "given_options",
    "note",
    "opened_run",
    "options_named",
    "print_table",
    "require_extra",
    "require_package",
    "require_range",
    "run_command",
    "say",
    "settings_of",
    "suite_name",
    "update_page",
    "write_and_say",
]
