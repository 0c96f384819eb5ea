"""For docs/benchmark.md: what v1 demands of itself, measured; ten minutes on two processors, with the extra `train`."""

import itertools
from dataclasses import replace

import numpy as np
from output import DOCS

from agents.evolution import Search, largest_deviations_hz
from agents.planner import Course, PlannerOptions, planned
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.evaluation import Entry, Results, evaluate
from wtg_gym.evaluation.evaluator import play_batch
from wtg_gym.evaluation.score import gains
from wtg_gym.evaluation.statistics import sign_test
from wtg_gym.evaluation.summary import lost_or_beyond, pinned_costs
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies import PolicyError
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
LAWS = ("deloaded-10", "coordinated-piecewise", "coordinated-tuned", "coordinated-free", "fast-droop", "distilled-law")
SEEDS = {"evolution": 5, "dagger": 5, "gradient": 2, "ppo": 3}
POLICIES = [f"{name}-v1-{seed}" for name, n_seeds in SEEDS.items() for seed in range(n_seeds)]
FIRST = [f"{name}-v1-0" for name in SEEDS]
#: A network that sees the exact state, and scenarios that a planner with it plays: three seconds of a core each.
EXACT, N_PLANNED = "exact-state-v1-0", 90
#: The law that searches act on, their training scenarios, candidates of a generation, and knots of a course of actions.
LAW, N_SEARCHED, POPULATION, N_KNOTS = "coordinated-free", 90, 12, 12
#: Training scenarios whose bad runs are to be won.
N_WON = 300
SEARCHED = EnvSettings(suite=SUITE, strategy=LAW, reward="cost")
#: Name of a condition, what it demands, what was measured, and whether it holds.
Row = tuple[str, str, str, bool]


def room(results: Results) -> Row:
    """Compare a planner and a network that know the exact state, each with the best law on the same scenarios."""
    exact = next(row for row in results.ranking if row.privileged).name
    seeds = list(get_suite(SUITE).seeds("validation")[:N_PLANNED])
    planner = planned(SUITE, "coordinated-free", seeds, PlannerOptions(futures=0))
    of_planner = evaluate([planner, *LAWS], SUITE, "validation", seeds=seeds, batch=N_PLANNED)
    leads = [against_law(of_planner, "planner"), against_law(results, exact)]
    demand = "with the exact state, without foresight, 10 points above the best law; a fifth fewer bad runs in `short`"
    return "room", demand, "; ".join(text for text, _ in leads), any(holds for _, holds in leads)


def against_law(results: Results, name: str) -> tuple[str, bool]:
    """Return how an entry compares with the best law that nothing was learned for, and whether it leads by enough."""
    law = max((each for each in LAWS if each != "distilled-law"), key=lambda each: results.scores[each].value)
    lead = results.scores[name].value - results.scores[law].value
    strata = {row.name: row.strata for row in results.ranking}
    leads = ", ".join(f"{at} {strata[name][at].value - strata[law][at].value:+.1f}" for at in strata[name])
    bad, of_law = (100.0 * bad_in_short(results, each).mean() for each in (name, law))
    text = f"{name} {lead:+.1f} over {law} ({leads}), {bad:.0f} % bad instead of {of_law:.0f} %"
    return text, bool(lead >= 10.0 and bad <= 0.8 * of_law)


def bad_in_short(results: Results, name: str) -> np.ndarray:
    """Return 1 where an entry's run in `short` is bad, else 0, (n_runs, n_scenarios)."""
    short = [get_suite(SUITE).stratum(seed) == "short" for seed in results.seeds]
    return lost_or_beyond(results.runs[name], get_suite(SUITE).nominal_hz)[:, short]


def paid_in_full(results: Results) -> Row:
    """Play scenarios that last a minute longer to their end, and without it: those of 180 s have other wind."""
    suite, settings = get_suite(SUITE), EnvSettings(suite=SUITE, duration_s=240.0)
    longer = suite.scenarios(list(results.seeds), duration_s=240.0)
    lengths = [longer, [replace(scenario, duration_s=180.0) for scenario in longer]]
    groups = [np.array([suite.stratum(seed) == name for seed in results.seeds]) for name in suite.strata]

    def costs(entry: Entry) -> np.ndarray:
        runs = [play_batch(entry, settings, each, None) for each in lengths]
        return np.array([pinned_costs([run], None)[0] for run in runs if not isinstance(run, PolicyError)])

    (hundred,), changes = load_entries(suite.task.hundred), []
    base, marked = costs(hundred), {row.name for row in results.ranking if row.marked} - {hundred.name}
    offsets = np.tile([suite.cost_offset(scenario) for scenario in longer], (2, 1))
    for group in groups:
        # J0 is of the size of the median cost under the reference, which grows with the length.
        offsets[0, group] *= np.median(base[0, group]) / np.median(base[1, group])
    for entry in (load_entries(spec)[0] for spec in (*LAWS, *FIRST, EXACT)):
        if entry.name in marked:
            runs = zip(costs(entry), base, offsets, strict=True)
            with_it, without = (gains(run[None], law, of_length)[0] for run, law, of_length in runs)
            change = 100.0 / suite.task.scale * (with_it - without)
            error = np.sqrt(sum(change[group].var() / group.sum() for group in groups)) / len(groups)
            changes.append((np.mean([change[group].mean() for group in groups]), 1.96 * error, entry.name))
    changes.sort(key=lambda each: -abs(each[0]))
    demand = "a minute more, with J0 for the longer episode, moves no entry with ✓ by 2 points"
    measured = ", ".join(f"{name} {change:+.1f} ± {error:.1f}" for change, error, name in changes)
    return "paid in full", demand, measured, abs(changes[0][0]) < 2.0


def operator_agrees(results: Results) -> Row:
    """Compare bad runs of every two entries with the mark, of all training seeds."""
    bad = {name: lost_or_beyond(runs, get_suite(SUITE).nominal_hz) for name, runs in results.runs.items()}
    shares = {name: f"{name} ({100.0 * runs.mean():.1f} %)" for name, runs in bad.items()}
    pairs = [
        f"{shares[above.name]} over {shares[below.name]}"
        for above, below in itertools.combinations([row for row in results.ranking if row.marked], 2)
        if sign_test(bad[above.name], bad[below.name]) < 0.05
    ]
    demand = "on test scenarios no entry with ✓ is ranked above one with significantly fewer bad runs (5 %)"
    return "an operator agrees", demand, ", ".join(pairs) or "no such pair", not pairs


def sharp(results: Results) -> Row:
    """Measure the intervals of networks of several seeds on the test scenarios, which entries are ranked by."""
    widths = {row.name: 0.5 * (row.score.high - row.score.low) for row in results.ranking if row.n_runs > 2}
    measured = ", ".join(f"{name} ± {width:.1f}" for name, width in widths.items())
    demand = "on test scenarios intervals of ± 1 for networks of three seeds or more"
    return "sharp", demand, measured, max(widths.values()) <= 1.0


def saves_runs(results: Results) -> Row:
    """Compare bad runs of the best learned entry in `short` with those of every law with the mark, paired."""
    good = {name: 1.0 - bad_in_short(results, name) for name in results.runs}
    best = next(row.name for row in results.ranking if row.kind == "learned" and not row.privileged)
    laws = [row.name for row in results.ranking if row.name in LAWS and row.marked]
    chances = {name: sign_test(good[best], good[name]) for name in laws}
    shares = [f"{100.0 * (1.0 - good[name].mean()):.0f} % {name} (p = {p:.2g})" for name, p in chances.items()]
    measured = f"{100.0 * (1.0 - good[best].mean()):.0f} % bad with {best}, {', '.join(shares)}"
    demand = "in `short` on test scenarios the learned entry that scores most has fewer bad runs than laws with ✓ (5 %)"
    return "saves runs", demand, measured, max(chances.values()) < 0.05


def course(knots: np.ndarray, n_steps: int) -> np.ndarray:
    """Return actions (n_steps, n, n_action), linear between evenly spaced knots (n, n_knots, n_action)."""
    places = np.linspace(0.0, knots.shape[1] - 1, n_steps)
    before = np.minimum(places.astype(int), knots.shape[1] - 2)
    shares = (places - before)[:, np.newaxis]
    actions = (1.0 - shares) * knots[:, before] + shares * knots[:, before + 1]
    return np.clip(np.moveaxis(actions, 1, 0), -1.0, 1.0)


def play_course(batch: EnvBatch, scenarios: list[Scenario], knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return costs and largest deviations of the frequency [Hz] of scenarios, (n,); a lost run counts 3 Hz."""
    batch.start(range(len(scenarios)), scenarios)
    for actions in course(knots, batch.n_steps_of_episode):
        batch.step(np.ascontiguousarray(actions))
    return batch.cost_sums().sum(axis=1), np.where(batch.ended()[0], 3.0, largest_deviations_hz(batch))


def no_shortcut() -> Row:
    """Search the best course of actions that is the same in every scenario, for every group."""
    suite, batch = get_suite(SUITE), EnvBatch(SEARCHED, N_SEARCHED * POPULATION)
    scenarios = batch.scenarios(suite.train[:N_SEARCHED]) * POPULATION
    offsets = np.array([suite.cost_offset(scenario) for scenario in scenarios])
    search = Search(np.zeros((N_KNOTS, 2)), 0.15, POPULATION, 1)
    for _ in range(20):
        candidates = search.ask()
        knots = np.tile(candidates.reshape(POPULATION, N_KNOTS, 2), batch.n_wtg)
        costs, _ = play_course(batch, scenarios, np.repeat(knots, N_SEARCHED, axis=0))
        search.tell(candidates, np.log(costs + offsets).reshape(POPULATION, -1).mean(axis=1))
    actions = course(np.tile(search.mean.reshape(1, N_KNOTS, 2), batch.n_wtg), batch.n_steps_of_episode)
    clock = Entry(name="clock", policy=Course(np.repeat(actions, N_SEARCHED, axis=1)), strategy=LAW)
    validation = suite.seeds("validation")[:N_SEARCHED]
    scores = evaluate([clock, LAW], SUITE, "validation", seeds=validation, batch=N_SEARCHED).scores
    gain = scores["clock"].value - scores[LAW].value
    demand = "the best clock that a search finds, constants among them, earns less than 1 point over the law beneath"
    return "no shortcut", demand, f"{gain:+.1f} over {LAW}", gain < 1.0


def winnable() -> Row:
    """Search actions that keep runs within 0.8 Hz which are bad under the law."""
    suite, batch = get_suite(SUITE), EnvBatch(SEARCHED, N_WON)
    scenarios = batch.scenarios(suite.train[:N_WON])
    _, deviations = play_course(batch, scenarios, np.zeros((N_WON, 2, batch.n_action)))
    bad = [scenario for scenario, hz in zip(scenarios, deviations, strict=True) if hz > 0.8]
    scenarios = [scenario for scenario in bad for _ in range(POPULATION)]
    batch = EnvBatch(SEARCHED, len(scenarios))
    searches = [Search(np.zeros((N_KNOTS, 2)), 0.35, POPULATION, scenario.seed) for scenario in bad]
    best = np.full(len(bad), np.inf)
    for _ in range(40):
        candidates = [search.ask() for search in searches]
        # One course for all groups: to search four takes longer than it wins.
        knots = np.tile(np.reshape(candidates, (-1, N_KNOTS, 2)), batch.n_wtg)
        # The last event comes at 60 s: in the second half of the run the law is alone.
        knots = np.concatenate([knots, np.zeros_like(knots)], axis=1)
        costs, hz = (values.reshape(len(bad), POPULATION) for values in play_course(batch, scenarios, knots))
        # Where load is shed the deviation hardly depends on the actions; the cost still does.
        for search, of_search, values in zip(searches, candidates, hz + np.log(costs + 100.0), strict=True):
            search.tell(of_search, values)
        best = np.minimum(best, hz.min(axis=1))
    lost = [suite.stratum(scenario.seed) for scenario, hz in zip(bad, best, strict=True) if hz > 0.8]
    shares = {name: 100.0 * lost.count(name) * len(suite.strata) / N_WON for name in suite.strata}
    demand = "under the best actions that a search finds, at most a tenth of a stratum's runs are bad"
    measured = ", ".join(f"{name} {share:.0f} %" for name, share in shares.items())
    return "winnable", demand, measured, max(shares.values()) <= 10.0


if __name__ == "__main__":
    results = evaluate([*LAWS, *FIRST, EXACT], SUITE, "validation")
    rows = [condition(results) for condition in (room, paid_in_full)]
    results = evaluate([*LAWS, *POLICIES, EXACT], SUITE, "test")
    rows += [condition(results) for condition in (operator_agrees, sharp, saves_runs)]
    rows += [no_shortcut(), winnable()]
    cells = [(*texts, "holds" if holds else "does not hold") for *texts, holds in rows]
    table = markdown_table(("condition", "demand", "measured", ""), cells)
    update_between_markers(DOCS / "benchmark.md", table, "conditions")
