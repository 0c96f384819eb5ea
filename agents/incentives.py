"""`python -m agents.incentives`: which terms of the cost the score pays for, and how much the wind regulates.

Two questions that a table of scores does not answer. Where do entries save cost: in the frequency, or in how closely
they follow the prescribed power? And how much of the system's frequency response could the turbines change at all?
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agents.command import run_command
from agents.probes import CONSTANT, delayed, late_name
from wtg_gym.analysis.steady_states import stable_equilibrium
from wtg_gym.cli.output import Progress, check_page, update_page
from wtg_gym.cli.parser import Parser
from wtg_gym.cli.scores import chosen_entries
from wtg_gym.evaluation import ANCHORS, Entry, EntrySummary, evaluate, leaderboard_rows
from wtg_gym.files import markdown_table
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.scenarios import SPLITS, get_suite

#: The suites with drawn scenarios.
SUITES = ("standard", "weak-grid", "low-wind", "gust")
_SECTION = "incentives"
_COST_COLUMNS = ("suite", "entry", "score", "frequency", "RoCoF", "duty", "overload", "rotor, effort, failure")
_RESPONSE_COLUMNS = ("suite", "governors [MW/Hz]", "wind [MW/Hz]", "wind's share", "wind's share of the inertia")
_DESCRIPTION = f"""\
Plays entries, each policy among them once more with observations that are one control step late, and a constant action
through scenarios of the drawn suites. Prints scores and mean cost terms, and how much of the frequency response comes
from the wind. With --page the tables go between <!-- {_SECTION}:start --> and <!-- {_SECTION}:end --> of a file."""
_EXAMPLES = """\
examples:
  python -m agents.incentives --entries agents/policies/linear-feedback agents/policies/ppo-k-?
  python -m agents.incentives --entries agents/policies/linear-feedback --scenarios 10"""


@dataclass(frozen=True, kw_only=True)
class Response:
    """What answers a falling frequency in the scenarios of a suite, in the mean over them.

    Args:
        governor_mw_hz: of the governors, rating/(R f_n) [MW/Hz].
        wind_mw_hz: of all WTG groups under the reference at rest at their mean winds, from ω_st to ω_min [MW/Hz].
        machine_energy_mws: kinetic energy of the synchronous machines [MW s].
        wind_energy_mws: H times the rating of all groups: their virtual inertia [MW s].
    """

    governor_mw_hz: float
    wind_mw_hz: float
    machine_energy_mws: float
    wind_energy_mws: float


def response(scenario: Scenario) -> Response:
    """Return what answers a falling frequency in one scenario."""
    settings = PlantSettings()
    case, control, law = settings.case, settings.control, STRATEGIES[REFERENCE_STRATEGY]
    span_hz = case.frequency_hz * (control.frequency_setpoint_pu - control.frequency_min_pu)
    governor = 0.0
    for machine in case.machines:
        if machine.governor is not None:
            droop = scenario.governor_droop or machine.governor.droop_pu
            governor += machine.rating_mva / (droop * case.frequency_hz)
    wind = 0.0
    for group, speed in zip(settings.groups, scenario.wind_speed.mean(axis=1).tolist(), strict=True):
        points = [
            stable_equilibrium(frequency, law, speed)
            for frequency in (control.frequency_setpoint_pu, control.frequency_min_pu)
        ]
        powers = [0.0 if point is None else point.power_pu for point in points]
        wind += group.n_turbines * settings.turbine.rated_power_mw * (powers[1] - powers[0]) / span_hz
    rated_mw = settings.turbine.rated_power_mw * sum(group.n_turbines for group in settings.groups)
    return Response(
        governor_mw_hz=governor,
        wind_mw_hz=wind,
        machine_energy_mws=scenario.inertia_scale * sum(0.5 * m.two_h_s * m.rating_mva for m in case.machines),
        wind_energy_mws=control.inertia_constant_s * rated_mw,
    )


def mean_response(scenarios: Sequence[Scenario]) -> Response:
    """Return the means over scenarios."""
    found = [response(scenario) for scenario in scenarios]
    names = ("governor_mw_hz", "wind_mw_hz", "machine_energy_mws", "wind_energy_mws")
    return Response(**{name: float(np.mean([getattr(row, name) for row in found])) for name in names})


def response_row(suite: str, found: Response) -> tuple[str, ...]:
    """Return a suite's row of the second table."""
    total, energy = found.governor_mw_hz + found.wind_mw_hz, found.machine_energy_mws + found.wind_energy_mws
    return (
        suite,
        f"{found.governor_mw_hz:.0f}",
        f"{found.wind_mw_hz:.1f}",
        f"{100 * found.wind_mw_hz / total:.1f} %",
        f"{100 * found.wind_energy_mws / energy:.0f} %",
    )


def cost_row(suite: str, row: EntrySummary) -> tuple[str, ...]:
    """Return an entry's row of the first table."""
    terms = row.mean_cost_terms
    rest = terms["rotor"] + terms["effort"] + terms["failure"]
    shown = (terms["frequency"], terms["rocof"], terms["duty"], terms["overload"], rest)
    name = row.name if row.n_runs == 1 else f"{row.name} ({row.n_runs} seeds)"
    return (suite, name, f"{row.score.value:.1f}", *(f"{value:.2f}" for value in shown))


def delays(suite: str, rows: Sequence[EntrySummary]) -> str:
    """Return the scores of a suite with exact observations and one control step late, as text."""
    scores = {row.name: row.score.value for row in rows}
    pairs = [(name, value, scores.get(late_name(name))) for name, value in scores.items()]
    found = [f"{name} {value:.1f} → {late:.1f}" for name, value, late in pairs if late is not None]
    return f"`{suite}`: {', '.join(found) or 'none'}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.incentives", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--entries", nargs="+", required=True, metavar="ENTRY", help="as for wtg-gym evaluate")
    parser.add_argument("--split", choices=SPLITS, default="validation", help="default: validation")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N of the split (default: all)")
    parser.add_argument("--threads", type=int, metavar="N", help="threads to step with (default: one per processor)")
    parser.add_argument("--page", metavar="FILE", help=f"Markdown file with markers '{_SECTION}'")
    return run_command(lambda: _incentives(parser.parse_args(argv)))


def _incentives(given: argparse.Namespace) -> None:
    page = check_page("--page", given.page, _SECTION)
    entries = chosen_entries(given.entries)
    late = [delayed(entry) for entry in entries if entry.policy is not None]
    text = incentives([*entries, *late, CONSTANT], given.split, given.scenarios, given.threads)
    if page is not None:
        update_page(page, {_SECTION: text})
    print(text)


def incentives(
    entries: Sequence[Entry], split: str, n_scenarios: int | None = None, n_threads: int | None = None
) -> str:
    """Return both tables as Markdown.

    Args:
        entries: competitors.
        split: whose scenarios.
        n_scenarios: how many, the first ones; None for all.
        n_threads: threads to step with; None for one per processor.

    Raises:
        ValueError: there are not that many scenarios.
    """
    costs, responses, late, shares, played = [], [], [], [], 0
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
            costs += [cost_row(suite, row) for row in rows if row.name != ANCHORS[0]]
            late.append(delays(suite, rows))
            found = mean_response(get_suite(suite).scenarios(seeds))
            responses.append(response_row(suite, found))
            shares.append(f"{found.wind_mw_hz:.0f} of {found.governor_mw_hz + found.wind_mw_hz:.0f} on `{suite}`")
    first = markdown_table(_COST_COLUMNS, costs, right=range(2, len(_COST_COLUMNS)))
    second = markdown_table(_RESPONSE_COLUMNS, responses, right=range(1, len(_RESPONSE_COLUMNS)))
    return (
        f"Score with exact observations → one control step late. {'; '.join(late)}.\n\n"
        f"Regulating power of the wind in MW/Hz: {', '.join(shares)}.\n\n"
        f"Mean cost of an episode by term, {played} {split} scenarios of each suite:\n\n{first}\n\n"
        f"Regulating power between 50 and 49.6 Hz and inertia in the same scenarios, means:\n\n{second}"
    )


__all__ = ["Response", "cost_row", "incentives", "main", "mean_response", "response", "response_row"]


if __name__ == "__main__":
    sys.exit(main())
