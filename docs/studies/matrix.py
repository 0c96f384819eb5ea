"""Whether a policy generalises: every entry of version v1 on its drawn suites, and with other sensors.

    python docs/studies/matrix.py [--output DOCS]

puts the scores into DOCS/benchmark.md. The results of each column are stored in results/, and used again where they
would come out the same today, as by `wtg-gym leaderboard`. Half a day on two processors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from output import folder as output_folder

from wtg_gym.cli.scoring import chosen_entries, run_evaluation
from wtg_gym.evaluation import Results, leaderboard_rows, table_cells
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.sensor_distribution import DELAY_STEP_S

FOLDER = Path("results")
OWN = get_suite("standard-v1").sensors
#: Folder of the results, suite, and other sensors than the suite's own, by the heading of the column.
COLUMNS = {
    **{
        name: (FOLDER, f"{name}-v1", {})
        for name in ("standard", "low-share", "high-share", "gusty", "no-wind-sensor", "faults")
    },
    **{
        f"standard, delay +{steps * DELAY_STEP_S:g} s": (
            FOLDER / f"delay-plus-{steps}",
            "standard-v1",
            {"delay_s": tuple(round(delay + steps * DELAY_STEP_S, 9) for delay in OWN.delay_s)},
        )
        for steps in (1, 2)
    },
    "standard, wind bias × 2": (FOLDER / "wind-bias-times-2", "standard-v1", {"wind_bias": 2.0 * OWN.wind_bias}),
}


def played(folder: Path, suite: str, sensors: Mapping[str, object]) -> Results:
    """Return the results of a column, which are stored."""
    scenarios = {"suite": suite, "split": "test", **({"sensors": sensors} if sensors else {})}
    entries = chosen_entries(("baselines", "policies"), suite)
    found = run_evaluation(entries, partial=folder / "partial", **scenarios)
    # Without its parts, which would be removed once the results are written.
    replace(found, parts=None).write(folder)
    return found


def section(columns: Mapping[str, Results]) -> str:
    """Return what the columns are, and the table of mean scores, the best in the first column first."""
    first = next(iter(columns.values()))
    scores = [each.scores for each in columns.values()]
    rows = leaderboard_rows(first)
    cells = [
        [label, *(f"{round(own[row.name].value, 1) + 0.0:.1f}" for own in scores)]
        for row, (label,) in zip(rows, table_cells(rows, ("entry",)), strict=True)
    ]
    return (
        f"Scores on {len(first.seeds)} test scenarios per column. Sensors do not affect the laws that score 0 and 100: "
        "with changed sensors the scale remains that of the suite.\n\n"
        + markdown_table(("entry", *columns), cells, right=range(1, 1 + len(columns)))
    )


if __name__ == "__main__":
    docs = output_folder(__doc__)
    columns = {heading: played(*each) for heading, each in COLUMNS.items()}
    update_between_markers(docs / "benchmark.md", section(columns), "matrix")
