"""How scores and ranking depend on each weight of the cost."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from wtg_gym.envs.settings import CostWeights
from wtg_gym.evaluation.entries import ANCHORS, Entry
from wtg_gym.evaluation.evaluator import Progress, evaluate
from wtg_gym.evaluation.leaderboard import leaderboard_rows
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.statistics import NoScaleError
from wtg_gym.files import markdown_table
from wtg_gym.physics.scenario import require_range
from wtg_gym.scenarios import get_suite

#: The weights that are varied: all but the cap, which is a bound.
WEIGHTS = tuple(field.name for field in dataclasses.fields(CostWeights) if field.name != "cap")
FACTORS = (0.0, 2.0)
#: A change of a score by less than this counts as none [points].
POINT = 1.0


@dataclass(frozen=True)
class Variant:
    """The ranking with one weight multiplied.

    Args:
        weight: name of the weight.
        factor: what it was multiplied by.
        scores: by name, the best first; empty where there is no score, because MPPT is not worse than the reference.
    """

    weight: str
    factor: float
    scores: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Scores with the weights as they are, and with each one multiplied.

    Args:
        suite, split, suite_hash: which scenarios.
        n_scenarios: how many.
        weights: the weights as they are [1/s].
        scores: by name, the best first.
        variants: one for each weight and factor.
    """

    suite: str
    split: str
    suite_hash: str
    n_scenarios: int
    weights: Mapping[str, float]
    scores: Mapping[str, float]
    variants: tuple[Variant, ...]

    def changes(self, variant: Variant) -> dict[str, float]:
        """Return how much each score changes [points]; without the two anchors, whose scores are fixed."""
        free = [name for name in variant.scores if name not in ANCHORS]
        return {name: variant.scores[name] - self.scores[name] for name in free}

    def moves(self, variant: Variant) -> dict[str, tuple[int, int]]:
        """Return the rank before and after of every entry whose rank changes."""
        before, after = list(self.scores), list(variant.scores)
        ranks = {name: (before.index(name) + 1, after.index(name) + 1) for name in after}
        return {name: (old, new) for name, (old, new) in ranks.items() if old != new}

    def matters(self, variant: Variant) -> bool:
        """Return whether the order changes, a score by a point or more, or there is no score any more."""
        moved = any(abs(change) >= POINT for change in self.changes(variant).values())
        return not variant.scores or moved or bool(self.moves(variant))

    @property
    def idle(self) -> list[str]:
        """The weights of which no variant matters."""
        names = dict.fromkeys(variant.weight for variant in self.variants)
        return [name for name in names if not any(self.matters(v) for v in self.variants if v.weight == name)]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON-ready data."""
        variants = [
            {
                "weight": variant.weight,
                "factor": variant.factor,
                "scores": dict(variant.scores),
                "changes": self.changes(variant),
                "ranks": {name: list(ranks) for name, ranks in self.moves(variant).items()},
                "order_changes": bool(self.moves(variant)),
            }
            for variant in self.variants
        ]
        names = ("suite", "split", "suite_hash", "n_scenarios", "weights", "scores")
        return {**{name: getattr(self, name) for name in names}, "variants": variants, "idle": self.idle}


def study_sensitivity(
    entries: Sequence[Entry],
    suite: str = "standard",
    split: str = "validation",
    *,
    n_scenarios: int | None = None,
    weights: Sequence[str] = WEIGHTS,
    factors: Sequence[float] = FACTORS,
    n_threads: int | None = None,
    on_progress: Progress | None = None,
) -> Sensitivity:
    """Evaluate entries, and the score's two anchors, with the weights as they are and with each one multiplied.

    Nobody learns anew: a policy goes on doing what it was trained to do for the weights as they are.

    Args:
        entries: competitors.
        suite, split: which scenarios.
        n_scenarios: how many, the first ones of the split; None for all.
        weights: names of the weights, see :data:`WEIGHTS`.
        factors: what each of them is multiplied by.
        n_threads: threads to step with; None for one per processor.
        on_progress: called with (what is under way, episodes done, episodes in all).

    Raises:
        NoScaleError: with the weights as they are, MPPT is not worse than the reference.
        ValueError: an argument is unknown or out of range.
    """
    unknown = [name for name in weights if name not in WEIGHTS]
    if unknown or not weights or len(set(weights)) < len(weights):
        raise ValueError(f"weights must be different ones out of {', '.join(WEIGHTS)}; got {list(weights)}")
    for factor in factors:
        require_range("a factor", factor, 0.0, 1000.0, "")
    if not factors or len({1.0, *factors}) < 1 + len(factors):
        raise ValueError(f"factors must be different numbers other than 1, which changes nothing; got {list(factors)}")
    base = CostWeights()
    chosen = [(name, float(factor)) for name in weights for factor in factors]
    seeds = None if n_scenarios is None else _first(suite, split, n_scenarios)

    def played(number: int, name: str, changed: Mapping[str, float]) -> Results:
        def tell(entry: str, done: int, total: int) -> None:
            if on_progress is not None:
                on_progress(f"{name}: {entry}", number * total + done, (1 + len(chosen)) * total)

        return evaluate(
            entries, suite, split, seeds=seeds, n_threads=n_threads, on_progress=tell, weights=dict(changed)
        )

    results = played(0, "as they are", {})
    variants = []
    scores = _scores(results)
    for number, (name, factor) in enumerate(chosen, start=1):
        other = played(number, f"{name} × {factor:g}", {name: factor * getattr(base, name)})
        try:
            variants.append(Variant(name, factor, _scores(other)))
        except NoScaleError:
            variants.append(Variant(name, factor, {}))
    return Sensitivity(
        suite=results.suite,
        split=results.split,
        suite_hash=results.suite_hash,
        n_scenarios=len(results.seeds),
        weights=dataclasses.asdict(base),
        scores=scores,
        variants=tuple(variants),
    )


def _first(suite: str, split: str, n_scenarios: int) -> range:
    seeds = get_suite(suite).seeds(split)
    if not 1 <= n_scenarios <= len(seeds):
        raise ValueError(f"scenarios = {n_scenarios} is outside the allowed range 1 … {len(seeds)}")
    return seeds[:n_scenarios]


def _scores(results: Results) -> dict[str, float]:
    return {row.name: row.score.value for row in leaderboard_rows(results)}


#: Headings of the table.
COLUMNS = ("weight", "factor", "order", "scores that change by a point or more")


def sensitivity_cells(study: Sensitivity) -> list[list[str]]:
    """Return the texts of the table, one list per variant, in the order of :data:`COLUMNS`."""
    return [[v.weight, f"{v.factor:g}", _order(study, v), _changes(study, v)] for v in study.variants]


def _order(study: Sensitivity, variant: Variant) -> str:
    if not variant.scores:
        return "no score: MPPT is not worse than the reference"
    moves = study.moves(variant)
    return "changes: " + ", ".join(f"{name} {old} → {new}" for name, (old, new) in moves.items()) if moves else "same"


def _changes(study: Sensitivity, variant: Variant) -> str:
    large = {name: change for name, change in study.changes(variant).items() if abs(change) >= POINT}
    if not variant.scores:
        return ""
    ordered = sorted(large.items(), key=lambda item: -abs(item[1]))
    return ", ".join(f"{name} {change:+.1f}" for name, change in ordered) or "none"


def describe_idle(study: Sensitivity) -> str:
    """Return a sentence that names the weights that do not matter."""
    if not study.idle:
        return "Each of these weights moves a score by a point, changes the order, or leaves no scale to score on."
    return f"Neither a point of any score nor the order depends on: {', '.join(study.idle)}."


def sensitivity_page(study: Sensitivity) -> str:
    """Return the table as Markdown, with what it is about."""
    scores = ", ".join(f"{name} {round(score, 1) + 0.0:.1f}" for name, score in study.scores.items())
    scenarios = f"{study.n_scenarios} {study.split} scenarios of `{study.suite}`"
    about = f"{scenarios}. Scores with the weights as they are: {scores}."
    table = markdown_table(COLUMNS, sensitivity_cells(study), right=(1,))
    return f"{about}\n\n{table}\n\n{describe_idle(study)}"


__all__ = [
    "COLUMNS",
    "FACTORS",
    "POINT",
    "WEIGHTS",
    "Sensitivity",
    "Variant",
    "describe_idle",
    "sensitivity_cells",
    "sensitivity_page",
    "study_sensitivity",
]
