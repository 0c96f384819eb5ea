"""The sensitivity of scores and ranking to each weight of the cost."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from wtg_gym.envs.settings import CostWeights, EnvSettings
from wtg_gym.evaluation.evaluator import Progress, evaluate
from wtg_gym.evaluation.leaderboard import leaderboard_rows
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.score import NoScaleError
from wtg_gym.files import markdown_table
from wtg_gym.policies import Entry
from wtg_gym.ranges import require_range
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite

#: The weights that are varied: all but the cap, which is a bound.
WEIGHTS = tuple(field.name for field in dataclasses.fields(CostWeights) if field.name != "cap")
FACTORS = (0.0, 2.0)
#: A change of a score by less than this counts as none [points].
POINT = 1.0
#: Headings of the table.
COLUMNS = ("weight", "factor", "order", "scores that change by a point or more")


@dataclass(frozen=True, kw_only=True)
class Variant:
    """The ranking with one weight multiplied by a factor, compared with the ranking as it is."""

    weight: str  # name of the weight
    factor: float  # factor on it
    #: By name, the best first; empty where there is no score, because the zero is not worse than the hundred.
    scores: Mapping[str, float]
    #: How much each score changes [points]; without the two anchors, whose scores are fixed.
    changes: Mapping[str, float]
    ranks: Mapping[str, tuple[int, int]]  # rank before and after of every entry whose rank changes

    @property
    def large_changes(self) -> dict[str, float]:
        """The changes of a point or more, the largest first."""
        ordered = sorted(self.changes.items(), key=lambda item: -abs(item[1]))
        return {name: change for name, change in ordered if abs(change) >= POINT}

    @property
    def matters(self) -> bool:
        """Whether the order changes, a score changes by a point or more, or a score vanishes."""
        return not self.scores or bool(self.large_changes or self.ranks)

    def cells(self) -> list[str]:
        """Return the texts of a row of the table, in the order of :data:`COLUMNS`."""
        order = "changes: " + ", ".join(f"{name} {old} → {new}" for name, (old, new) in self.ranks.items())
        changes = ", ".join(f"{name} {change:+.1f}" for name, change in self.large_changes.items())
        if not self.scores:
            return [self.weight, f"{self.factor:g}", "no score: the entry at 0 is not worse than that at 100", ""]
        return [self.weight, f"{self.factor:g}", order if self.ranks else "same", changes or "none"]


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Scores with the weights as they are, and with each one multiplied."""

    #: suite, split, suite_hash: which scenarios.
    suite: str
    split: str
    suite_hash: str
    n_scenarios: int  # how many
    weights: Mapping[str, float]  # the weights as they are [1/s]
    scores: Mapping[str, float]  # by name, the best first
    variants: tuple[Variant, ...]  # one for each weight and factor

    @property
    def idle(self) -> list[str]:
        """The weights of which no variant matters."""
        names = dict.fromkeys(variant.weight for variant in self.variants)
        return [name for name in names if not any(v.matters for v in self.variants if v.weight == name)]

    @property
    def ordering(self) -> list[str]:
        """The weights of which a variant changes the order, or leaves no scale to order by."""
        return list(dict.fromkeys(v.weight for v in self.variants if v.ranks or not v.scores))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON-ready data."""
        return {**dataclasses.asdict(self), "ordering": self.ordering, "idle": self.idle}

    def describe(self) -> str:
        """Return two sentences: which weights the order depends on, and which do not matter."""
        order = (
            f"Weights that change the order: {', '.join(self.ordering)}."
            if self.ordering
            else "No weight changes the order."
        )
        return f"{order} {self.describe_idle()}"

    def describe_idle(self) -> str:
        """Return a sentence that names the weights that do not matter."""
        if not self.idle:
            return "Every weight changes the order or a score by a point, or leaves no score."
        return f"Weights that change neither the order nor a score by a point: {', '.join(self.idle)}."

    def page(self) -> str:
        """Return scenarios, scores and table as Markdown."""
        scores = ", ".join(f"{name} {round(score, 1) + 0.0:.1f}" for name, score in self.scores.items())
        scenarios = f"on {self.n_scenarios} {self.split} scenarios of `{self.suite}`"
        table = markdown_table(COLUMNS, [variant.cells() for variant in self.variants], right=(1,))
        return f"Scores {scenarios} with the usual weights: {scores}.\n\n{table}\n\n{self.describe()}"


def study_sensitivity(
    entries: Sequence[Entry],
    suite: str = DEFAULT_SUITE,
    split: str = "validation",
    *,
    n_scenarios: int | None = None,
    weights: Sequence[str] = WEIGHTS,
    factors: Sequence[float] = FACTORS,
    n_threads: int | None = None,
    on_progress: Progress | None = None,
) -> Sensitivity:
    """Evaluate entries, and the score's two anchors, with the weights as they are and with each one multiplied.

    Policies are not trained again: each goes on doing what it learned for the weights as they are.

    Args:
        entries: competitors.
        suite, split: which scenarios.
        n_scenarios: how many, the first ones of the split; None for all.
        weights: names of the weights, see :data:`WEIGHTS`.
        factors: factors on each of them.
        n_threads: threads to step with; None for one per processor.
        on_progress: called with (what is under way, episodes done, episodes in all).

    Raises:
        NoScaleError: with the weights as they are, the zero is not worse than the hundred.
        ValueError: an argument is unknown or out of range.
    """
    if not weights or not set(weights) <= set(WEIGHTS) or len(set(weights)) < len(weights):
        raise ValueError(f"weights must be different ones out of {', '.join(WEIGHTS)}; got {list(weights)}")
    for factor in factors:
        require_range("a factor", factor, 0.0, 1000.0, "")
    if not factors or len({1.0, *factors}) < 1 + len(factors):
        raise ValueError(f"factors must be different numbers other than 1, which changes nothing; got {list(factors)}")
    base = EnvSettings(suite=suite).cost_weights()
    chosen = [(name, float(factor)) for name in weights for factor in factors]
    seeds = None
    if n_scenarios is not None:
        every = get_suite(suite).seeds(split)
        if not 1 <= n_scenarios <= len(every):
            raise ValueError(f"scenarios = {n_scenarios} is outside the allowed range 1 … {len(every)}")
        seeds = every[:n_scenarios]

    def played(number: int, name: str, changed: dict[str, float]) -> Results:
        def tell(entry: str, done: int, total: int) -> None:
            if on_progress is not None:
                on_progress(f"{name}: {entry}", number * total + done, (1 + len(chosen)) * total)

        return evaluate(entries, suite, split, seeds=seeds, n_threads=n_threads, on_progress=tell, weights=changed)

    results = played(0, "as they are", {})
    scores = _scores(results)
    variants = []
    for number, (name, factor) in enumerate(chosen, start=1):
        other = played(number, f"{name} × {factor:g}", {name: factor * getattr(base, name)})
        try:
            variants.append(compared(name, factor, scores, _scores(other), results.benchmark.anchors))
        except NoScaleError:
            variants.append(compared(name, factor, scores, {}, results.benchmark.anchors))
    return Sensitivity(
        suite=results.suite,
        split=results.split,
        suite_hash=results.suite_hash,
        n_scenarios=len(results.seeds),
        weights=dataclasses.asdict(base),
        scores=scores,
        variants=tuple(variants),
    )


def _scores(results: Results) -> dict[str, float]:
    return {row.name: row.score.value for row in leaderboard_rows(results)}


def compared(
    weight: str, factor: float, before: Mapping[str, float], after: Mapping[str, float], anchors: Sequence[str]
) -> Variant:
    """Return the variant with the scores `after` instead of `before`, each the best first; two are `anchors`."""
    old, new = list(before), list(after)
    ranks = {name: (old.index(name) + 1, new.index(name) + 1) for name in new}
    return Variant(
        weight=weight,
        factor=factor,
        scores=after,
        changes={name: after[name] - before[name] for name in after if name not in anchors},
        ranks={name: places for name, places in ranks.items() if places[0] != places[1]},
    )
