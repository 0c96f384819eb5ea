"""The front of support and energy."""

from __future__ import annotations

import dataclasses

from wtg_gym.evaluation import EntrySummary, evaluate
from wtg_gym.plotting import plot_front
from wtg_gym.plotting.front import undominated


def rows(**places: tuple[float, float, float]) -> list[EntrySummary]:
    """Return summaries by name: captured energy [%], points of frequency and RoCoF, failures [%]."""
    (row, *_) = evaluate([], "paper", "test").summaries
    return [
        dataclasses.replace(
            row,
            name=name,
            mean_energy_share_percent=energy,
            points_by_term={**row.points_by_term, "frequency_rocof": points},
            failures_percent=failures,
        )
        for name, (energy, points, failures) in places.items()
    ]


def test_front_is_what_no_other_one_beats_in_both() -> None:
    found = undominated(
        rows(
            much=(98.0, -50.0, 0.0),
            middle=(95.0, 0.0, 5.0),
            beaten=(94.0, -1.0, 0.0),
            equal_energy=(95.0, -3.0, 0.0),
            support=(90.0, 30.0, 0.0),
            fails=(99.0, 40.0, 5.1),
        )
    )
    assert [row.name for row in found] == ["support", "middle", "much"]
    # Neither of two equal ones beats the other.
    assert len(undominated(rows(one=(95.0, 1.0, 0.0), twin=(95.0, 1.0, 0.0)))) == 2


def test_entries_that_fail_too_often_are_hollow_and_not_joined() -> None:
    given = rows(much=(98.0, -50.0, 0.0), fails=(99.0, 40.0, 6.0), support=(90.0, 30.0, 0.0))
    (axes,) = plot_front(given).axes
    drawn = {line.get_label(): line for line in axes.lines}
    assert {name: drawn[name].get_markerfacecolor() == "white" for name in ("much", "fails", "support")} == {
        "much": False,
        "fails": True,
        "support": False,
    }
    joined = [list(zip(*line.get_data(), strict=True)) for line in axes.lines]
    assert [(90.0, 30.0), (98.0, -50.0)] in joined
