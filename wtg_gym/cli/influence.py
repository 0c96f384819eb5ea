"""`wtg-gym analyse influence`: the influence of every parameter on nadir, RoCoF and rotor speed."""

from __future__ import annotations

import argparse

import numpy as np

from wtg_gym.analysis.influence_study import MEASURES, Influences, influences_table, measure_influences
from wtg_gym.cli.output import PLOT_SUFFIXES, check_page, check_plot_file, give_text, write_and_say
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.suites_command import case_seed, suite_name
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite

_MEASURES = "\n".join(f"  {name:12} [{unit}] {text}" for name, (unit, _, text) in MEASURES.items())
_DESCRIPTION = f"""\
What one per cent more of each parameter of the plant and of the law does to a run, from the gradient at the run itself:
one pass back gives the effects of all parameters. Measured are, at the ends of control steps,
{_MEASURES}
Parameters are those of docs/parameters.md that act on a run and not on the equilibrium before it; a machine's begins
with its bus. law.k_min … law.tau_s are those of all groups in common; law.k_nominal moves the equilibrium too, and its
effect is the difference of two runs. At a corner of a limit effects are those on one side. With several seeds they are
means, and lines in the figure go from the least to the largest.

The gradient is compiled once (half a minute)."""

_EXAMPLES = """\
  wtg-gym analyse influence                                              the paper's load increase
  wtg-gym analyse influence --case load-decrease --strategy deloaded-5 --rows 30
  wtg-gym analyse influence --suite low-wind --seed 20003 --json
  wtg-gym analyse influence --suite standard --seed 20000-20019 --plot influence.png"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym analyse influence`."""
    parser = add_command(commands, "influence", run, description=_DESCRIPTION, examples=_EXAMPLES)
    cases = ", ".join(case.name for case in get_suite("paper").cases)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--case", metavar="NAME", help=f"case of the paper: {cases} (default: load-increase)")
    what.add_argument(
        "--suite", type=suite_name, metavar="NAME", help="suite to draw from: standard, standard-v1, low-wind, …"
    )
    parser.add_argument(
        "--seed", metavar="N[-M]", help="seed of the suite, or its seeds from N to M (default: its first test seed)"
    )
    parser.add_argument(
        "--strategy",
        default=REFERENCE_STRATEGY,
        metavar="NAME",
        help=f"law of all groups: {', '.join(STRATEGIES)}, or a .toml file (default: {REFERENCE_STRATEGY})",
    )
    parser.add_argument("--rows", type=int, default=15, metavar="N", help="parameters to show (default: 15)")
    out = parser.add_argument_group("output")
    out.add_argument("--plot", metavar="FILE", help=f"bars as a figure: {', '.join(PLOT_SUFFIXES)}")
    out.add_argument("--page", metavar="FILE", help="Markdown file with markers 'influence' to put the table between")
    out.add_argument("--json", action="store_true", help="print every effect as JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym analyse influence`."""
    plot, page = check_plot_file(arguments.plot), check_page("--page", arguments.page, "influence")
    if arguments.rows < 1:
        raise ValueError(f"--rows = {arguments.rows} is outside the allowed range: 1 or more")
    suite = get_suite(arguments.suite or "paper")
    settings = EnvSettings(suite=suite.name, strategy=arguments.strategy)
    n_turbines = [group.n_turbines for group in suite.plant.groups]
    seeds = _seeds(arguments)
    scenarios = [suite.scenario(seed, n_wtg=len(n_turbines), n_turbines=n_turbines) for seed in seeds]
    with Progress("scenarios") as progress:
        found = measure_influences(settings, scenarios, lambda done: progress.update("influence", done, len(scenarios)))
    text = f"{_summary(found, arguments)}\n\n{influences_table(found, arguments.rows)}"
    if plot is not None:
        from wtg_gym.plotting import figure_bytes, plot_influences

        write_and_say(plot, figure_bytes(plot_influences(found, arguments.rows), plot.suffix.lower()))
    give_text(page, "influence", text, found.to_dict(), as_json=arguments.json)
    return 0


def _seeds(arguments: argparse.Namespace) -> list[int]:
    if arguments.suite is None:
        if arguments.seed is not None:
            raise ValueError(f"--seed {arguments.seed} needs a suite: --suite standard")
        return [case_seed(arguments.case)]
    if arguments.seed is None:
        return [get_suite(arguments.suite).test[0]]
    first, _, last = arguments.seed.partition("-")
    if not first.isdecimal() or not (last or first).isdecimal() or int(last or first) < int(first):
        raise ValueError(f"--seed must be a whole number, or two with a - between, got {arguments.seed!r}")
    seeds = range(int(first), int(last or first) + 1)
    if len(seeds) > 10_000:
        raise ValueError(f"--seed {arguments.seed} are {len(seeds)} seeds; allowed: at most 10000")
    return list(seeds)


def _summary(found: Influences, arguments: argparse.Namespace) -> str:
    nadir, rocof, rotor = np.asarray(found.values).mean(axis=0)
    n = len(found.scenarios)
    what = found.scenarios[0] if n == 1 else f"{n} scenarios of {arguments.suite} from seed {arguments.seed}, means"
    return (
        f"{what}, {arguments.strategy}: nadir {nadir:.3f} Hz, largest RoCoF {rocof:.3f} Hz/s, least rotor speed "
        f"{rotor:.4f} p.u. Effect of one per cent more:"
    )
