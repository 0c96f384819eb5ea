"""The generalisation gap: what an entry scores on the public test scenarios more than on fresh ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from wtg_gym import files
from wtg_gym.evaluation import statistics
from wtg_gym.evaluation.entries import ANCHORS
from wtg_gym.evaluation.leaderboard import leaderboard_rows
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.statistics import Floats, Interval
from wtg_gym.scenarios import VERIFICATION

#: With fewer the regression on the controls fits noise.
_FEWEST_FRESH = 30
#: Headings of the table, and whether the column holds numbers.
COLUMNS: dict[str, bool] = {"entry": False, "public": True, "fresh": True, "gap": True, "excess": True, "": False}


@dataclass(frozen=True, kw_only=True)
class GeneralisationGap:
    """One entry's gap.

    Args:
        name: name of the entry.
        public, fresh: its scores.
        gap: public minus fresh.
        excess: the part of the gap that the controllers made by hand do not share, see
            :func:`wtg_gym.evaluation.statistics.excess_gap`; None for these, and with fewer than 30 fresh scenarios.
    """

    name: str
    public: Interval
    fresh: Interval
    gap: Interval
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
        fresh: results on the split "verification" of the same suite, with the same settings.

    Raises:
        ValueError: the results are not of these splits, or of different suites, settings or source code.
        NoScaleError: there is no score, see :attr:`Results.summaries`.
    """
    if (public.split, fresh.split) != ("test", VERIFICATION):
        raise ValueError(
            f"a gap is between results on the splits 'test' and {VERIFICATION!r}, in this order; "
            f"got {public.split!r} and {fresh.split!r}"
        )
    for key in ("suite", "suite_hash", "source_hash", "settings"):
        if getattr(public, key) != getattr(fresh, key):
            raise ValueError(f"the two results are of another {key.replace('_', ' ')}: evaluate both again")
    shared = set(_shared(public, fresh)) - {ANCHORS[1]}
    rows = [row for row in leaderboard_rows(public) if row.name in shared]
    controls = [row.name for row in rows if row.kind != "learned"]
    scores = {row.name: row.score for row in fresh.summaries}
    gains = public.log_gains, fresh.log_gains
    return [
        GeneralisationGap(
            name=row.name,
            public=row.score,
            fresh=scores[row.name],
            gap=statistics.score_gap(*((own[row.name], own[ANCHORS[0]][0]) for own in gains)),
            excess=None if row.kind != "learned" else _excess(row.name, controls, *gains),
        )
        for row in rows
        if row.name != ANCHORS[0]
    ]


def _excess(name: str, controls: Sequence[str], public: dict[str, Floats], fresh: dict[str, Floats]) -> Interval | None:
    one, other = ((own[name], np.concatenate([own[control] for control in controls])) for own in (public, fresh))
    if other[0].shape[1] < _FEWEST_FRESH:
        return None
    return statistics.excess_gap(one, other, -statistics.mean(fresh[ANCHORS[0]]))


def left_out(public: Results, fresh: Results) -> list[str]:
    """Return the entries that only one of the results holds, or whose policies differ."""
    names = {entry["name"]: None for each in (public, fresh) for entry in each.entries}
    shared = _shared(public, fresh)
    return [name for name in names if name not in shared]


def _shared(public: Results, fresh: Results) -> list[str]:
    """Return the names that stand for the same policies, known by their sha256, in both results."""
    first, second = ({name: _policies(each, name) for name in _names(each)} for each in (public, fresh))
    return [name for name, own in first.items() if second.get(name) == own and None not in [key for _, key in own]]


def _names(results: Results) -> list[str]:
    return list(dict.fromkeys(entry["name"] for entry in results.entries))


def _policies(results: Results, name: str) -> list[tuple[int | None, str | None]]:
    return [(entry["training_seed"], entry["sha256"]) for entry in results.entries if entry["name"] == name]


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


def signed_interval(interval: Interval) -> str:
    """Return a difference of scores and its interval, with their signs."""
    value, low, high = (round(x, 1) + 0.0 for x in (interval.value, interval.low, interval.high))
    return f"{value:+.1f} ({low:+.1f} … {high:+.1f})"


def gap_page(public: Results, fresh: Results, gaps: Sequence[GeneralisationGap]) -> str:
    """Return what was compared, and the table, as Markdown without a line feed at the end."""
    numbers = [index for index, is_number in enumerate(COLUMNS.values()) if is_number]
    table = files.markdown_table(list(COLUMNS), gap_cells(gaps), right=numbers)
    return f"{describe(public, fresh)}\n\n{table}"


def describe(public: Results, fresh: Results) -> str:
    """Return one sentence on what is compared."""
    assert fresh.draw is not None
    return (
        f"{len(public.seeds)} public and {len(fresh.seeds)} fresh scenarios of `{public.suite}`, the fresh ones drawn "
        f"from commit {fresh.draw['commit'][:12]} and a secret of sha256 {fresh.draw['secret_sha256'][:12]}…"
    )


__all__ = [
    "COLUMNS",
    "GeneralisationGap",
    "describe",
    "gap_cells",
    "gap_page",
    "generalisation_gaps",
    "left_out",
    "signed_interval",
]
