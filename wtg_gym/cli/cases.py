"""`wtg-gym simulate --case`: tests that operators ask of grid-forming plants, passed or failed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from wtg_gym.cli.output import print_json, print_table
from wtg_gym.cli.scoring import look_into_working_folder
from wtg_gym.evaluation.grid_tests import GRID_TESTS, get_grid_test, run_grid_test
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.progress import Progress


def play_cases(names: Sequence[str], specs: Sequence[str], *, json: bool) -> int:
    """Play entries through tests, and print verdicts and figures; return 1 where one has failed, else 0."""
    expanded = [each for name in names for each in (GRID_TESTS if name == "all" else (name,))]
    tests = [get_grid_test(name) for name in dict.fromkeys(expanded)]
    look_into_working_folder(specs)
    entries = load_entries(specs)
    rows: list[dict[str, Any]] = []
    with Progress("cases") as progress:
        for done, (test, entry) in enumerate((test, entry) for test in tests for entry in entries):
            progress.update(f"{test.name} {entry.label}", done, len(tests) * len(entries))
            _, (passed, figure) = run_grid_test(test, entry)
            rows.append({"case": test.name, "entry": entry.label, "passed": passed, "figure": figure})
    if json:
        print_json(rows)
    else:
        cells = [(row["case"], row["entry"], "passed" if row["passed"] else "failed", row["figure"]) for row in rows]
        print_table(("case", "entry", "verdict", "figure"), cells, left=(0, 1, 2, 3))
    return int(not all(row["passed"] for row in rows))
