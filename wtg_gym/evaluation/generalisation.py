"""The generalisation gap: the score on the public test scenarios minus the score on fresh ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.results import Results, leaderboard_rows
from wtg_gym.evaluation.statistics import Floats, Interval
from wtg_gym.evaluation.table import signed_interval
from wtg_gym.scenarios import FRESH

#: Headings of the table; the first column holds text.
COLUMNS = ("entry", "public", "fresh", "gap")


@dataclass(frozen=True, kw_only=True)
class GeneralisationGap:
    """One entry's gap."""

    name: str  # of the entry
    #: public, fresh: its scores.
    public: Interval
    fresh: Interval
    gap: Interval  # public minus fresh


def generalisation_gaps(public: Results, fresh: Results) -> list[GeneralisationGap]:
    """Return the gaps of all entries that both results hold with the same policies, the best on public ones first.

    Raises:
        ValueError: the results are not on "test" and "fresh", or of different suites, settings or source code.
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
    left = left_out(public, fresh)
    gains, scores = (public.log_gains, fresh.log_gains), fresh.scores
    zeros = [own[public.benchmark.zero][0] for own in gains]
    return [
        GeneralisationGap(
            name=row.name,
            public=public.scores[row.name],
            fresh=scores[row.name],
            gap=score_gap(*((own[row.name], zero) for own, zero in zip(gains, zeros, strict=True))),
        )
        for row in leaderboard_rows(public)
        if row.name not in (*public.benchmark.anchors, *left)
    ]


def score_gap(public: tuple[Floats, Floats], fresh: tuple[Floats, Floats]) -> Interval:
    """Return the score on public scenarios minus that on fresh ones, with its bootstrap interval.

    The training seeds of a resample are the same on both sides. The scenarios are drawn on each side independently, and
    Λ is computed anew from those that were drawn; a resample counts if both sides have a positive Λ.

    Args:
        public, fresh: log gains of the entry (n_runs, n_scenarios) and of the zero (n_scenarios,), see
            :func:`wtg_gym.evaluation.score.log_gains`.
    """
    n_runs = public[0].shape[0]
    streams = [np.random.default_rng(seed) for seed in np.random.SeedSequence(statistics.BOOTSTRAP_SEED).spawn(3)]
    runs = streams[0].integers(0, n_runs, size=(statistics.N_RESAMPLES, n_runs))
    value, scored = 0.0, np.ones(statistics.N_RESAMPLES, dtype=np.bool_)
    resampled = np.zeros(statistics.N_RESAMPLES)
    for sign, stream, (gains, zero) in zip((1.0, -1.0), streams[1:], (public, fresh), strict=True):
        value += sign * statistics.mean(gains) / -statistics.mean(zero)
        scenarios = stream.integers(0, zero.size, size=(statistics.N_RESAMPLES, zero.size))
        means = np.take_along_axis(gains[:, scenarios].mean(axis=2).T, runs, axis=1).mean(axis=1)
        scale = -zero[scenarios].mean(axis=1)
        resampled += sign * (100.0 * means / scale)
        scored &= scale > 0.0
    return statistics.percentile_interval(100.0 * value, resampled[scored])


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
    return [[g.name, f"{g.public.value:.1f}", f"{g.fresh.value:.1f}", signed_interval(g.gap)] for g in gaps]


def describe(public: Results, fresh: Results) -> str:
    """Return one sentence on the scenarios that are compared."""
    assert fresh.draw is not None
    return (
        f"{len(public.seeds)} public and {len(fresh.seeds)} fresh scenarios of `{public.suite}`, the fresh ones drawn "
        f"from commit {fresh.draw['commit'][:12]} and a secret of sha256 {fresh.draw['secret_sha256'][:12]}…"
    )
