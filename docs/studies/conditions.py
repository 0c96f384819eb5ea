"""Whether standard-v1 is a good problem to learn on, in figures.

    python docs/studies/conditions.py [--output DOCS]

measures the conditions of docs/benchmark.md, each by a function below, on validation scenarios; what is tuned or
trained is not touched. It keeps what it plays in results/conditions, from where the next call goes on. An hour on two
processors; the tests call it with a smaller effort.
"""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from changed import longer, played, without_governor
from commissioning import DURATION_S, LAST_MACHINE, ROUNDING, aftermath, statics, worst_events
from oracle import Effort, find_oracle
from output import folder as output_folder
from planner import Planning, with_planners
from rollouts import Rollouts
from trivial import Rule, simple_rules, together

from baselines.fast_droop import FastDroop
from wtg_gym.evaluation import Entry, Results, evaluate, load_entries
from wtg_gym.evaluation import markdown_table as ranking_table
from wtg_gym.evaluation.score import gains, score_scales
from wtg_gym.evaluation.statistics import share_difference
from wtg_gym.evaluation.summary import EntrySummary, lost_or_beyond, runs_by_name
from wtg_gym.evaluation.table import notes_on_marks
from wtg_gym.files import markdown_table, sha256, update_between_markers
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import GroupTrip
from wtg_gym.physics.tracking_law import get_law
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks.cost import COST_TERMS, frequency_cost
from wtg_gym.tasks.observation import N_MEASURED

SUITE = "standard-v1"
PARTIAL = Path("results/conditions")
ZERO, ANCHOR = get_suite(SUITE).task.anchors
#: Laws whose rotors must keep the paper's order, the safest first.
LAWS = ("coordinated-piecewise", "deloaded-10", "deloaded-5", "mppt")
#: Deviations that take the whole authority of the droops that are tried on each law [Hz].
DROOPS_HZ = (1.0, 0.5, 0.25, 0.0625)
#: How long before the end a clock switches, from when on, and on which droop [s, Hz].
CLOCKS_S, CLOCK_HZ = (10.0, 20.0, 30.0), 0.5
#: Training seeds from this place on are fresh for laws: tuning takes the first ones.
FRESH_FROM = 500_000
#: Trivial policies that are played at once.
AT_ONCE = 24
#: Standard errors beyond which two numbers differ.
BEYOND = 2.0


@dataclass(frozen=True, kw_only=True)
class Size:
    """How much is played. A multiple of 15 seeds holds as many of each stratum, and of each kind of extreme event."""

    n_scenarios: int = 300  # of validation
    n_searched: int = 45  # those by oracle and planners
    n_sieved: int = 45  # those that choose among trivial policies
    every: int = 1  # take every n-th trivial policy
    n_parts: int = 150  # those with a part switched off
    n_test: int = 900
    n_fresh: int = 4005
    generations: int = 100  # of the oracle
    planning: Planning = Planning()
    aftermath_s: float = DURATION_S


class Condition(NamedTuple):
    """A row of the table."""

    letter: str
    demand: str
    measured: str
    met: bool | None  # None where there is nothing to measure


class Entries(NamedTuple):
    """Who plays."""

    laws: list[Entry]  # baselines: laws and feedbacks made by hand
    feedbacks: list[Entry]  # tuned ones
    agents: list[Entry]
    droops: list[Entry]  # one gain on each law

    @property
    def ranked(self) -> list[Entry]:
        """Those of the leaderboard."""
        return [*self.laws, *self.feedbacks, *self.agents]


def all_entries() -> Entries:
    """Return the entries that there are; policies may be missing."""
    task = get_suite(SUITE).task
    policies = [each for each in load_entries("policies", task) if each.environment == task.env_id]
    tuned = [each for each in policies if each.name.endswith("-feedback")]
    droops = [
        droop(f"{law} with {hz:g} Hz", law, FastDroop(hz)) for law in dict.fromkeys((*LAWS, ANCHOR)) for hz in DROOPS_HZ
    ]
    return Entries(load_entries("baselines", task), tuned, [e for e in policies if e not in tuned], droops)


def droop(name: str, strategy: str, policy: Any) -> Entry:
    """Return an entry that moves k alone."""
    env_id, own = get_suite(SUITE).task.env_id, sha256(repr(sorted(vars(policy).items())).encode())
    modes = {"action_mode": "k", "environment": env_id, "learned": False}
    source = sha256(inspect.getsource(type(policy)).encode())
    fingerprint = f"{type(policy).__name__} {source} {own}"
    return Entry(name=name, strategy=strategy, policy=policy, fingerprint=fingerprint, **modes)


def points(costs: Mapping[str, Floats], scale: Results) -> dict[str, Floats]:
    """Return the points of every scenario by the anchors of `scale`, (n_scenarios,), in mean over training seeds.

    Args:
        costs: pinned costs by the entry's name, (n_runs, n_scenarios).
        scale: results of the same scenarios. The mean over its strata, :func:`mean_and_error`, is the score.
    """
    zero, hundred = (scale.pinned_costs[name][0] for name in (ZERO, ANCHOR))
    scales = np.empty(len(scale.seeds))
    for own, value in zip(scale.groups.values(), score_scales(zero, hundred, scale.task, scale.groups), strict=True):
        scales[own] = value
    gained = {name: gains(own, hundred, scale.cost_offsets) for name, own in costs.items()}
    return {name: 100.0 * (1.0 + own.mean(axis=0) / scales) for name, own in gained.items()}


def mean_and_error(values: Floats, results: Results) -> tuple[float, float]:
    """Return the mean over strata of :func:`points`, or of their differences, and its standard error."""
    own = [values[group] for group in results.groups.values()]
    error = np.sqrt(sum(part.var(ddof=1) / part.size for part in own)) / len(own)
    return float(np.mean([part.mean() for part in own])), float(error)


def by_name(results: Results) -> dict[str, EntrySummary]:
    return {row.name: row for row in results.summaries}


def first(results: Results, n: int) -> Results:
    """Return the results of the first n scenarios alone."""
    seeds = results.seeds[:n]
    return replace(results, seeds=seeds, episodes=tuple(e for e in results.episodes if e.seed in set(seeds)))


def mean_terms(results: Results, name: str) -> dict[str, float]:
    episodes = results.episodes_of(name)
    return {term: float(np.mean([each.metrics[f"cost_{term}"] for each in episodes])) for term in COST_TERMS}


# --- the conditions --------------------------------------------------------------------------------------------------


def support(results: Results, names: Sequence[str]) -> Condition:
    rows = by_name(results)
    best = max((rows[name] for name in (*names, ANCHOR)), key=lambda row: row.score.value)
    paid, base = (mean_terms(results, name) for name in (best.name, ZERO))
    saved = {term: base[term] - paid[term] for term in COST_TERMS}
    served = sum(saved[term] for term in ("frequency", "rocof", "failure")) / sum(saved.values())
    before, after = rows[ZERO].median_deviation_mhz, best.median_deviation_mhz
    smaller = 1.0 - after / before
    return Condition(
        "a",
        "more than half of the mean cost that the best feedback saves the zero action is frequency, RoCoF and load not "
        "served; the median deviation is at least 30 % smaller",
        f"{best.name}: {100 * served:.0f} % of the cost; {before:.0f} → {after:.0f} mHz, {100 * smaller:.0f} % smaller",
        served > 0.5 and smaller >= 0.3,
    )


def foresight_and_planning(oracle: Mapping[str, Any], searched: Results, feedbacks: Sequence[str]) -> list[Condition]:
    def means(costs: Floats) -> Floats:
        """Of the strata, and their mean."""
        own = [costs[group].mean() for group in searched.groups.values()]
        return np.array([*own, np.mean(own)])

    def said(shares: Floats) -> str:
        own = zip((*searched.groups, "all"), shares, strict=True)
        return ", ".join(f"{name} {100.0 * share:.0f}" for name, share in own) + " %"

    costs = {name: means(own.mean(axis=0)) for name, own in searched.pinned_costs.items()}
    best, before = means(np.array(oracle["oracle"])), costs[ANCHOR]
    plans = [name for name in costs if name.startswith("planner-")]
    closed = {name: (before - costs[name]) / (before - best) for name in (*feedbacks, *plans)}
    # Strata count alike, as in the score.
    share, lower = {name: own[:-1].mean() for name, own in closed.items()}, 1.0 - best / before
    n = len(searched.seeds)
    return [
        Condition(
            "b",
            "the oracle lowers the anchor's mean cost by at least 40 %, in mean over the strata",
            f"{said(lower)} ({n} scenarios)",
            lower[:-1].mean() >= 0.4,
        ),
        Condition(
            "c",
            "tuned feedbacks close at most 20 % of that gap, a planner without foresight at least 40 %, in mean over "
            "the strata; planners and oracle minimise the cost as charged",
            "; ".join(f"{name} {100 * share[name]:.0f} %: {said(own)}" for name, own in closed.items()),
            max((share[name] for name in feedbacks), default=0.0) <= 0.2 and max(share[name] for name in plans) >= 0.4,
        ),
    ]


def trivial(results: Results, size: Size) -> Condition:
    """Choose among all on some scenarios, and score the best of each law on all."""
    sieve, found, n_tried = first(results, size.n_sieved), [], 0
    for law in (ZERO, ANCHOR):
        with closing(Rollouts(SUITE, "validation", sieve.seeds, AT_ONCE, strategy=law)) as rollouts:
            rules = simple_rules(rollouts)[:: size.every]
            scores = scores_of(rollouts, rules, sieve)
        n_tried += len(rules)
        best = [rules[place] for place in np.argsort(scores)[::-1][: AT_ONCE // 2]]
        with closing(Rollouts(SUITE, "validation", results.seeds, len(best), strategy=law)) as rollouts:
            scores = scores_of(rollouts, best, results)
        found += [(score, f"{law} with {rule.words}") for score, rule in zip(scores, best, strict=True)]
    score, words = max(found)
    return Condition(
        "d",
        "no constant, relay or one-gain rule scores above 102",
        f"{score:.1f}: {words} ({n_tried} tried)",
        score <= 102.0,
    )


def delay(agents: Sequence[Entry], results: Results) -> Condition:
    later = {"delay_s": [value + 0.1 for value in get_suite(SUITE).sensors.delay_s]}
    late = evaluated(agents, "validation", results.seeds, sensors=later).scores
    losses = {name: results.scores[name].value - late[name].value for name in dict.fromkeys(e.name for e in agents)}
    return Condition(
        "e",
        "one more step of delay costs an agent less than 5 points",
        "points lost: " + ", ".join(f"{name} {loss:+.1f}" for name, loss in losses.items()) if losses else "no agents",
        max(losses.values()) < 5.0 if losses else None,
    )


def terms(results: Results, names: Sequence[str]) -> Condition:
    means = {name: mean_terms(results, name) for name in names}

    def decides(term: str, one: str, other: str) -> bool:
        """Whether the two would change places without the term."""
        ahead = sum(means[other].values()) - sum(means[one].values())
        return means[other][term] - means[one][term] > ahead > 0.0

    wanted = [term for term in COST_TERMS if term != "effort"]
    found = [term for term in wanted if any(decides(term, *pair) for pair in itertools.permutations(names, 2))]
    return Condition(
        "f",
        "every term of the mean cost but effort decides the order of some pair of laws or rules",
        ", ".join(found),
        found == wanted,
    )


def failures(rows: Mapping[str, EntrySummary]) -> Condition:
    own, base = rows[ANCHOR].failures_percent, rows[ZERO].failures_percent
    demand = "the anchor loses the grid in 0.5 … 5 % of the scenarios, the zero action in at most 8 %"
    return Condition("g", demand, f"{own:.1f} %, {base:.1f} %", 0.5 <= own <= 5.0 and base <= 8.0)


def rotors(results: Results) -> Condition:
    scenarios = get_suite(SUITE).scenarios(results.seeds)
    by_event = [sum(isinstance(event, GroupTrip) for event in scenario.events) for scenario in scenarios]
    n_groups = scenarios[0].n_wtg

    def tripped_percent(law: str) -> float:
        """Groups that a protection disconnected, of all."""
        trips = [episode.metrics["tripped_groups"] for episode in results.episodes_of(law)]
        own = [max(trip - event, 0.0) for trip, event in zip(trips, by_event, strict=True)]
        return 100.0 * float(np.mean(own)) / n_groups

    lost = {law: tripped_percent(law) for law in LAWS}
    return Condition(
        "h",
        "the laws keep the paper's order of rotor safety",
        "groups tripped: " + ", ".join(f"{law} {value:.1f} %" for law, value in lost.items()),
        list(lost.values()) == sorted(lost.values()),
    )


def paid_in_full(entries: Entries, results: Results) -> Condition:
    length_s = get_suite(SUITE).duration_s
    clocks = [
        droop(f"clock, {name} {last:g} s", ANCHOR, Stopwatch(round(10.0 * (length_s - last)), on, action))
        for last in CLOCKS_S
        for name, on, action in (("on", True, None), ("off", False, None), ("up", True, 1.0), ("down", True, -1.0))
    ]
    always = f"{ANCHOR} with {CLOCK_HZ:g} Hz"
    ticking = evaluated(clocks, "validation", results.seeds).scores
    best = max(results.scores[name].value for name in (ANCHOR, always))
    earned = max(ticking[clock.name].value for clock in clocks) - best
    rows, later = by_name(results), play_changed(entries.ranked, "validation", results.seeds, change=longer).scores
    change = {name: own.value - rows[name].score.value for name, own in later.items()}
    marked = [value for name, value in change.items() if rows[name].marked]
    return Condition(
        "i",
        "another minute without events changes no score by more than 2 points; a clock that in the last 10, 20 or 30 s "
        "switches a droop on or off, or takes all or none of the authority, earns less than 1 point",
        ", ".join(f"{name} {value:+.1f}" for name, value in change.items())
        + f"; at most {max(map(abs, change.values())):.1f}, with the mark {max(map(abs, marked)):.1f}; "
        f"a clock {earned:+.1f}",
        max(map(abs, change.values())) <= 2.0 and earned < 1.0,
    )


def operator(results: Results) -> Condition:
    runs = runs_by_name(results.episodes)
    shares = {name: lost_or_beyond(own, get_suite(results.suite).nominal_hz) for name, own in runs.items()}
    ranking, wrong, excused, n_pairs = results.ranking, [], [], 0
    for upper, lower in itertools.combinations(ranking, 2):
        more = share_difference(shares[upper.name], shares[lower.name], results.groups)
        n_pairs += more.low > 0.0 or more.high < 0.0
        leads = {name: own.value - lower.strata[name].value for name, own in upper.strata.items()}
        # Justified where the upper one owes all of its lead to ordinary minutes.
        others = sum(lead for name, lead in leads.items() if name != "ordinary")
        if more.low > 0.0:
            figures = ", ".join(f"{name} {lead:+.0f}" for name, lead in leads.items())
            (wrong if others > 0.0 else excused).append(
                f"{upper.name} ({upper.lost_or_beyond_percent:.1f} %) above {lower.name} "
                f"({lower.lost_or_beyond_percent:.1f} %), points: {figures}"
            )
    return Condition(
        "j",
        "of two entries whose shares of lost or beyond-0.8-Hz runs differ significantly, the one with the larger share "
        "is ranked higher only where all of its lead is of the ordinary stratum",
        f"{n_pairs} pairs differ; "
        + ("; ".join(wrong) or "none is ranked otherwise")
        + (f"; only by ordinary minutes: {'; '.join(excused)}" if excused else ""),
        not wrong,
    )


def governor_lost(entries: Entries, results: Results) -> Condition:
    found = play_changed(entries.ranked, "validation", results.seeds, change=without_governor)
    rows, before = by_name(found), by_name(results)
    base = rows[ANCHOR].mean_pinned_cost
    wrong = [n for n, row in rows.items() if n != ANCHOR and row.score.low > 100.0 and row.mean_pinned_cost > base]
    return Condition(
        "k",
        "with the governor lost in all scenarios no entry scores above the anchor (beyond its interval) at a higher "
        "mean cost",
        "score before, then, mean cost to the anchor's: "
        + ", ".join(
            f"{name} {before[name].score.value:.0f}, {row.score.value:.0f}, "
            f"{100.0 * (row.mean_pinned_cost / base - 1.0):+.0f} %"
            for name, row in rows.items()
        )
        + (f"; wrong: {', '.join(wrong)}" if wrong else ""),
        not wrong,
    )


def commissioned(size: Size) -> Condition:
    law, plant = get_law(ANCHOR), get_suite(SUITE).plant
    found = statics(law, plant)
    after = {name: aftermath(law, events, size.aftermath_s) for name, events in worst_events().items()}
    steady = found.capped and found.steepest <= ROUNDING and found.within
    return Condition(
        "l",
        "the anchor: k ≤ K_opt, dP/df ≤ 0 in all steady states, limits kept; ten minutes after the largest load steps, "
        "that upwards without the governor too, and after the trip of the largest group that scenarios lose, no grid "
        "and no rotor is lost",
        f"k ≤ K_opt {'yes' if found.capped else 'no'}, largest dP/df {found.steepest:.2g} p.u./Hz, power "
        f"{found.power:.2f}, torque {found.torque:.2f}, slowest rotor {found.slowest:.2f} p.u.; "
        + "; ".join(
            f"{name}: {own.lowest_hz:.2f} Hz, at last {own.final_hz[0]:.2f} … {own.final_hz[1]:.2f} Hz, rotors lost "
            f"{own.rotors}, grids {own.grids}"
            for name, own in after.items()
        ),
        steady and not any(own.rotors or own.grids for name, own in after.items() if name != LAST_MACHINE),
    )


def public_scores(laws: Sequence[Entry], size: Size) -> Condition:
    suite, found = get_suite(SUITE), {}
    fresh_seeds = suite.train[FRESH_FROM : FRESH_FROM + size.n_fresh]
    for split, seeds in (("test", suite.test[: size.n_test]), ("train", fresh_seeds)):
        results = evaluated(laws, split, seeds)
        # From a bootstrap that draws the scale anew.
        found[split] = {name: (own.value, (own.high - own.low) / 3.92) for name, own in results.scores.items()}
    apart = {}
    for name in (each.name for each in laws if each.name not in (ZERO, ANCHOR)):
        (test, one), (fresh, other) = found["test"][name], found["train"][name]
        apart[name] = f"{test:.1f}, {fresh:.1f}", abs(test - fresh) / np.hypot(one, other)
    return Condition(
        "m",
        f"test scores of laws lie within 2 standard errors of {size.n_fresh} fresh scenarios",
        ", ".join(f"{name} {said} ({errors:.1f})" for name, (said, errors) in apart.items()),
        max(errors for _, errors in apart.values()) <= BEYOND,
    )


def limits_of(**values: float) -> Callable[[Plant], Plant]:
    return lambda plant: replace(plant, limits=replace(plant.limits, **values))


#: How each part of the physics is switched off.
PARTS: dict[str, dict[str, Any]] = {
    "current limit": {"plant": limits_of(current_max_pu=10.0)},
    "load shedding": {"plant": lambda plant: replace(plant, shedding=())},
    "torque limit": {"plant": limits_of(torque_max_pu=10.0)},
    "local frequency": {"by_centre": True},
}


def parts(entries: Entries, results: Results, size: Size) -> Condition:
    with_all = first(results, size.n_parts)
    own = [*entries.laws, *entries.droops]
    decided = {}
    for part, how in PARTS.items():
        costs = play_changed(own, "validation", with_all.seeds, **how).pinned_costs
        before = points({name: with_all.pinned_costs[name] for name in costs}, with_all)
        pairs = changed_pairs(before, points(costs, with_all), with_all)
        decided[part] = f"{len(pairs)} pairs" + (f", such as {pairs[0]}" if pairs else "")
    return Condition(
        "n",
        "current limit, load shedding, torque limit and local frequency each decide the order of some pair of laws or "
        f"rules: without the part it is the other one, and their difference has changed by more than {BEYOND:g} "
        "standard errors",
        "; ".join(f"{part}: {said}" for part, said in decided.items()),
        not any(said.startswith("0") for said in decided.values()),
    )


def changed_pairs(before: Mapping[str, Floats], after: Mapping[str, Floats], results: Results) -> list[str]:
    """Return the pairs whose order changes, the clearest change first."""
    found = []
    for one, other in itertools.combinations(before, 2):
        ahead, behind = (mean_and_error(own[one] - own[other], results)[0] for own in (before, after))
        change, error = mean_and_error((after[one] - after[other]) - (before[one] - before[other]), results)
        if ahead * behind < 0.0 and abs(change) > BEYOND * error:
            found.append((abs(change) / error, f"{one} and {other} ({ahead:+.1f}, without {behind:+.1f})"))
    return [words for _, words in sorted(found, reverse=True)]


def slope(rows: Mapping[str, EntrySummary]) -> Condition:
    costs = [frequency_cost(value) for value in np.linspace(0.0, 1.5, 151).tolist()]
    cheapest = min(rows.values(), key=lambda row: row.mean_pinned_cost)
    own, base = cheapest.lost_or_beyond_percent, rows[ANCHOR].lost_or_beyond_percent
    return Condition(
        "o",
        "the cost grows with the deviation up to 48.5 … 51.5 Hz, and the entry with the least mean cost has no larger "
        "share of lost or beyond-0.8-Hz runs than the anchor",
        f"rate {costs[80]:.0f} at 0.8 Hz, {costs[150]:.0f} at 1.5 Hz; {cheapest.name} {own:.1f} %, the anchor "
        f"{base:.1f} %",
        bool((np.diff(costs) > 0.0).all()) and own <= base,
    )


def scores_of(rollouts: Rollouts, rules: Sequence[Rule], results: Results) -> list[float]:
    """Return the score of each rule on the scenarios of results, by their anchors."""
    found, at_once = [], rollouts.shape[1]
    with Progress("policies") as progress:
        for start in range(0, len(rules), at_once):
            # The last ones are repeated to fill the room.
            own = [rules[min(i, len(rules) - 1)] for i in range(start, start + at_once)]
            costs = rollouts.pinned(rollouts.play(together(own))).T
            scored = points({str(i): cost[np.newaxis] for i, cost in enumerate(costs)}, results)
            found += [mean_and_error(each, results)[0] for each in scored.values()]
            progress.update("trivial policies", min(len(found), len(rules)), len(rules))
    return found[: len(rules)]


# --- what is played --------------------------------------------------------------------------------------------------


class Stopwatch:
    """A droop, or an action, until some step or from then on: before the end nobody has to give back what was lent."""

    def __init__(self, step: int, on: bool, action: float | None = None) -> None:
        self.step, self.on, self.action = step, on, action

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        step = 0 if state is None else state
        own = np.asarray(observation, dtype=np.float64).reshape(len(observation), -1, N_MEASURED + 1)
        acts = FastDroop(CLOCK_HZ).predict(own)[0] if self.action is None else np.full(own.shape[:2], self.action)
        return acts if (step >= self.step) == self.on else 0.0 * acts, step + 1


def evaluated(entries: Iterable[Entry], split: str, seeds: Sequence[int], **settings: Any) -> Results:
    with Progress("episodes") as progress:
        how = {"seeds": list(seeds), "on_progress": progress.update, "partial": PARTIAL, "keep_going": True}
        return evaluate(list(entries), SUITE, split, **how, **settings)


def play_changed(entries: Iterable[Entry], split: str, seeds: Sequence[int], **changes: Any) -> Results:
    return played(list(entries), SUITE, split, seeds, partial=PARTIAL, **changes)


def conditions(entries: Entries, size: Size) -> tuple[list[Condition], Results, Results]:
    """Return the rows of the table, the results, and those with planners."""
    results = evaluated(
        [*entries.ranked, *entries.droops], "validation", get_suite(SUITE).validation[: size.n_scenarios]
    )
    failed = {each["name"] for each in results.failed}
    entries = Entries(*([each for each in own if each.name not in failed] for own in entries))
    names = [each.name for each in entries.ranked]
    ranked = replace(
        results,
        entries=tuple(each for each in results.entries if each["name"] in names),
        episodes=tuple(each for each in results.episodes if each.entry in names),
    )
    rows, feedbacks = by_name(ranked), [each.name for each in entries.feedbacks]
    searched = first(ranked, size.n_searched)
    how = Effort(suite=SUITE, split="validation", strategy=ANCHOR, generations=size.generations)
    oracle = find_oracle(how, searched, PARTIAL)
    searched = with_planners(searched, [replace(size.planning, knowledge=known) for known in ("exact", "measured")])
    found = [
        support(ranked, [each.name for each in (*entries.feedbacks, *entries.laws) if each.policy is not None]),
        *foresight_and_planning(oracle, searched, feedbacks),
        trivial(results, size),
        delay(entries.agents, results),
        terms(results, [each.name for each in (*entries.laws, *entries.droops)]),
        failures(rows),
        rotors(results),
        paid_in_full(entries, results),
        operator(ranked),
        governor_lost(entries, results),
        commissioned(size),
        public_scores([each for each in entries.laws if each.policy is None], size),
        parts(entries, results, size),
        slope(rows),
    ]
    return found, ranked, searched


def strata(results: Results) -> str:
    """Return what every stratum pays: a point in the scale of its costs, and where some entries stand."""
    rows, runs = results.ranking, runs_by_name(results.episodes)
    # The best agent, the best law, and who loses least.
    first_of = {row.kind: row.name for row in reversed(rows)}
    names = [first_of[kind] for kind in ("learned", "law") if kind in first_of]
    names = list(dict.fromkeys([*names, min(rows, key=lambda row: row.lost_or_beyond_percent).name]))
    shed = {
        name: np.mean([[episode.metrics["shed_energy_mwh"] for episode in run] for run in runs[name]], axis=0)
        for name in {ANCHOR, *names}
    }
    costs = {name: results.pinned_costs[name].mean(axis=0) for name in shed}

    def change(values: Mapping[str, Floats], name: str, own: Any) -> str:
        """Of a mean to the anchor's [%], with a standard error of the paired difference."""
        base = values[ANCHOR][own]
        if not base.any():
            return "–"
        away = 100.0 * (values[name][own] - base) / base.mean()
        return f"{away.mean():+.0f} ± {away.std(ddof=1) / len(away) ** 0.5:.0f}"

    zero, hundred = (results.pinned_costs[name][0] for name in (ZERO, ANCHOR))
    scales = score_scales(zero, hundred, results.task, results.groups)
    cells = [
        [
            stratum,
            f"{results.cost_offsets[own][0]:.0f}",
            f"{costs[ANCHOR][own].mean():.0f}",
            f"{shed[ANCHOR][own].mean():.3f}",
            f"{scale:.2f}",
            *(f"{change(costs, name, own)}; {change(shed, name, own)}" for name in names),
        ]
        for (stratum, own), scale in zip(results.groups.items(), scales, strict=True)
    ]
    head = ("", "J0", "mean cost", "load not served [MWh]", "a point [% of J + J0]")
    return markdown_table((*head, *(f"{name} [%]" for name in names)), cells, right=range(1, 5))


def section(found: Sequence[Condition], n_scenarios: int) -> str:
    """Return the table of conditions, with a sentence before it."""
    says = {True: "", False: ": **not met**", None: ": **not measured**"}
    table = markdown_table(
        ("", "condition", "measured"), [(f"({c.letter})", c.demand, c.measured + says[c.met]) for c in found]
    )
    n_met = sum(bool(c.met) for c in found)
    return f"{n_met} of {len(found)} are met on {n_scenarios} validation scenarios of `{SUITE}`:\n\n{table}"


if __name__ == "__main__":
    docs, size = output_folder(__doc__), Size()
    found, ranked, searched = conditions(all_entries(), size)
    update_between_markers(docs / "benchmark.md", section(found, size.n_scenarios), "conditions")
    update_between_markers(docs / "benchmark.md", strata(ranked), "strata")
    rows = searched.ranking
    columns = ("entry", "score", "mean cost", "worst tenth", "median deviation [mHz]")
    notes = (f"{note[0].upper()}{note[1:]}." for note in notes_on_marks(rows))
    text = "\n\n".join((ranking_table(rows, columns), *notes))
    text = f"The first {size.n_searched} validation scenarios of `{SUITE}`:\n\n{text}"
    update_between_markers(docs / "benchmark.md", text, "planners")
