"""The generalisation gap: the score on the public test scenarios minus the score on fresh ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.results import Results, leaderboard_rows
from wtg_gym.evaluation.statistics import Floats, Groups, Interval
from wtg_gym.evaluation.table import signed_interval
from wtg_gym.scenarios import FRESH

#: With fewer the regression on the controls fits noise.
_FEWEST_FRESH = 30
#: Headings of the table; the first and the last column hold text.
COLUMNS = ("entry", "public", "fresh", "gap", "excess", "")


@dataclass(frozen=True, kw_only=True)
class GeneralisationGap:
    """One entry's gap."""

    name: str  # of the entry
    #: public, fresh: its scores.
    public: Interval
    fresh: Interval
    gap: Interval  # public minus fresh
    #: The part of the gap that the controllers made by hand do not share, see :func:`excess_gap`; None for these, and
    #: with fewer than 30 fresh scenarios.
    excess: Interval | None

    @property
    def is_suspect(self) -> bool:
        """Return whether the interval of the excess is above zero; of forty honest entries one is, by chance."""
        return self.excess is not None and self.excess.low > 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the gap as JSON-ready data."""
        return {**asdict(self), "is_suspect": self.is_suspect}


def generalisation_gaps(public: Results, fresh: Results) -> list[GeneralisationGap]:
    """Return the gaps of all entries that both results hold with the same policies, the best on public ones first.

    Args:
        public: results on the split "test".
        fresh: results on the split "fresh" of the same suite, with the same settings.

    Raises:
        ValueError: the results are not of these splits, or of different suites, settings or source code.
        NoScaleError: the results have no score, see :attr:`Results.summaries`.
    """
    if (public.split, fresh.split) != ("test", FRESH):
        raise ValueError(
            f"a gap is between results on the splits 'test' and {FRESH!r}, in this order; "
            f"got {public.split!r} and {fresh.split!r}"
        )
    for key in ("suite", "suite_hash", "source_hash", "settings"):
        if getattr(public, key) != getattr(fresh, key):
            raise ValueError(f"the two results are of another {key.replace('_', ' ')}: evaluate both again")
    zero, hundred = public.task.anchors
    others = {hundred, *left_out(public, fresh)}
    rows = [row for row in leaderboard_rows(public) if row.name not in others]
    controls = [row.name for row in rows if row.kind != "learned"]
    scores, gains, groups = fresh.scores, (public.gains, fresh.gains), (public.groups, fresh.groups)
    of_zero = [own[zero][0] for own in gains]
    gaps = []
    for row in rows:
        if row.name != zero:
            own = [each[row.name] for each in gains]
            excess = None
            if row.kind == "learned" and of_zero[1].size >= _FEWEST_FRESH:
                of_controls = [np.concatenate([each[name] for name in controls]) for each in gains]
                excess = excess_gap(*zip(own, of_controls, of_zero, groups, strict=True))
            gap = score_gap(*zip(own, of_zero, groups, strict=True))
            gaps.append(
                GeneralisationGap(
                    name=row.name, public=public.scores[row.name], fresh=scores[row.name], gap=gap, excess=excess
                )
            )
    return gaps


def score_gap(public: tuple[Floats, Floats, Groups], fresh: tuple[Floats, Floats, Groups]) -> Interval:
    """Return the score on public scenarios minus that on fresh ones, with its bootstrap interval.

    The training seeds of a resample are the same on both sides. The scenarios are drawn on each side independently, and
    Λ is computed anew from those that were drawn; a resample counts if both sides have a positive Λ in every stratum.

    Args:
        public, fresh: gains of the entry (n_runs, n_scenarios) and of the zero (n_scenarios,), see
            :func:`wtg_gym.evaluation.score.gains`, and the groups of the scenarios.
    """
    n_runs = public[0].shape[0]
    streams = [np.random.default_rng(seed) for seed in np.random.SeedSequence(statistics.BOOTSTRAP_SEED).spawn(3)]
    runs = streams[0].integers(0, n_runs, size=(statistics.N_RESAMPLES, n_runs))
    value, scored = 0.0, np.ones(statistics.N_RESAMPLES, dtype=np.bool_)
    resampled = np.zeros(statistics.N_RESAMPLES)
    for sign, stream, (gains, zero, groups) in zip((1.0, -1.0), streams[1:], (public, fresh), strict=True):
        for group in groups.values():
            weight = sign / len(groups)
            value += weight * statistics.mean(gains[:, group]) / -statistics.mean(zero[group])
            scenarios = group[stream.integers(0, group.size, size=(statistics.N_RESAMPLES, group.size))]
            means = np.take_along_axis(gains[:, scenarios].mean(axis=2).T, runs, axis=1).mean(axis=1)
            scale = -zero[scenarios].mean(axis=1)
            resampled += weight * (100.0 * means / scale)
            scored &= scale > 0.0
    return statistics.percentile_interval(100.0 * value, resampled[scored])


def excess_gap(public: tuple[Floats, Floats, Floats, Groups], fresh: tuple[Floats, Floats, Floats, Groups]) -> Interval:
    """Return the part of the gap that controls do not share, in points of the score, with its bootstrap interval.

    A set of scenarios that suits one good controller suits the others too. So the mean gain over the training seeds is
    regressed on the gains of controls, over the fresh scenarios, and the prediction is subtracted from the gains on
    both sides. The excess is the gap of the remainder: the entry's gap minus the weighted gaps of the controls. The
    coefficients and the training seeds are taken as known: the question is about these policies, not about others
    trained alike. A row of which only some seeds know the public scenarios is seen as sharply as any other.

    Source: control variates, e.g. P. Glasserman, "Monte Carlo Methods in Financial Engineering", 2003, section 4.1.

    Args:
        public, fresh: gains of the entry (n_runs, n_scenarios), of the controls (n_controls, n_scenarios) and of the
            zero (n_scenarios,), and the groups of the scenarios.
    """
    gains, controls, *_ = fresh
    centred = controls - controls.mean(axis=1, keepdims=True)
    weights = np.linalg.lstsq(centred.T, gains.mean(axis=0), rcond=None)[0]
    one, other = (
        ((own.mean(axis=0) - weights @ those)[np.newaxis], zero, groups) for own, those, zero, groups in (public, fresh)
    )
    return score_gap(one, other)


def left_out(public: Results, fresh: Results) -> list[str]:
    """Return the entries that only one of the results holds, or whose policies, known by their sha256, differ."""
    one, other = (
        {(entry["name"], entry["training_seed"]): entry["sha256"] for entry in results.entries}
        for results in (public, fresh)
    )
    differing = [run for run in {**one, **other} if one.get(run) is None or one[run] != other.get(run)]
    return list(dict.fromkeys(name for name, _ in differing))


def gap_cells(gaps: Sequence[GeneralisationGap]) -> list[list[str]]:
    """Return the texts of the table, one list per row, in the order of :data:`COLUMNS`."""
    return [
        [
            gap.name,
            f"{gap.public.value:.1f}",
            f"{gap.fresh.value:.1f}",
            signed_interval(gap.gap),
            "" if gap.excess is None else signed_interval(gap.excess),
            "better on public scenarios" if gap.is_suspect else "",
        ]
        for gap in gaps
    ]


def describe(public: Results, fresh: Results) -> str:
    """Return one sentence on the scenarios that are compared."""
    assert fresh.draw is not None
    return (
        f"{len(public.seeds)} public and {len(fresh.seeds)} fresh scenarios of `{public.suite}`, the fresh ones drawn "
        f"from commit {fresh.draw['commit'][:12]} and a secret of sha256 {fresh.draw['secret_sha256'][:12]}…"
    )
