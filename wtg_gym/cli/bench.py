"""`wtg-gym bench`: the speed of the environment, in one run with other environments."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wtg_gym.analysis.benchmarks.benchmark_tables import Table, part_tables, rate_table
from wtg_gym.analysis.benchmarks.environments import YARDSTICK
from wtg_gym.analysis.benchmarks.growth import ALL_GROUPS, ALL_MACHINES, GROUPS, MACHINES
from wtg_gym.analysis.benchmarks.parts import PARTS, Benchmark, Results
from wtg_gym.analysis.benchmarks.peers import peer_packages
from wtg_gym.analysis.benchmarks.timing import machine, versions
from wtg_gym.analysis.benchmarks.training import describe_training
from wtg_gym.cli import output
from wtg_gym.cli.parser import Commands, add_command, add_output_options
from wtg_gym.files import markdown_table, read_text
from wtg_gym.progress import Progress
from wtg_gym.ranges import require_range

#: Packages whose versions matter, besides those of the peers.
_PACKAGES = ("gymnasium", "numba", "numpy", "stable-baselines3", "torch")
_PARTS = "\n".join(f"  {name:12}  {words}" for name, words in PARTS.items())
_DESCRIPTION = f"""\
Measures the speed of the environment on this machine. Every case runs several times, in turns, so that a busy spell of
the machine slows all of them alike. The median counts; its ratio to {YARDSTICK} of the same run can be compared with
other machines'.
Episodes' resets are included and actions are drawn beforehand. Missing packages are left out, with a line that says
what to install.

parts:
{_PARTS}

Each new number of groups or machines compiles for half a minute the first time and is cached on disk then; a fresh
folder in NUMBA_CACHE_DIR compiles all of them again, which fills the column of compile times."""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym bench`."""
    parser = add_command(
        commands,
        "bench",
        run,
        description=_DESCRIPTION,
        examples="  wtg-gym bench --only environments\n"
        "  wtg-gym bench --only environments training --seconds 0.5 --repeats 3 --json\n"
        "  wtg-gym bench --only environments training peers --page docs/performance.md\n"
        "  wtg-gym bench --only growth roofline --full --output docs/performance --page docs/performance.md",
    )
    parser.add_argument("--only", nargs="+", choices=tuple(PARTS), metavar="PART", help="parts to measure")
    parser.add_argument("--seconds", type=float, default=1.0, metavar="S", help="per case and repeat (default: 1)")
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="the median of these counts (default: 5)")
    parser.add_argument(
        "--full",
        action="store_true",
        help=f"growth up to {ALL_GROUPS[-1]} groups and {ALL_MACHINES[-1]} machines instead of {GROUPS[-1]} and "
        f"{MACHINES[-1]}",
    )
    add_output_options(
        parser,
        output="write bench.json there, and the figure 'growth' if measured",
        page="Markdown file; a measured part's tables go between the markers 'bench:PART'",
        json="print the result as JSON, and nothing else, on stdout",
    )


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym bench`."""
    seconds = require_range("--seconds", arguments.seconds, 0.01, 600.0, "s")
    if not 1 <= arguments.repeats <= 1000:
        raise ValueError(f"--repeats = {arguments.repeats} is outside the allowed range 1 … 1000")
    parts = [part for part in PARTS if arguments.only is None or part in arguments.only]
    on_page = [] if arguments.page is None else _parts_of_page(arguments.page, parts)
    folder = output.study_folder(arguments.output, draws="growth" in parts)
    benchmark = Benchmark(parts, full=arguments.full)
    # Two bars: the time of compiling says nothing about the runs, whose length is known.
    with Progress("expected s") as progress:
        benchmark.prepare(lambda name, done, total: progress.update(name, done, math.ceil(total)))
    with Progress("expected s") as progress:
        results = benchmark.measure(
            seconds, arguments.repeats, lambda name, done, total: progress.update(name, done, math.ceil(total))
        )
    for line in benchmark.missing:
        output.note(line)
    facts = {"seconds": seconds, "repeats": arguments.repeats, "parts": parts, "missing": benchmark.missing}
    data = output.plain_json({**_as_json(results), **facts})
    if folder is not None:
        from wtg_gym.plotting import plot_growth

        figures = {"growth": plot_growth(results.growth)} if results.growth else {}
        output.write_study(folder, "bench", data, figures, arguments.formats)
    if arguments.page is not None:
        caption = f"{machine()}; median of {arguments.repeats} runs of {seconds:g} s."
        texts = {part: _markdown(part_tables(part, results)) for part in on_page}
        output.update_page(
            Path(arguments.page), {f"bench:{part}": f"{caption}\n\n{text}" for part, text in texts.items() if text}
        )
    if arguments.json:
        output.print_json(data)
    else:
        _print(results)
    return 0


def _parts_of_page(page: str, parts: Sequence[str]) -> list[str]:
    """Return the parts whose markers a page has; a ValueError if it has none, or not in pairs."""
    try:
        text = read_text(Path(page), "file with the markers")
    except ValueError as error:
        raise ValueError(f"--page: {error}") from error
    found = [part for part in parts if f"<!-- bench:{part}:" in text]
    if not found:
        wanted = ", ".join(f"<!-- bench:{part}:start -->" for part in parts)
        raise ValueError(f"--page: {page} has no markers of a measured part: {wanted}, with the same to the end")
    output.check_page("--page", page, *(f"bench:{part}" for part in found))
    return found


def _as_json(results: Results) -> dict[str, Any]:
    roofline = results.roofline
    intensities = ("cache_intensity", "memory_intensity")
    return {
        "machine": machine(),
        "versions": versions((*_PACKAGES, *peer_packages())),
        "training": describe_training() if results.of_part("training") else None,
        "cases": [
            {
                "part": rate.case.part,
                "name": rate.case.name,
                "n_envs": rate.case.n_envs,
                "steps_per_s": rate.per_s,
                "ratio": results.ratio(rate),
                "all": rate.all,
            }
            for rate in results.rates
        ],
        "growth": [{**dataclasses.asdict(curve), "exponent": curve.exponent} for curve in results.growth],
        "roofline": roofline and {**dataclasses.asdict(roofline), **{n: getattr(roofline, n) for n in intensities}},
    }


def _markdown(pieces: Sequence[Table | str]) -> str:
    texts = []
    for piece in pieces:
        if isinstance(piece, Table):
            right = [index for index in range(len(piece.header)) if index not in piece.text]
            texts.append(markdown_table(piece.header, piece.rows, right=right))
        else:
            texts.append(piece)
    return "\n\n".join(texts)


def _print(results: Results) -> None:
    pieces: list[Table | str] = [machine(), rate_table(results, results.rates)]
    if results.of_part("training"):
        pieces.append(describe_training())
    for piece in [*pieces, *part_tables("growth", results), *part_tables("roofline", results)]:
        if isinstance(piece, Table):
            output.print_table(piece.header, piece.rows, left=piece.text)
        else:
            output.say(piece)
        output.say("")
