"""docs/benchmark.md: what v1 demands of itself, measured.

    python docs/studies/conditions.py [--output DOCS]

renews the table between the markers "conditions" of DOCS/benchmark.md; ten minutes on two processors. Searches use
training scenarios, scores validation scenarios.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence

import numpy as np
from output import folder as output_folder

from agents.evolution import Search
from wtg_gym.envs.lanes import TaskLanes, paid
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Results, evaluate
from wtg_gym.evaluation.statistics import sign_test
from wtg_gym.evaluation.summary import lost_or_beyond, runs_by_name
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
#: The best fixed law, on which searches act.
LAW = "coordinated-free"
LAWS = ("deloaded-10", "coordinated-piecewise", "coordinated-tuned", "coordinated-free", "fast-droop", "mean-droop")
POLICIES = ("ppo-v1-0", "ppo-v1-1", "ppo-v1-2")
#: A network that sees the exact state.
EXACT = "exact-state-v1-0"
#: Training scenarios of a search: as many of each stratum.
N_SCENARIOS = 90
#: Knots of a course of actions, evenly over the episode and then linear in between, and candidates of a search.
N_KNOTS, POPULATION = 13, 12
_TASK = get_suite(SUITE).task
Row = tuple[str, str, str, str]


def lanes_of(n_lanes: int, law: str = LAW, **settings) -> TaskLanes:
    """Return environments that are charged the cost."""
    return TaskLanes(EnvSettings(suite=SUITE, strategy=law, reward="cost", **settings), n_lanes)


def training() -> list[Scenario]:
    """Return the training scenarios of searches."""
    return lanes_of(1).scenarios(get_suite(SUITE).train[:N_SCENARIOS])


def points(costs: Floats, hundred: Floats, scenarios: Sequence[Scenario]) -> Floats:
    """Return points above 100 in each scenario, from costs (…, n) and those of the law that scores 100."""
    offsets = np.array([get_suite(SUITE).cost_offset(scenario) for scenario in scenarios])
    return 100.0 / _TASK.scale * np.log((hundred + offsets) / (costs + offsets))


def played(lanes: TaskLanes, scenarios: Sequence[Scenario], act: Callable[[float], Floats]) -> tuple[Floats, Floats]:
    """Return costs and largest deviations of the frequency [Hz], (n,), under actions (n, n_action) at a share of it.

    A lost run counts 3 Hz.
    """
    lanes.start(range(len(scenarios)), scenarios)
    for step in range(lanes.n_steps_of_episode):
        lanes.step(act(step / (lanes.n_steps_of_episode - 1)))
    low, high = (lanes.nominal_hz * lanes.simulator.lane_values(name) for name in ("coi_min", "coi_max"))
    deviations = np.maximum(lanes.nominal_hz - low, high - lanes.nominal_hz)
    return lanes.cost_sums().sum(axis=1), np.where(lanes.statuses() != 0, 3.0, deviations)


def course(knots: Floats) -> Callable[[float], Floats]:
    """Return actions (…, n_action) by the share of time from knots (…, n_knots, n_action)."""

    def act(share: float) -> Floats:
        place = share * (knots.shape[-2] - 1)
        i = min(int(place), knots.shape[-2] - 2) if knots.shape[-2] > 1 else 0
        after = knots[..., min(i + 1, knots.shape[-2] - 1), :]
        return np.clip((1.0 - place + i) * knots[..., i, :] + (place - i) * after, -1.0, 1.0)

    return act


def no_shortcut() -> Row:
    """Search for the best constant, and for the best course that is the same in every scenario."""
    scenarios = training()
    fresh = lanes_of(1).scenarios(get_suite(SUITE).seeds("validation")[:N_SCENARIOS])
    hundred, of_law = (
        paid(lanes_of(N_SCENARIOS, law, split=split), seeds)[:, -1]
        for law in (_TASK.hundred, LAW)
        for split, seeds in (("validation", fresh),)
    )
    best = {}
    with_law = points(of_law, hundred, fresh).mean()
    base = paid(lanes_of(N_SCENARIOS, _TASK.hundred), scenarios)[:, -1]
    lanes = lanes_of(N_SCENARIOS * POPULATION)
    for name, n_knots in (("constant", 1), ("clock", N_KNOTS)):
        search = Search(np.zeros(2 * n_knots), 0.15, POPULATION, 1)
        for _ in range(12 if n_knots == 1 else 25):
            asked = search.ask()
            # Actions on k and τ are alike for all groups.
            knots = np.tile(asked.reshape(POPULATION, 1, n_knots, 2), lanes.n_wtg)
            spread = np.broadcast_to(knots, (POPULATION, N_SCENARIOS, n_knots, knots.shape[-1]))
            costs, _ = played(lanes, scenarios * POPULATION, course(spread.reshape(-1, n_knots, knots.shape[-1])))
            search.tell(asked, -points(costs.reshape(POPULATION, -1), base, scenarios).mean(axis=1))
        knots = np.tile(search.mean.reshape(n_knots, 2), lanes.n_wtg)
        validation = lanes_of(N_SCENARIOS, split="validation")
        costs, _ = played(validation, fresh, course(np.tile(knots, (N_SCENARIOS, 1, 1))))
        best[name] = points(costs, hundred, fresh).mean() - with_law
    said = ", ".join(f"{name} {gain:+.1f}" for name, gain in best.items())
    return (
        "no shortcut",
        "clock or constant earn less than 1 point over the law beneath",
        said,
        verdict(max(best.values()) < 1.0),
    )


def winnable() -> Row:
    """Search actions that keep the runs within 0.8 Hz which the law that scores 100 does not."""
    scenarios = training()
    suite = get_suite(SUITE)
    _, deviations = played(
        lanes := lanes_of(N_SCENARIOS, _TASK.hundred), scenarios, lambda _: np.zeros((N_SCENARIOS, lanes.n_action))
    )
    bad = [scenario for scenario, hz in zip(scenarios, deviations, strict=True) if hz > 0.8]
    lanes = lanes_of(len(bad) * POPULATION, duration_s=90.0)
    short = lanes.scenarios([scenario.seed for scenario in bad])
    n_knots, n_action = 8, lanes.n_action
    searches = [Search(np.zeros(n_knots * n_action), 0.35, POPULATION, scenario.seed) for scenario in bad]
    best = np.full(len(bad), 3.0)
    for _ in range(25):
        asked = np.array([search.ask() for search in searches])
        _, hz = played(
            lanes, [s for s in short for _ in range(POPULATION)], course(asked.reshape(-1, n_knots, n_action))
        )
        for search, candidates, values in zip(searches, asked, hz.reshape(len(bad), POPULATION), strict=True):
            search.tell(candidates, values)
        best = np.minimum(best, hz.reshape(len(bad), POPULATION).min(axis=1))
    shares = {}
    for name in suite.strata:
        lost = sum(hz > 0.8 and suite.stratum(scenario.seed) == name for scenario, hz in zip(bad, best, strict=True))
        shares[name] = 100.0 * lost / (N_SCENARIOS / len(suite.strata))
    said = ", ".join(f"{name} {share:.0f} %" for name, share in shares.items())
    return (
        "winnable",
        "search finds at most a tenth of any stratum's runs bad under every action",
        said,
        verdict(max(shares.values()) <= 10.0),
    )


def room(results: Results) -> Row:
    """Compare the network that sees the exact state with the best law."""
    rows = {row.name: row for row in results.ranking}
    exact = next(row for row in results.ranking if row.privileged)
    law = max((rows[name] for name in LAWS), key=lambda row: row.score.value)
    lead = exact.score.value - law.score.value
    runs = runs_by_name(results.episodes)
    short = [get_suite(SUITE).stratum(seed) == "short" for seed in get_suite(SUITE).seeds("validation")]
    bad, of_law = (
        100.0 * lost_or_beyond(runs[row.name], get_suite(SUITE).nominal_hz)[:, short].mean() for row in (exact, law)
    )
    return (
        "room",
        "with the exact state, without foresight, 10 points above the best law; a fifth fewer bad runs in `short`",
        f"{exact.name} {lead:+.1f} over {law.name}; {bad:.0f} % bad instead of {of_law:.0f} %",
        verdict(lead >= 10.0 and bad <= 0.8 * of_law),
    )


def paid_in_full(results: Results) -> Row:
    """Score entries in episodes that last a minute longer."""
    longer = evaluate(list(LAWS), SUITE, "validation", duration_s=240.0).scores
    marked = [row.name for row in results.ranking if row.marked and row.name in LAWS]
    changes = {name: longer[name].value - results.scores[name].value for name in marked}
    name = max(changes, key=lambda name: abs(changes[name]))
    demand = "a minute more moves no law with ✓ by 2 points"
    return "paid in full", demand, f"{name} {changes[name]:+.1f}", verdict(abs(changes[name]) < 2.0)


def operator_agrees(results: Results) -> Row:
    """Compare bad runs of every two entries, of the first training seed."""
    runs = {name: runs[:1] for name, runs in runs_by_name(results.episodes).items()}
    bad = {name: lost_or_beyond(own, get_suite(SUITE).nominal_hz) for name, own in runs.items()}
    pairs = [
        f"{above.name} over {below.name}"
        for above, below in itertools.combinations(results.ranking, 2)
        if sign_test(bad[above.name], bad[below.name]) < 0.05
    ]
    demand = "of two entries whose bad runs differ significantly, the worse one is not ranked above"
    return "an operator agrees", demand, ", ".join(pairs) or "no such pair", verdict(not pairs)


def sharp(results: Results) -> Row:
    """Measure the widest interval of networks."""
    widths = {row.name: 0.5 * (row.score.high - row.score.low) for row in results.ranking if row.n_runs > 1}
    said = ", ".join(f"{name} ± {width:.1f}" for name, width in widths.items())
    return "sharp", "intervals of ± 1 for networks of three seeds", said, verdict(max(widths.values()) <= 1.0)


def verdict(holds: bool) -> str:
    return "holds" if holds else "does not hold"


def main() -> None:
    docs = output_folder(__doc__)
    rows = []
    results = evaluate([*LAWS, *POLICIES, EXACT], SUITE, "validation")
    of_results = (functools.partial(each, results) for each in (room, paid_in_full, operator_agrees, sharp))
    for condition in (no_shortcut, winnable, *of_results):
        rows.append(condition())
        print(*rows[-1], sep=" | ", flush=True)
    update_between_markers(
        docs / "benchmark.md", markdown_table(("condition", "demand", "measured", ""), rows), "conditions"
    )


if __name__ == "__main__":
    main()
