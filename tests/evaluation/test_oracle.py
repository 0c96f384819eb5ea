"""Facts about the oracle's files, and about the share of its gap that an entry closes."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wtg_gym.evaluation import Results, evaluate, leaderboard_rows, oracle, table_cells
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.oracle import FOLDER, OracleCosts
from wtg_gym.evaluation.score import pinned
from wtg_gym.evaluation.summary import EntrySummary
from wtg_gym.files import sha256, to_json
from wtg_gym.scenarios import FROZEN_HASHES, get_suite


@pytest.fixture
def made(results: Results) -> OracleCosts:
    """An oracle of the short evaluation's scenarios: a tenth below the reference."""
    reference = tuple(pinned(episode, 50.0) for episode in results.episodes_of("coordinated-piecewise"))
    return OracleCosts(
        suite=results.suite,
        split=results.split,
        suite_hash=results.suite_hash,
        source_hash=results.source_hash,
        settings=results.settings,
        search={"generations": 3},
        entries=[{"name": "mine", "training_seed": None, "sha256": None}],
        seeds=results.seeds,
        reference=reference,
        found={"course": tuple(0.9 * cost for cost in reference), "entries": tuple(2.0 * cost for cost in reference)},
    )


@pytest.fixture
def folder(made: OracleCosts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The package's folder, with that oracle instead of its own."""
    made.write(tmp_path)
    monkeypatch.setattr(oracle, "FOLDER", tmp_path)
    return tmp_path


def _row(results: Results, name: str) -> EntrySummary:
    return next(row for row in results.summaries if row.name == name)


def _cheaper(results: Results) -> Results:
    """Results in which "deloaded-10" costs a twentieth less than the reference: half as far as the oracle."""
    metrics = {e.seed: e.metrics for e in results.episodes_of("coordinated-piecewise")}
    cheaper = [
        dataclasses.replace(e, metrics={**metrics[e.seed], "cost": 0.95 * (metrics[e.seed]["cost"] or 0.0)})
        if e.entry == "deloaded-10"
        else e
        for e in results.episodes
    ]
    return dataclasses.replace(results, episodes=tuple(cheaper))


def test_share_is_that_of_the_mean_costs_in_summary_table_and_files(
    results: Results, made: OracleCosts, folder: Path, tmp_path: Path
) -> None:
    fresh = _cheaper(results)
    assert fresh.oracle.missing == "" and fresh.oracle.costs == dict(zip(made.seeds, made.oracle, strict=True))
    share = _row(fresh, "deloaded-10").gap_closed_percent
    assert share is not None and (share.value, share.low, share.high) == pytest.approx((50.0, 50.0, 50.0))
    cells = dict(table_cells(leaderboard_rows(fresh), ("entry", "gap closed [%]")))
    assert cells == {"deloaded-10": "50.0", "coordinated-piecewise": "", "mppt": ""}
    assert Results.read(fresh.write(tmp_path / "results")[0]).to_dict() == fresh.to_dict()


def test_scenarios_without_an_oracle_are_left_out_and_counted(
    results: Results, made: OracleCosts, folder: Path
) -> None:
    found = {"course": made.found["course"][:2]}
    dataclasses.replace(made, seeds=made.seeds[:2], reference=made.reference[:2], found=found).write(folder)
    cells = table_cells(leaderboard_rows(_cheaper(results)), ("entry", "gap closed [%]"))
    assert dict(cells)["deloaded-10"] == "50.0 (n = 2)"


def _episodes(results: Results, make: Callable[[Episode], dict[str, Any]], **changes: Any) -> Results:
    return dataclasses.replace(
        results, episodes=tuple(dataclasses.replace(e, **make(e)) for e in results.episodes), **changes
    )


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda r: dataclasses.replace(r, suite_hash="0" * 64), "is of another suite, of hash ebb8c5bcdf75"),
        (lambda r: dataclasses.replace(r, split="validation"), "there is no oracle for the validation scenarios of"),
        (
            lambda r: dataclasses.replace(
                r, settings={**r.settings, "weights": {**r.settings["weights"], "duty": 1.0}}
            ),
            "the oracle was found for other settings: weights",
        ),
        # A reference that costs otherwise betrays another physics.
        (
            lambda r: _episodes(r, lambda e: {"metrics": {**e.metrics, "cost": (e.metrics["cost"] or 0.0) * 1.0001}}),
            "the oracle was found for another physics or cost: in the scenario of seed 20002",
        ),
        (
            lambda r: _episodes(r, lambda e: {"seed": e.seed + 100}, seeds=tuple(seed + 100 for seed in r.seeds)),
            "none of these scenarios has an oracle",
        ),
    ],
)
def test_no_share_of_another_problems_oracle(
    results: Results, folder: Path, change: Callable[[Results], Results], why: str
) -> None:
    other = change(results)
    assert why in other.oracle.missing and other.oracle.costs == {}
    assert {(row.gap_closed_percent, row.n_oracle) for row in other.summaries} == {(None, 0)}


def test_read_gives_back_what_was_written(made: OracleCosts, folder: Path) -> None:
    read = OracleCosts.read(folder / "standard-test.json")
    assert read == made and read.oracle == made.found["course"]
    before = [path.read_bytes() for path in sorted(folder.iterdir())]
    read.write(folder)
    assert [path.read_bytes() for path in sorted(folder.iterdir())] == before


def test_impossible_or_edited_files_are_refused_and_no_evaluation_is_lost_over_them(
    folder: Path, results: Results
) -> None:
    json_path, csv_path = folder / "standard-test.json", folder / "standard-test.csv"
    text = csv_path.read_text(encoding="utf-8")
    for old, new, signed, why in (
        ("20000,", "20001,", False, "was edited"),
        ("20000,", "20002,", True, "an oracle needs scenarios, each once"),
        ("20000,", "x,", True, "invalid literal for int"),
        ("20000,", "20000,-", True, "finite and not negative"),
        ("seed,", "Seed,", True, "is no table of the oracle"),
    ):
        csv_path.write_text(text.replace(old, new, 1), encoding="utf-8", newline="")
        if signed:
            data = json.loads(json_path.read_text(encoding="utf-8"))
            data["csv_sha256"] = sha256(csv_path.read_bytes())
            del data["sha256"]
            json_path.write_text(to_json({**data, "sha256": sha256(to_json(data).encode())}), encoding="utf-8")
        with pytest.raises(ValueError, match=rf"standard-test\.csv.*{why}"):
            OracleCosts.read(json_path)
        fresh = dataclasses.replace(results)
        assert why in fresh.oracle.missing and _row(fresh, "mppt").gap_closed_percent is None


SHIPPED = sorted(FOLDER.glob("*.json"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_costs_are_of_this_benchmark(path: Path) -> None:
    known = OracleCosts.read(path)
    assert path.stem == f"{known.suite}-{known.split}" and known.suite_hash == FROZEN_HASHES[known.suite]
    assert known.seeds == tuple(get_suite(known.suite).seeds(known.split)[: len(known.seeds)])
    assert np.mean(known.oracle) < 0.95 * np.mean(known.reference)
    # Physics, cost and settings are still those that were searched.
    seeds = known.seeds[:3]
    results = evaluate([], known.suite, known.split, seeds=seeds)
    assert results.oracle.missing == "" and tuple(results.oracle.costs) == seeds
