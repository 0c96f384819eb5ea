"""`wtg-gym evaluate`: entries scored on scenarios of a suite."""

from __future__ import annotations

import argparse
from pathlib import Path

from wtg_gym.cli.draw import add_split_options, chosen_draw
from wtg_gym.cli.output import check_output_folder, note
from wtg_gym.cli.parser import Commands, add_command, add_plant_options
from wtg_gym.cli.scores import (
    add_result_options,
    add_score_options,
    add_worker_options,
    chosen_entries,
    chosen_seeds,
    chosen_workers,
    finish,
    kept_parts,
    run_evaluation,
)
from wtg_gym.evaluation import Policy

_TRUST_HELP = (
    "also take folders with model.zip, an archive of Stable-Baselines3, in the place of policy.onnx, and the key "
    "algorithm in entry.toml. Loading one runs whatever code its maker put in the file, with your rights, and nothing "
    "can check that: only for files that you made yourself. The leaderboard never takes them"
)

_EVALUATE = """\
Plays entries through the scenarios of a suite, many at a time, and scores them: 0 is maximum power point tracking, 100
the reference strategy. Both are always played too, because they fix the scale. With --results, every episode is
written to <suite>-<split>.csv and the description and summary to <suite>-<split>.json; an interrupted evaluation goes
on from its finished parts. An entry whose policy raises, ends, takes too long or gives no action is named with its
reason and left out with all training seeds of its name; the others are ranked, and the exit code is 1. A policy.onnx
plays one scenario at a time, in a process of its own that can only compute and answer. Use another folder than the
leaderboard's for choices of your own."""

_EVALUATE_EXAMPLES = """\
  wtg-gym evaluate --entries deloaded-5 coordinated-linear --suite low-wind
  wtg-gym evaluate --entries my_law.toml --suite standard --seeds 20000:20010 --results my_results
  wtg-gym evaluate --entries my_package.controller:make_policy --split validation --json
  wtg-gym evaluate --entries runs/mine/best/* --trust-pickle
  wtg-gym evaluate --entries policies --backend dask --address tcp://head:8786 --results my_results"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym evaluate`."""
    parser = add_command(
        commands,
        "evaluate",
        _run_evaluate,
        summary="score entries on scenarios of a suite",
        description=_EVALUATE,
        examples=_EVALUATE_EXAMPLES,
        after_interrupt="nothing was written; with --results DIR the finished parts are kept",
    )
    add_score_options(parser)
    add_worker_options(parser)
    add_split_options(parser)
    parser.add_argument("--duration", type=float, metavar="S", help="length of an episode [s] (default: the suite's)")
    add_result_options(parser)
    parser.add_argument("--trust-pickle", action="store_true", help=_TRUST_HELP)
    add_plant_options(parser)


def _run_evaluate(arguments: argparse.Namespace) -> int:
    folder = None if arguments.results is None else check_output_folder("--results", arguments.results)
    partial = kept_parts(folder, arguments)
    workers = chosen_workers(arguments)
    seeds = None if arguments.seeds is None else chosen_seeds(arguments.seeds)
    draw = chosen_draw(arguments)
    # Last, because it takes longest, and may run code.
    entries = chosen_entries(arguments.entries, _load_trusted if arguments.trust_pickle else None)
    results = run_evaluation(
        entries,
        arguments,
        split=arguments.split,
        partial=partial,
        workers=workers,
        seeds=seeds,
        draw=draw,
        duration_s=arguments.duration,
        groups=2 if arguments.groups is None else arguments.groups,
        control_dt=arguments.control_dt,
        simulation_dt=arguments.simulation_dt,
        machine_model=arguments.machine_model,
        on_failure=arguments.on_failure,
    )
    return finish(results, folder, as_json=arguments.json)


def _load_trusted(folder: Path, algorithm: str) -> tuple[Policy, str]:
    # Here, because Stable-Baselines3 is another extra, and takes seconds to import.
    from wtg_gym.sb3_archive import load_archive

    note(f"running the code in the archive of {folder}, as --trust-pickle says")
    return load_archive(folder, algorithm)


__all__ = ["add_commands"]
