"""`python -m conditions`: whether a suite of version v1 is a good problem to learn on, in figures."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from simple_policies import SimplePolicy, simple_policies

from agents.command import Parser, Progress, add_threads_option, check_page, run_command, suite_name, update_page
from baselines.fast_droop import FastDroop
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.evaluation import Entry, Results, evaluate, load_entries
from wtg_gym.evaluation.oracle import OracleCosts
from wtg_gym.evaluation.score import COST_OFFSET
from wtg_gym.evaluation.summary import EntrySummary
from wtg_gym.files import markdown_table
from wtg_gym.physics.layout import Floats
from wtg_gym.scenarios import get_suite

_SECTION = "conditions"
#: Laws whose rotors must keep the paper's order, the safest first.
LAWS = ("coordinated-piecewise", "deloaded-10", "deloaded-5", "mppt")
#: Deviations that take the whole authority of the droops that are tried on each law [Hz].
DROOPS_HZ = (1.0, 0.25, 0.125, 0.0625)
#: Ends of a rotor.
_ROTOR_ENDS = ("stall", "over-speed", "under-speed")
_DESCRIPTION = """\
Measures the conditions under which a suite of version v1 counts as a good problem to learn on, on validation scenarios:
what a feedback gains is support of the frequency; foresight and planning are worth much more than any feedback; no
trivial policy beats the anchor; a step of delay more costs an agent little; every term of the cost matters; failures
are rare but there; the laws keep the paper's order of rotor safety."""
_EXAMPLES = """\
examples:
  python -m conditions --feedbacks agents/policies/linear-feedback-v1 \\
      --oracle results/oracle/standard-v1-validation.json --planners results/planners/standard-v1-validation.json"""


class Condition(NamedTuple):
    """A row of the table."""

    letter: str
    demand: str
    measured: str
    met: bool | None  # None: not measured


class Evidence(NamedTuple):
    """Measures that the conditions are judged by."""

    results: Results  # of laws, rules and feedbacks on validation scenarios, the anchors among them
    feedbacks: Sequence[str]  # names of the tuned feedbacks
    oracle: OracleCosts | None  # costs with foresight; None: not searched
    planners: Results | None  # results of planners; None: not played
    simple: Sequence[SimplePolicy] | None  # trivial policies on top of each anchor's law; None: not played
    n_simple: int  # scenarios that they played, the first ones
    late: Results | None  # results with one more step of delay; None: not played
    agents: Sequence[str]  # names of agents that were trained with random delay


def judged(e: Evidence) -> list[Condition]:
    """Return the conditions (a) … (h) with what was measured."""
    zero, anchor = get_suite(e.results.suite).benchmark.anchors
    rows = {row.name: row for row in e.results.summaries}
    costs = {name: own.mean(axis=0) for name, own in e.results.pinned_costs.items()}
    best = max((rows[name] for name in (*e.feedbacks, anchor)), key=lambda row: row.score.value)
    return [
        _support(e.results, best, zero),
        _foresight(e, costs[anchor]),
        _planning(e, costs, anchor),
        _trivial(e, costs, zero, anchor),
        _delay(e, rows),
        _terms(rows),
        _failures(rows, zero, anchor),
        _rotors(e.results),
    ]


def _deviations(results: Results, name: str) -> Floats:
    episodes = results.episodes_of(name)
    largest = [max(50.0 - e.metrics["nadir_hz"], e.metrics["zenith_hz"] - 50.0) for e in episodes]  # type: ignore[operator]
    return 1000.0 * np.array(largest)


def _support(results: Results, best: EntrySummary, zero: str) -> Condition:
    own, base = ({row.name: row for row in results.summaries}[name].points_by_term for name in (best.name, zero))
    gains = {term: own[term] - base[term] for term in own}
    share = gains["frequency_rocof"] / sum(gains.values())
    medians = [float(np.median(_deviations(results, name))) for name in (best.name, zero)]
    smaller = 1.0 - medians[0] / medians[1]
    return Condition(
        "a",
        "against the zero action, more than half of the best feedback's gain is frequency and RoCoF, and its median "
        "deviation is at least 30 % smaller",
        f"{best.name}: {100 * share:.0f} % of the gain; {medians[1]:.0f} → {medians[0]:.0f} mHz, "
        f"{100 * smaller:.0f} % smaller",
        share > 0.5 and smaller >= 0.3,
    )


def _on(oracle: OracleCosts, results: Results, costs: Floats) -> Floats:
    """Costs of the oracle's scenarios only."""
    place = {seed: i for i, seed in enumerate(results.seeds)}
    return costs[[place[seed] for seed in oracle.seeds]]


def _foresight(e: Evidence, anchor: Floats) -> Condition:
    demand = "the oracle lowers the anchor's mean cost by at least 40 %"
    if e.oracle is None:
        return Condition("b", demand, "not searched", None)
    before, after = float(_on(e.oracle, e.results, anchor).mean()), float(np.mean(e.oracle.oracle))
    lower = 1.0 - after / before
    text = f"{before:.1f} → {after:.1f}, {100 * lower:.0f} % ({len(e.oracle.seeds)} scenarios)"
    return Condition("b", demand, text, lower >= 0.4)


def _planning(e: Evidence, costs: Mapping[str, Floats], anchor: str) -> Condition:
    demand = "of that gap, tuned feedbacks close at most 20 %, a planner without foresight at least 40 %"
    if e.oracle is None or e.planners is None:
        return Condition("c", demand, "not measured", None)
    before = _on(e.oracle, e.results, costs[anchor])
    gap = float(before.mean() - np.mean(e.oracle.oracle))
    closed = {name: float(before.mean() - _on(e.oracle, e.results, costs[name]).mean()) / gap for name in e.feedbacks}
    played = {name: own[0] for name, own in e.planners.pinned_costs.items() if name.startswith("planner-")}
    planned = {name: float(before.mean() - _on(e.oracle, e.planners, own).mean()) / gap for name, own in played.items()}
    text = ", ".join(f"{name} {100 * share:.0f} %" for name, share in {**closed, **planned}.items())
    met = all(share <= 0.2 for share in closed.values()) and max(planned.values()) >= 0.4
    return Condition("c", demand, text, met)


def _trivial(e: Evidence, costs: Mapping[str, Floats], zero: str, anchor: str) -> Condition:
    demand = "no constant, relay or one-gain rule scores above 102"
    if e.simple is None:
        return Condition("d", demand, "not played", None)
    logs = {name: float(np.log(costs[name][: e.n_simple] + COST_OFFSET).mean()) for name in (zero, anchor)}
    best = min(e.simple, key=lambda policy: policy.log_cost)
    score = 100.0 * (logs[zero] - best.log_cost) / (logs[zero] - logs[anchor])
    return Condition("d", demand, f"{score:.1f}: {best.description} ({len(e.simple)} tried)", score <= 102.0)


def _delay(e: Evidence, rows: Mapping[str, EntrySummary]) -> Condition:
    demand = "one more step of delay costs an agent that was trained with random delay less than 5 points"
    if e.late is None or not e.agents:
        return Condition("e", demand, "no agent yet", None)
    late = e.late.scores
    losses = {name: rows[name].score.value - late[name].value for name in e.agents}
    text = ", ".join(f"{name} {loss:+.1f}" for name, loss in losses.items())
    return Condition("e", demand, f"points lost: {text}", max(losses.values()) < 5.0)


def _terms(rows: Mapping[str, EntrySummary]) -> Condition:
    """Find for every term the pair that would change places without it and is the furthest apart with it or without."""
    found = dict.fromkeys((term for term in COST_TERMS if term != "effort"), (0.0, "no pair"))
    for term, (widest, _) in found.items():
        for one, other in itertools.permutations(rows.values(), 2):
            ahead = sum(other.mean_cost_terms.values()) - sum(one.mean_cost_terms.values())
            behind = other.mean_cost_terms[term] - one.mean_cost_terms[term] - ahead
            if min(ahead, behind) > widest:
                widest = min(ahead, behind)
                found[term] = widest, f"{one.name} before {other.name}"
    text = "; ".join(f"{term}: {pair}" for term, (_, pair) in found.items())
    return Condition(
        "f",
        "every term of the cost but effort decides the order of some pair of laws or rules",
        text,
        all(apart > 0.0 for apart, _ in found.values()),
    )


def _droops(suite: str) -> list[Entry]:
    """The laws with a droop on k, from a gentle to a far too steep one."""
    benchmark = get_suite(suite).benchmark
    return [
        Entry(
            name=f"{law} with {hz:g} Hz",
            strategy=law,
            policy=FastDroop(hz),
            action_mode="k",
            environment=benchmark.env_id,
            learned=False,
        )
        for law in dict.fromkeys((*LAWS, benchmark.hundred))
        for hz in DROOPS_HZ
    ]


def _failures(rows: Mapping[str, EntrySummary], zero: str, anchor: str) -> Condition:
    own, base = rows[anchor].failures_percent, rows[zero].failures_percent
    return Condition(
        "g",
        "the anchor fails in 0.5 … 5 % of the scenarios, the zero action in at most 8 %",
        f"{own:.1f} %, {base:.1f} %",
        0.5 <= own <= 5.0 and base <= 8.0,
    )


def _rotors(results: Results) -> Condition:
    lost = {
        name: 100.0 * float(np.mean([episode.failure in _ROTOR_ENDS for episode in results.episodes_of(name)]))
        for name in LAWS
    }
    values = list(lost.values())
    return Condition(
        "h",
        "the laws keep the paper's order of rotor safety",
        "rotors lost: " + ", ".join(f"{name} {value:.1f} %" for name, value in lost.items()),
        values == sorted(values),
    )


def table(conditions: Sequence[Condition], results: Results) -> str:
    """Return the conditions as Markdown."""
    words = {True: "yes", False: "**no**", None: "–"}
    rows = [(f"({c.letter})", c.demand, c.measured, words[c.met]) for c in conditions]
    text = markdown_table(("", "condition", "measured", "met"), rows)
    return f"On {len(results.seeds)} {results.split} scenarios of `{results.suite}`:\n\n{text}"


def gathered(
    suite: str,
    *,
    feedbacks: Sequence[Entry],
    agents: Sequence[Entry],
    oracle: OracleCosts | None,
    planners: Results | None,
    n_simple: int,
    n_threads: int | None = None,
) -> Evidence:
    """Play what the conditions need on validation scenarios; trivial policies on the first `n_simple`, 0 for none."""
    laws = [entry for name in LAWS for entry in load_entries(name)]
    entries = [*laws, *load_entries("fast-droop"), *_droops(suite), *feedbacks, *agents]
    with Progress("episodes") as progress:
        options: dict[str, Any] = {"n_threads": n_threads, "on_progress": progress.update}
        results = evaluate(entries, suite, "validation", **options)
        late = None
        if agents:
            delay = get_suite(suite).sensors
            assert delay is not None
            shifted = {"delay_s": [value + 0.1 for value in delay.delay_s]}
            late = evaluate(list(agents), suite, "validation", sensors=shifted, **options)
    simple: list[SimplePolicy] | None = None
    if n_simple:
        simple = [
            policy._replace(description=f"{strategy} with {policy.description}")
            for strategy in get_suite(suite).benchmark.anchors
            for policy in simple_policies(suite, "validation", n_simple, n_threads, strategy=strategy)[1]
        ]
    names = [entry.name for entry in feedbacks]
    return Evidence(results, names, oracle, planners, simple, n_simple, late, [entry.name for entry in agents])


def _check_scenarios(suite: str, oracle: OracleCosts | None, planners: Results | None) -> None:
    """Raise a ValueError if files given are of other scenarios than those that the conditions compare."""
    for what, given in (("oracle", oracle), ("planners", planners)):
        if given is not None and (given.suite, given.split) != (suite, "validation"):
            raise ValueError(f"--{what} is of {given.suite}/{given.split}; {suite}/validation is needed")
    if planners is None:
        return
    if not any(name.startswith("planner-") for name in planners.pinned_costs):
        raise ValueError("--planners holds no planner; docs/studies/planner.py writes such files")
    missing = set() if oracle is None else set(oracle.seeds) - set(planners.seeds)
    if missing:
        raise ValueError(f"--planners lacks {len(missing)} of the oracle's scenarios, such as seed {min(missing)}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m conditions", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument(
        "--suite", type=suite_name, default="standard-v1", metavar="NAME", help="of version v1 (default: standard-v1)"
    )
    parser.add_argument("--feedbacks", nargs="+", default=[], metavar="ENTRY", help="tuned feedbacks")
    parser.add_argument("--agents", nargs="+", default=[], metavar="ENTRY", help="trained with random delay")
    parser.add_argument("--oracle", metavar="FILE", help="of docs/studies/foresight.py")
    parser.add_argument("--planners", metavar="FILE", help="of docs/studies/planner.py")
    parser.add_argument("--simple", type=int, default=200, metavar="N", help="scenarios of trivial policies")
    add_threads_option(parser)
    parser.add_argument("--page", metavar="FILE", help=f"Markdown file with markers '{_SECTION}'")

    def work() -> None:
        given = parser.parse_args(argv)
        page = check_page("--page", given.page, _SECTION)
        benchmark = get_suite(given.suite).benchmark
        oracle = None if given.oracle is None else OracleCosts.read(Path(given.oracle))
        planners = None if given.planners is None else Results.read(Path(given.planners))
        _check_scenarios(given.suite, oracle, planners)
        evidence = gathered(
            given.suite,
            feedbacks=[entry for name in given.feedbacks for entry in load_entries(name, benchmark=benchmark)],
            agents=[entry for name in given.agents for entry in load_entries(name, benchmark=benchmark)],
            oracle=oracle,
            planners=planners,
            n_simple=given.simple,
            n_threads=given.threads,
        )
        text = table(judged(evidence), evidence.results)
        if page is not None:
            update_page(page, {_SECTION: text})
        print(text)

    return run_command(work)


if __name__ == "__main__":
    sys.exit(main())
