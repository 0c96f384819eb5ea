"""Policies of one group on grids that they have never seen: trained on 14 buses, scored on all.

    python docs/studies/transfer.py [--output DOCS]

puts a table into DOCS/grids.md: laws, and the shipped policies with per_group = true, on the suites of all grids.
"""

from __future__ import annotations

from output import folder as output_folder

from wtg_gym.evaluation import Results, evaluate, load_entries
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import V1

SUITES = ("standard-v1", "ieee39-v1", "kundur-v1", "nordic45-v1")
N_SCENARIOS = 300


def played(suite: str) -> Results:
    """Return the results of laws and policies of one group on a suite's first test scenarios."""
    entries = [entry for entry in load_entries("baselines", V1) if entry.policy is None]
    entries += [entry for entry in load_entries("policies", V1) if entry.per_group]
    with Progress("episodes") as progress:
        seeds = get_suite(suite).test[:N_SCENARIOS]
        return evaluate(entries, suite, "test", seeds=seeds, on_progress=progress.update, keep_going=True)


def table(columns: dict[str, Results]) -> str:
    """Return score and share of bad runs of every entry, a column per suite."""
    rows = {name: {row.name: row for row in results.ranking} for name, results in columns.items()}
    names = list(rows[SUITES[0]])

    def cell(suite: str, name: str) -> str:
        row = rows[suite].get(name)
        if row is None or row.score is None:
            return "–"
        return f"{row.score.value:.1f}{' ✓' if row.marked else ''}; {row.lost_or_beyond_percent:.1f} %"

    cells = [[name, *(cell(suite, name) for suite in columns)] for name in names]
    return markdown_table(("entry", *columns), cells, right=range(1, 1 + len(columns)))


if __name__ == "__main__":
    docs = output_folder(__doc__)
    update_between_markers(docs / "grids.md", table({suite: played(suite) for suite in SUITES}), "transfer")
