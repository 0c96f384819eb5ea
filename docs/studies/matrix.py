"""Whether a policy generalises: every entry of version v1 on its drawn suites, and with faults that no suite has.

    python docs/studies/matrix.py [--output DOCS]

puts two tables into DOCS/benchmark.md. The results of a suite are kept in results/matrix and used again where they
would come out the same today. On two processors a suite takes two minutes, a fault as long.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from output import folder as output_folder

from wtg_gym.cli.scoring import chosen_entries, run_evaluation
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, EntrySummary, Results, leaderboard_rows, table_cells
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.evaluator import play_batch
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import GovernorLoss, Scenario
from wtg_gym.policies import PolicyError
from wtg_gym.scenarios import get_suite
from wtg_gym.tasks import V1
from wtg_gym.tasks.episode import ACTION_MODES

OWN, FOLDER, PARTIAL = "standard-v1", Path("results/matrix"), Path("results/partial")
SUITES = tuple(
    f"{n}-v1" for n in ("standard", "low-share", "high-share", "gusty", "no-wind-sensor", "faults", "weak-grid")
)
#: Test scenarios that all is played on: as many of each stratum, and of each kind of extreme event.
N_SCENARIOS = 300
#: Those that are played side by side.
BATCH = 64
#: The frequency sensor hangs from this step on.
HANGS_AT = 100


def measured(scenario: Scenario, **sensors: Any) -> Scenario:
    """Return a scenario with other sensors."""
    return replace(scenario, sensors=replace(scenario.sensors, **sensors))


def without_governor(scenario: Scenario) -> Scenario:
    """Return a scenario in which the governor does not act."""
    events = tuple(event for event in scenario.events if not isinstance(event, GovernorLoss))
    return replace(scenario, events=(GovernorLoss(time_s=0.0, bus=1), *events))


def hanging(seen: Floats, kept: Floats) -> None:
    """Let the frequency stay at its last value: it does not change."""
    seen[:, 0], seen[:, 1] = kept[:, 0], 0.0


def silent(seen: Floats, _kept: Floats) -> None:
    """Let every entry of the observation be 0, as of a turbine at rated speed, 50 Hz and 10 m/s."""
    seen[:, : V1.n_local] = 0.0


#: By the heading of their columns: changes of the scenario, and, with the step from which on, faults of the sensors of
#: the first group, the largest.
CHANGES: dict[str, Callable[[Scenario], Scenario]] = {
    "delay +0.5 s": lambda drawn: measured(drawn, delay_s=round(drawn.sensors.delay_s + 0.5, 9)),
    "wind bias × 4": lambda drawn: measured(drawn, wind_bias=tuple(4.0 * bias for bias in drawn.sensors.wind_bias)),
    "half the inertia": lambda drawn: replace(drawn, inertia_scale=0.5 * drawn.inertia_scale),
    "no governor": without_governor,
}
FAULTS = {"a frequency sensor hangs": (hanging, HANGS_AT), "a group's observation is 0": (silent, 0)}


@dataclass
class FaultyPolicy:
    """A policy that sees what failing sensors say; its state is the step, what they said last, and its own state."""

    policy: Any
    width: int  # numbers of the first group in an observation
    fault: Callable[[Floats, Floats], None]
    since: int  # step

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        step, kept, own = (0, None, None) if state is None else state
        seen = np.array(observation)
        if step <= self.since:
            kept = seen[:, : self.width].copy()
        if step >= self.since:
            self.fault(seen[:, : self.width], kept)
        actions, own = self.policy.predict(seen, state=own, episode_start=episode_start, deterministic=deterministic)
        return actions, (step + 1, kept, own)

    def close(self) -> None:
        """End the policy's process, where it has one."""
        getattr(self.policy, "close", lambda: None)()


def with_fault(entry: Entry, fault: Callable[[Floats, Floats], None], since: int) -> Entry:
    """Return an entry with failing sensors; a law has none."""
    if entry.policy is None:
        return entry
    width = V1.n_local + sum(ACTION_MODES[entry.action_mode])
    return replace(entry, policy=FaultyPolicy(entry.policy, width, fault, since))


def entries_of(suite: str) -> list[Entry]:
    """Return all entries; of several training seeds the first."""
    found: dict[str, Entry] = {}
    for entry in chosen_entries(("baselines", "policies"), suite):
        found.setdefault(entry.name, entry)
    return list(found.values())


def on_suite(suite: str) -> Results:
    """Return the results on a suite's first test scenarios, which are kept."""
    where = {"suite": suite, "split": "test", "seeds": get_suite(suite).test[:N_SCENARIOS]}
    found = run_evaluation(entries_of(suite), partial=PARTIAL, **where)
    # Without its parts, which would be removed once the results are written.
    replace(found, parts=None).write(FOLDER)
    return found


def played(
    entries: Sequence[Entry], results: Results, change: Callable[[Scenario], Scenario] = lambda scenario: scenario
) -> Results:
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
        heading: played([with_fault(entry, *fault) for entry in entries], results) for heading, fault in FAULTS.items()
    }
    return changed | failing


def cell(row: EntrySummary | None) -> str:
    """Return score and mark of an entry."""
    if row is None or row.score is None:
        return "–"
    return f"{round(row.score.value, 1) + 0.0:.1f}{' ✓' if row.marked else ''}"


def table(columns: Mapping[str, Results], first: Results) -> str:
    """Return a cell by entry and column, the best in `first` first, and below where marks are lost."""
    rows = leaderboard_rows(first)
    own = {heading: {row.name: row for row in results.ranking} for heading, results in columns.items()}
    cells = [
        [label, *(cell(of_column.get(row.name)) for of_column in own.values())]
        for row, (label,) in zip(rows, table_cells(rows, ("entry",)), strict=True)
    ]
    lost = {
        row.name: [heading for heading, of_column in own.items() if not of_column.get(row.name, row).marked]
        for row in rows
        if row.marked
    }
    said = "; ".join(f"{name} in {', '.join(headings)}" for name, headings in lost.items() if headings)
    shown = markdown_table(("entry", *columns), cells, right=range(1, 1 + len(columns)))
    return f"{shown}\n\nThe mark is lost: {said or 'by no entry'}."


def section(suites: Mapping[str, Results], faults: Mapping[str, Results]) -> str:
    """Return both tables and what they show."""
    first = suites[OWN]
    return (
        f"Score and mark ✓ on the first {len(first.seeds)} test scenarios of a suite, by the first training seed:\n\n"
        f"{table(suites, first)}\n\nOn those of `{OWN}` with something changed, which the references meet too:\n\n"
        f"{table(faults, first)}"
    )


if __name__ == "__main__":
    docs = output_folder(__doc__)
    suites = {suite: on_suite(suite) for suite in SUITES}
    left = {entry["name"] for entry in suites[OWN].entries}
    entries = [entry for entry in entries_of(OWN) if entry.name in left]
    faults = with_faults(entries, suites[OWN])
    update_between_markers(docs / "benchmark.md", section(suites, faults), "matrix")
