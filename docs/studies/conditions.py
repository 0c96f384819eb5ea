"""Whether standard-v1 is a good problem to learn on, in figures.

    python docs/studies/oracle.py && python docs/studies/planner.py && python docs/studies/conditions.py [--output DOCS]

measures the conditions of docs/benchmark.md on its validation scenarios: what a feedback gains is support of the
frequency; foresight and planning are worth much more than any feedback; no trivial policy beats the anchor; a step of
delay more costs an agent little; every term of the cost matters; failures are rare but there; the laws keep the paper's
order of rotor safety. Half an hour on two processors.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from output import folder as output_folder
from rollouts import Candidates, Rollouts

from baselines.fast_droop import FastDroop
from wtg_gym.envs.observation import N_MEASURED
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.evaluation import Entry, Results, evaluate, load_entries
from wtg_gym.evaluation.summary import EntrySummary
from wtg_gym.files import markdown_table, read_json, update_between_markers
from wtg_gym.physics.layout import Floats
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
FEEDBACKS = ("linear-feedback-v1", "history-feedback-v1")
AGENTS = ("gradient-v1", "ppo-v1", "recurrent-ppo-v1")  # trained with random delay, one folder for each seed
#: Laws whose rotors must keep the paper's order, the safest first.
LAWS = ("coordinated-piecewise", "deloaded-10", "deloaded-5", "mppt")
#: Deviations that take the whole authority of the droops that are tried on each law [Hz].
DROOPS_HZ = (1.0, 0.25, 0.125, 0.0625)


# --- the conditions --------------------------------------------------------------------------------------------------


class Condition(NamedTuple):
    """A row of the table."""

    letter: str
    demand: str
    measured: str
    met: bool


def support(results: Results, best: EntrySummary, zero: str) -> Condition:
    def deviation_mhz(name: str) -> float:
        metrics = [episode.metrics for episode in results.episodes_of(name)]
        return 1000.0 * float(np.median([max(50.0 - m["nadir_hz"], m["zenith_hz"] - 50.0) for m in metrics]))

    own, base = ({row.name: row for row in results.summaries}[name].points_by_term for name in (best.name, zero))
    gains = {term: own[term] - base[term] for term in own}
    share = gains["frequency_rocof"] / sum(gains.values())
    before, after = deviation_mhz(zero), deviation_mhz(best.name)
    smaller = 1.0 - after / before
    return Condition(
        "a",
        "more than half of the best feedback's gain on the zero action is frequency and RoCoF; the median deviation "
        "is at least 30 % smaller",
        f"{best.name}: {100 * share:.0f} % of the gain; {before:.0f} → {after:.0f} mHz, {100 * smaller:.0f} % smaller",
        share > 0.5 and smaller >= 0.3,
    )


def foresight_and_planning(
    results: Results, oracle: dict[str, Any], planners: Results, anchor: str, feedbacks: Sequence[str]
) -> list[Condition]:
    def mean_cost(own: Results, name: str) -> float:
        """On the oracle's scenarios only."""
        place = {seed: i for i, seed in enumerate(own.seeds)}
        return float(own.pinned_costs[name].mean(axis=0)[[place[seed] for seed in oracle["seeds"]]].mean())

    before, after = mean_cost(results, anchor), float(np.mean(oracle["oracle"]))
    lower = 1.0 - after / before
    plans = [name for name in planners.pinned_costs if name.startswith("planner-")]
    costs = {name: mean_cost(results, name) for name in feedbacks} | {name: mean_cost(planners, name) for name in plans}
    closed = {name: (before - cost) / (before - after) for name, cost in costs.items()}
    return [
        Condition(
            "b",
            "the oracle lowers the anchor's mean pinned cost by at least 40 %",
            f"{before:.1f} → {after:.1f}, {100 * lower:.0f} % ({len(oracle['seeds'])} scenarios)",
            lower >= 0.4,
        ),
        Condition(
            "c",
            "tuned feedbacks close at most 20 % of that gap, a planner without foresight at least 40 %",
            ", ".join(f"{name} {100 * share:.0f} %" for name, share in closed.items()),
            max(closed[name] for name in feedbacks) <= 0.2 and max(closed[name] for name in plans) >= 0.4,
        ),
    ]


def trivial() -> Condition:
    zero, anchor = get_suite(SUITE).benchmark.anchors
    found, idle = [], {}
    for law in (zero, anchor):
        seeds = get_suite(SUITE).validation
        with closing(Rollouts(SUITE, "validation", seeds, AT_ONCE, strategy=law)) as rollouts:
            idle[law] = float(rollouts.log_costs(rollouts.reference()).mean())
            found += [(cost, f"{law} with {words}") for cost, words in simple_policies(rollouts)]
    cost, words = min(found)
    score = 100.0 * (idle[zero] - cost) / (idle[zero] - idle[anchor])
    return Condition(
        "d",
        "no constant, relay or one-gain rule scores above 102",
        f"{score:.1f}: {words} ({len(found)} tried)",
        score <= 102.0,
    )


def delay(agents: Sequence[Entry], on_time: dict[str, EntrySummary]) -> Condition:
    later = {"delay_s": [value + 0.1 for value in get_suite(SUITE).sensors.delay_s]}
    late = evaluate(list(agents), SUITE, "validation", sensors=later).scores
    losses = {name: on_time[name].score.value - late[name].value for name in dict.fromkeys(e.name for e in agents)}
    return Condition(
        "e",
        "one more step of delay costs an agent that was trained with random delay less than 5 points",
        "points lost: " + ", ".join(f"{name} {loss:+.1f}" for name, loss in losses.items()),
        max(losses.values()) < 5.0,
    )


def terms(rows: dict[str, EntrySummary]) -> Condition:
    def decides(term: str, one: EntrySummary, other: EntrySummary) -> bool:
        """Whether the two would change places without the term."""
        ahead = sum(other.mean_cost_terms.values()) - sum(one.mean_cost_terms.values())
        return other.mean_cost_terms[term] - one.mean_cost_terms[term] > ahead > 0.0

    wanted = [term for term in COST_TERMS if term != "effort"]
    found = [term for term in wanted if any(decides(term, *pair) for pair in itertools.permutations(rows.values(), 2))]
    return Condition(
        "f",
        "every term of the cost but effort decides the order of some pair of laws or rules",
        ", ".join(found),
        found == wanted,
    )


def failures(rows: dict[str, EntrySummary], zero: str, anchor: str) -> Condition:
    own, base = rows[anchor].failures_percent, rows[zero].failures_percent
    demand = "the anchor fails in 0.5 … 5 % of the scenarios, the zero action in at most 8 %"
    return Condition("g", demand, f"{own:.1f} %, {base:.1f} %", 0.5 <= own <= 5.0 and base <= 8.0)


def rotors(results: Results) -> Condition:
    ends = ("stall", "over-speed", "under-speed")
    lost = {law: 100.0 * float(np.mean([e.failure in ends for e in results.episodes_of(law)])) for law in LAWS}
    return Condition(
        "h",
        "the laws keep the paper's order of rotor safety",
        "rotors lost: " + ", ".join(f"{law} {value:.1f} %" for law, value in lost.items()),
        list(lost.values()) == sorted(lost.values()),
    )


# --- trivial policies ------------------------------------------------------------------------------------------------

AT_ONCE = 24
_ACTIONS = ("k", "tau")
_CONSTANTS = (
    (-0.5, -0.2, -0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2, 0.5),  # k
    (-1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0),  # tau
)
_AMPLITUDES, _GAINS = (0.05, 0.2, 1.0), (0.2, 0.6, 2.0)
#: Quantiles of an observation under the zero action at which an action jumps.
_JUMPS = (0.25, 0.5, 0.75)


def simple_policies(rollouts: Rollouts) -> list[tuple[float, str]]:
    """Return the mean of ln(J + J0) of policies that should not be good, and what they do.

    They are a grid of constant actions; actions that jump where one observation crosses a quartile of its values under
    the zero action; and actions in proportion to one observation's distance from its median.
    """
    values = _seen(rollouts)
    names = [name.split(".", 1)[1] for name in rollouts.lanes.observation_names[: rollouts.n_local]]
    rules = [(f"k {k:+g}, tau {tau:+g}", _constant(k, tau)) for k, tau in itertools.product(*_CONSTANTS)]
    for i, sign, action in itertools.product(range(len(names)), (1.0, -1.0), range(len(_ACTIONS))):
        for jump, amplitude in itertools.product(np.quantile(values[:, i], _JUMPS), _AMPLITUDES):
            words = f"{_ACTIONS[action]} {sign * amplitude:+g} · sign({names[i]} − {jump:.2f})"
            rules.append((words, _rule(i, jump, sign * amplitude, action, jumps=True)))
        for gain in _GAINS:
            middle = float(np.median(values[:, i]))
            words = f"{_ACTIONS[action]} {sign * gain:+g} · ({names[i]} − {middle:.2f})"
            rules.append((words, _rule(i, middle, sign * gain, action, jumps=False)))
    found = []
    with Progress("policies") as progress:
        for first in range(0, len(rules), AT_ONCE):
            # The last ones are repeated to fill the room.
            own = [rules[min(i, len(rules) - 1)] for i in range(first, first + AT_ONCE)]
            costs = rollouts.log_costs(rollouts.play(_together([rule for _, rule in own]))).mean(axis=0)
            found += [(float(cost), words) for cost, (words, _) in zip(costs, own, strict=True)]
            progress.update("trivial policies", min(len(found), len(rules)), len(rules))
    return found[: len(rules)]


def _constant(k: float, tau: float) -> Any:
    return lambda own: np.broadcast_to((k, tau), (*own.shape[:-1], 2))


def _rule(observed: int, middle: float, gain: float, action: int, *, jumps: bool) -> Any:
    def act(own: Floats) -> Floats:
        distance = own[..., observed] - middle
        actions = np.zeros((*own.shape[:-1], 2))
        actions[..., action] = gain * (np.sign(distance) if jumps else distance)
        return actions

    return act


def _together(rules: Sequence[Any]) -> Candidates:
    return lambda _step, own: np.stack([rule(own[:, i]) for i, rule in enumerate(rules)], axis=1)


def _seen(rollouts: Rollouts) -> Floats:
    """Return a group's observations under the zero action, every second, (n_samples, n_local)."""
    seen = []

    def act(step: int, own: Floats) -> Floats:
        if step % 10 == 0:
            seen.append(own[..., : rollouts.n_local].reshape(-1, rollouts.n_local))
        return np.zeros((*own.shape[:3], rollouts.n_action))

    with closing(rollouts.with_candidates(1)) as alone:
        alone.play(act)
    return np.concatenate(seen)


# --- the end of an episode -------------------------------------------------------------------------------------------


class Stopwatch:
    """The droop of fast-droop in the last 10 s, after which nobody has to give back what was lent."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        step = 0 if state is None else state
        frequency = np.asarray(observation, dtype=np.float64).reshape(len(observation), -1, N_MEASURED + 1)[..., 0]
        return np.clip(-frequency if step >= 500 else 0.0 * frequency, -1.0, 1.0), step + 1


def entry(name: str, strategy: str, policy: Any) -> Entry:
    """Return an entry that moves k alone."""
    env_id = get_suite(SUITE).benchmark.env_id
    return Entry(name=name, strategy=strategy, policy=policy, action_mode="k", environment=env_id, learned=False)


if __name__ == "__main__":
    docs = output_folder(__doc__)
    benchmark = get_suite(SUITE).benchmark
    zero, anchor = benchmark.anchors
    oracle = read_json(Path(f"results/oracle/{SUITE}-validation.json"), "oracle")
    planners = Results.read(f"results/planners/{SUITE}-validation.json")

    folder = Path("agents/policies")
    agents = [entry for name in AGENTS for path in sorted(folder.glob(f"{name}-?")) for entry in load_entries(path)]
    feedbacks = [entry for name in FEEDBACKS for entry in load_entries(folder / name)]
    laws = [entry for name in (*LAWS, "fast-droop") for entry in load_entries(name, benchmark=benchmark)]
    droops = [
        entry(f"{law} with {hz:g} Hz", law, FastDroop(hz)) for law in dict.fromkeys((*LAWS, anchor)) for hz in DROOPS_HZ
    ]
    stopwatch = entry("stopwatch", anchor, Stopwatch())
    with Progress("episodes") as progress:
        entries = [*laws, *droops, *feedbacks, *agents]
        results = evaluate(entries, SUITE, "validation", on_progress=progress.update)
        alone = evaluate([stopwatch], SUITE, "validation", on_progress=progress.update)
    rows = {row.name: row for row in results.summaries}
    names = [each.name for each in feedbacks]
    best = max((rows[name] for name in (*names, anchor)), key=lambda row: row.score.value)
    conditions = [
        support(results, best, zero),
        *foresight_and_planning(results, oracle, planners, anchor, names),
        trivial(),
        delay(agents, rows),
        terms(rows),
        failures(rows, zero, anchor),
        rotors(results),
    ]
    table = markdown_table(
        ("", "condition", "measured"),
        [(f"({c.letter})", c.demand, c.measured + ("" if c.met else ": **not met**")) for c in conditions],
    )
    n_met = sum(c.met for c in conditions)
    text = f"{n_met} of {len(conditions)} are met on {len(results.seeds)} validation scenarios of `{SUITE}`:\n\n{table}"
    update_between_markers(docs / "benchmark.md", text, "conditions")
    print(f"the stopwatch scores {alone.scores['stopwatch'].value:.1f}")
