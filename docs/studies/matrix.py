"""For docs/benchmark.md: every entry of version v1 on its drawn suites, and with faults that no suite has.

Results of a suite are kept in results/matrix for the next time. On two processors it takes five minutes.
"""

import copy
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from output import DOCS

from wtg_gym.cli.scoring import chosen_entries, run_evaluation
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, EntrySummary, Results, leaderboard_rows, table_cells
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.evaluator import play_batch
from wtg_gym.evaluation.faults import SENSOR_FAULTS, WORSE_SENSORS, with_fault
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.scenario import GovernorLoss, Scenario
from wtg_gym.policies import PolicyError
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks import V1

OWN, FOLDER = "standard-v1", Path("results/matrix")
SUITES = tuple(
    f"{n}-v1" for n in ("standard", "low-share", "high-share", "gusty", "no-wind-sensor", "faults", "weak-grid")
)
#: Test scenarios that all is played on: as many of each stratum, and of each kind of extreme event.
N_SCENARIOS = 120
#: Those that are played side by side.
BATCH = 64


def without_governor(scenario: Scenario) -> Scenario:
    """Return a scenario in which the governor does not act."""
    events = tuple(event for event in scenario.events if not isinstance(event, GovernorLoss))
    return replace(scenario, events=(GovernorLoss(time_s=0.0, bus=1), *events))


#: Changes of the scenario by the heading of their columns.
CHANGES: dict[str, Callable[[Scenario], Scenario]] = {
    **WORSE_SENSORS,
    "half the inertia": lambda drawn: replace(drawn, inertia_scale=0.5 * drawn.inertia_scale),
    "no governor": without_governor,
}


def entries_of(suite: str) -> list[Entry]:
    """Return all entries; of several training seeds the first."""
    entries = chosen_entries(("baselines", "policies"), suite)
    return list(reversed({entry.name: entry for entry in reversed(entries)}.values()))


def on_suite(suite: str) -> Results:
    """Return the results on a suite's first test scenarios, which are kept."""
    where = {"suite": suite, "split": "test", "seeds": get_suite(suite).test[:N_SCENARIOS]}
    results = run_evaluation(entries_of(suite), FOLDER.parent, **where)
    # Without its parts, which would be removed once the results are written.
    replace(results, parts=None).write(FOLDER)
    return results


def played(entries: Sequence[Entry], results: Results, change=lambda scenario: scenario) -> Results:
    """Return results in which the same entries have played the same test scenarios of `OWN`, each changed."""
    scenarios = [change(scenario) for scenario in get_suite(OWN).scenarios(results.seeds)]
    settings = EnvSettings(suite=OWN, split="test")

    def batch(part: tuple[Entry, int]) -> list[Episode]:
        entry, first = part
        # Every part has a process of its own for a policy in a file.
        policy = copy.deepcopy(entry.policy)
        try:
            episodes = play_batch(replace(entry, policy=policy), settings, scenarios[first : first + BATCH], 1)
        finally:
            getattr(policy, "close", lambda: None)()
        if isinstance(episodes, PolicyError):
            raise episodes
        return episodes

    parts = [(entry, first) for entry in entries for first in range(0, len(scenarios), BATCH)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return replace(results, episodes=tuple(episode for part in pool.map(batch, parts) for episode in part))


def with_faults(entries: Sequence[Entry], results: Results) -> dict[str, Results]:
    """Return the results of every change and fault by its heading."""
    # Of changed scenarios the control variates' mean gains are not known.
    changed = {
        heading: replace(played(entries, results, change), settings={**results.settings, "scenarios": heading})
        for heading, change in CHANGES.items()
    }
    failing = {
        heading: played([with_fault(entry, *fault) for entry in entries], results)
        for heading, fault in SENSOR_FAULTS.items()
    }
    return changed | failing


def cell(row: EntrySummary | None) -> str:
    """Return the score of an entry, and ✗ where it has no mark."""
    if row is None or row.score is None:
        return "–"
    return f"{round(row.score.value, 1) + 0.0:.1f}{'' if row.marked else ' ✗'}"


def table(columns: Mapping[str, Results], first: Results) -> str:
    """Return a cell by entry and column, for the entries above the law at 100 in `first`, from the best."""
    rows, ranked = above_hundred(first), ranks(columns)
    cells = [
        [label, *(cell(by_name.get(row.name)) for by_name in ranked.values())]
        for row, (label,) in zip(rows, table_cells(rows, ("entry",)), strict=True)
    ]
    return markdown_table(("entry", *columns), cells, right=range(1, 1 + len(columns)))


def above_hundred(first: Results) -> list[EntrySummary]:
    """Return the entries above the law at 100, which scores 100 in every column."""
    rows = leaderboard_rows(first)
    return rows[: [row.name for row in rows].index(V1.hundred)]


def ranks(columns: Mapping[str, Results]) -> dict[str, dict[str, EntrySummary]]:
    """Return the summary of every entry by column and name."""
    return {heading: {row.name: row for row in results.ranking} for heading, results in columns.items()}


def marks_lost(columns: Mapping[str, Results], first: Results) -> str:
    """Return which entries lose their mark, and in which columns."""
    ranked = ranks(columns)
    lost = {
        row.name: [heading for heading, by_name in ranked.items() if not by_name.get(row.name, row).marked]
        for row in above_hundred(first)
        if row.marked
    }
    named = "; ".join(f"{name} in {', '.join(headings)}" for name, headings in lost.items() if headings)
    return f"The mark is lost: {named}." if named else "No entry loses its mark."


def section(suites: Mapping[str, Results], faults: Mapping[str, Results]) -> str:
    """Return both tables and what they show."""
    first = suites[OWN]
    return (
        f"Score (✗: no mark) on the first {len(first.seeds)} test scenarios of a suite, by the first training seed:\n\n"
        f"{table(suites, first)}\n\n–: its network does not fit that grid.\n\n"
        f"On those of `{OWN}` with something changed, which the references meet too:\n\n"
        f"{table(faults, first)}\n\n{marks_lost({**suites, **faults}, first)}"
    )


if __name__ == "__main__":
    suites = {suite: on_suite(suite) for suite in SUITES}
    scored = {entry["name"] for entry in suites[OWN].entries}
    entries = [entry for entry in entries_of(OWN) if entry.name in scored]
    faults = with_faults(entries, suites[OWN])
    update_between_markers(DOCS / "benchmark.md", section(suites, faults), "matrix")
