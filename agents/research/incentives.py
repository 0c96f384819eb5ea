"""`python -m agents.research.incentives`: the cost terms that the score pays for, and the wind's share of regulation.

Two questions that a table of scores does not answer. Where do entries save cost: in the frequency, or in how closely
they follow the prescribed power? And how much of the system's frequency response could the turbines change at all?
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agents.command import Parser, Progress, add_threads_option, check_page, chosen_entries, run_command, update_page
from agents.research.probes import CONSTANT, delayed
from wtg_gym.evaluation import Entry, EntrySummary, evaluate, leaderboard_rows
from wtg_gym.files import markdown_table
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.reproduce.steady_states import stable_equilibrium
from wtg_gym.scenarios import SPLITS, get_suite

#: The suites with drawn scenarios.
SUITES = ("standard", "weak-grid", "low-wind", "gust")
_SECTION = "incentives"
_COST_COLUMNS = ("suite", "entry", "score", "frequency", "RoCoF", "duty", "overload", "rotor, effort, failure")
_RESPONSE_COLUMNS = ("suite", "governors [MW/Hz]", "wind [MW/Hz]", "wind's share", "wind's share of the inertia")
_DESCRIPTION = f"""\
Plays entries and a constant action through scenarios of the drawn suites, and each policy once more with observations
that are one control step late. Prints scores and mean cost terms, and how much of the frequency response comes from the
wind. With --page the tables go between <!-- {_SECTION}:start --> and <!-- {_SECTION}:end --> of a file."""
_EXAMPLES = """\
examples:
  python -m agents.research.incentives --entries agents/policies/linear-feedback agents/policies/ppo-k-?
  python -m agents.research.incentives --entries agents/policies/linear-feedback --scenarios 10"""


class Response(NamedTuple):
    """Response to a falling frequency."""

    governor_mw_hz: float  # of the governors, rating/(R f_n)
    wind_mw_hz: float  # of all WTG groups under the reference at rest at their mean winds, from ω_st to ω_min
    machine_energy_mws: float  # kinetic energy of the synchronous machines
    wind_energy_mws: float  # H times the rating of all groups: their virtual inertia


def mean_response(scenarios: Sequence[Scenario]) -> Response:
    """Return the mean response in scenarios."""
    return Response(*np.mean([_response(scenario) for scenario in scenarios], axis=0).tolist())


def _response(scenario: Scenario) -> Response:
    settings = PlantSettings()
    case, control, law = settings.case, settings.control, STRATEGIES[REFERENCE_STRATEGY]
    frequencies = control.frequency_setpoint_pu, control.frequency_min_pu
    span_hz = case.frequency_hz * (frequencies[0] - frequencies[1])
    governor = 0.0
    for machine in case.machines:
        if machine.governor is not None:
            droop = scenario.governor_droop or machine.governor.droop_pu
            governor += machine.rating_mva / (droop * case.frequency_hz)
    wind, rated_mw = 0.0, settings.turbine.rated_power_mw
    for group, speed in zip(settings.groups, scenario.wind_speed.mean(axis=1).tolist(), strict=True):
        points = [stable_equilibrium(frequency, law, speed) for frequency in frequencies]
        powers = [0.0 if point is None else point.power_pu for point in points]
        wind += group.n_turbines * rated_mw * (powers[1] - powers[0]) / span_hz
    return Response(
        governor_mw_hz=governor,
        wind_mw_hz=wind,
        machine_energy_mws=scenario.inertia_scale * sum(0.5 * m.two_h_s * m.rating_mva for m in case.machines),
        wind_energy_mws=control.inertia_constant_s * rated_mw * sum(group.n_turbines for group in settings.groups),
    )


def _response_row(suite: str, found: Response) -> tuple[str, ...]:
    total, energy = found.governor_mw_hz + found.wind_mw_hz, found.machine_energy_mws + found.wind_energy_mws
    return (
        suite,
        f"{found.governor_mw_hz:.0f}",
        f"{found.wind_mw_hz:.1f}",
        f"{100 * found.wind_mw_hz / total:.1f} %",
        f"{100 * found.wind_energy_mws / energy:.0f} %",
    )


def _cost_row(suite: str, row: EntrySummary) -> tuple[str, ...]:
    terms = row.mean_cost_terms
    rest = terms["rotor"] + terms["effort"] + terms["failure"]
    shown = (terms["frequency"], terms["rocof"], terms["duty"], terms["overload"], rest)
    name = row.name if row.n_runs == 1 else f"{row.name} ({row.n_runs} seeds)"
    return (suite, name, f"{row.score.value:.1f}", *(f"{value:.2f}" for value in shown))


def incentives(
    entries: Sequence[Entry], split: str, n_scenarios: int | None = None, n_threads: int | None = None
) -> str:
    """Return the tables of costs and of responses as Markdown; a ValueError if there are not that many scenarios."""
    costs, responses, played = [], [], 0
    with Progress("episodes") as progress:
        for done, suite in enumerate(SUITES):
            seeds = list(get_suite(suite).seeds(split))
            if n_scenarios is not None and not 1 <= n_scenarios <= len(seeds):
                raise ValueError(f"--scenarios = {n_scenarios} is outside the allowed range 1 … {len(seeds)}")
            seeds = seeds[:n_scenarios]
            played = len(seeds)

            def tell(name: str, n: int, total: int, suite: str = suite, done: int = done) -> None:
                progress.update(f"{suite}: {name}", done * total + n, len(SUITES) * total)

            results = evaluate(entries, suite, split, seeds=seeds, n_threads=n_threads, on_progress=tell)
            rows = leaderboard_rows(results)
            costs += [_cost_row(suite, row) for row in rows if row.name != results.benchmark.zero]
            responses.append(_response_row(suite, mean_response(get_suite(suite).scenarios(seeds))))
    first = markdown_table(_COST_COLUMNS, costs, right=range(2, len(_COST_COLUMNS)))
    second = markdown_table(_RESPONSE_COLUMNS, responses, right=range(1, len(_RESPONSE_COLUMNS)))
    return (
        f"Mean cost of an episode by term, {played} {split} scenarios of each suite:\n\n{first}\n\n"
        f"Means of the same scenarios, regulating power between 50 and 49.6 Hz, and inertia:\n\n{second}"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.research.incentives", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--entries", nargs="+", required=True, metavar="ENTRY", help="as for wtg-gym evaluate")
    parser.add_argument("--split", choices=SPLITS, default="validation", help="default: validation")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: all)")
    add_threads_option(parser)
    parser.add_argument("--page", metavar="FILE", help=f"Markdown file with markers '{_SECTION}'")

    def work() -> None:
        given = parser.parse_args(argv)
        page = check_page("--page", given.page, _SECTION)
        entries = chosen_entries(given.entries, SUITES[0])
        late = [delayed(entry) for entry in entries if entry.policy is not None]
        text = incentives([*entries, *late, CONSTANT], given.split, given.scenarios, given.threads)
        if page is not None:
            update_page(page, {_SECTION: text})
        print(text)

    return run_command(work)


if __name__ == "__main__":
    sys.exit(main())
