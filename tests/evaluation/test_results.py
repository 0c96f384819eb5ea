"""Facts about results and their files: the same bytes again, and nothing damaged is ever read."""

from __future__ import annotations

import dataclasses
import functools
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from wtg_gym.evaluation import METRICS, Entry, NoScaleError, Results, evaluate, leaderboard_rows
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.files import sha256, to_json
from wtg_gym.scenarios.benchmark import V0


@pytest.fixture(scope="session")
def written(results: Results, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return results.write(tmp_path_factory.mktemp("written"))


@pytest.fixture
def copies(written: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    paths = tuple(tmp_path / path.name for path in written)
    for source, target in zip(written, paths, strict=True):
        target.write_bytes(source.read_bytes())
    return paths[0], paths[1]


def test_second_run_writes_the_same_bytes(written: tuple[Path, Path], entries: list[Entry], tmp_path: Path) -> None:
    again = evaluate(entries, "standard", "test", seeds=(20_002, 20_000, 20_005), duration_s=10.0)
    for one, other in zip(again.write(tmp_path), written, strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_files_are_named_after_suite_and_split_and_nothing_is_left_beside_them(written: tuple[Path, Path]) -> None:
    assert sorted(path.name for path in written[0].parent.iterdir()) == ["standard-test.csv", "standard-test.json"]


def test_read_gives_back_what_was_written(written: tuple[Path, Path], results: Results) -> None:
    assert Results.read(written[0]) == results


def test_read_then_write_gives_the_same_bytes(written: tuple[Path, Path], tmp_path: Path) -> None:
    for one, other in zip(Results.read(written[0]).write(tmp_path), written, strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_results_say_what_their_version_adds_to_the_settings(
    results: Results, results_v1: Results, tmp_path: Path
) -> None:
    assert Results.read(results_v1.write(tmp_path)[0]) == results_v1
    assert set(results_v1.settings) - set(results.settings) == {
        *("version", "plant", "sensors", "duty_time_s", "physics")
    }
    assert (results_v1.settings["version"], results_v1.settings["duty_time_s"]) == ("v1", 15.0)
    assert results_v1.settings["weights"]["rotor"] == 20.0 and results_v1.settings["authority"]["k"] == 1.0
    assert [group["bus"] for group in results_v1.settings["plant"]["groups"]] == [2, 3, 6, 8]
    assert results_v1.settings["sensors"]["delay_s"] == [0.1, 0.3]
    assert results_v1.environment["id"] == "GFMWTG-14bus-v1"


def test_file_of_version_3_is_read_and_damage_in_it_is_found(copies: tuple[Path, Path], results: Results) -> None:
    data = json.loads(copies[0].read_text(encoding="utf-8"))
    del data["sha256"]
    data["format"] = 3
    for row in data["summary"].values():
        row["mean_cost"] = row.pop("mean_pinned_cost")
        del row["lost_or_beyond_percent"], row["n_lost"]
    copies[0].write_text(to_json({**data, "sha256": sha256(to_json(data).encode())}), encoding="utf-8")
    assert Results.read(copies[0]) == results
    copies[1].write_text(copies[1].read_text(encoding="utf-8").replace("49.", "50."), encoding="utf-8")
    with pytest.raises(ValueError, match="edited or belongs to another run"):
        Results.read(copies[0])


def test_json_is_strict_sorted_and_without_time_or_place(written: tuple[Path, Path]) -> None:
    text = written[0].read_text(encoding="utf-8")
    data = json.loads(text, parse_constant=lambda name: pytest.fail(name))
    assert list(data) == sorted(data)
    assert data["metrics"]["nadir_hz"]["unit"] == "Hz"
    assert set(data["versions"]) == {"wtg_gym", "numpy", "scipy", "numba", "python", "processor", "onnxruntime"}
    assert str(Path.home()) not in text and not re.search(r"20\d\d-\d\d-\d\dT", text)


@pytest.mark.parametrize(
    ("which", "anchors"),
    [("results", ("mppt", "coordinated-piecewise")), ("results_v1", ("coordinated-piecewise", "coordinated-tuned"))],
)
def test_summary_scores_the_anchors_exactly(
    which: str, anchors: tuple[str, str], request: pytest.FixtureRequest
) -> None:
    results = request.getfixturevalue(which)
    assert results.benchmark.anchors == anchors
    scores = {summary.name: summary.score for summary in results.summaries}
    zero, hundred = (scores[name] for name in anchors)
    assert (zero.value, zero.low, zero.high) == (0.0, 0.0, 0.0)
    assert (hundred.value, hundred.low, hundred.high) == (100.0, 100.0, 100.0)
    summary = next(s for s in results.summaries if s.name == anchors[1])
    assert summary.difference.value == 0.0 and summary.probability_of_improvement.value == 0.5


def test_failures_are_pinned_in_score_and_cost(results: Results) -> None:
    episodes = [dataclasses.replace(e, failure="stall") if e.entry == "deloaded-10" else e for e in results.episodes]
    failed = dataclasses.replace(results, episodes=tuple(episodes))
    before, after = (next(s for s in r.summaries if s.name == "deloaded-10") for r in (results, failed))
    assert (before.failures_percent, after.failures_percent) == (0.0, 100.0)
    assert after.mean_pinned_cost == 50.0 * (10.0 + 1.0) and (after.n_lost, after.n_episodes) == (3, 3)
    assert after.score.value < before.score.value and after.probability_of_improvement.value == 0.0


def test_training_seeds_share_a_row(results: Results) -> None:
    seeds = [Entry(name="many", strategy="coordinated-linear", training_seed=seed) for seed in (3, 1)]
    many = evaluate(seeds, "standard", "test", seeds=(20_002, 20_000, 20_005), duration_s=10.0)
    summary = next(s for s in many.summaries if s.name == "many")
    assert (summary.n_runs, summary.n_episodes) == (2, 6)
    assert len(many.summaries) == 3


def test_unknown_entry_in_results_lists_the_known(results: Results) -> None:
    assert [e.seed for e in results.episodes_of("mppt")] == [20_002, 20_000, 20_005]
    by_name = (results.scores, results.pinned_costs, results.log_gains)
    for look_up in (results.episodes_of, *(each.__getitem__ for each in by_name)):
        with pytest.raises(KeyError, match=r"unknown entry 'nobody'; choose one of .*deloaded-10"):
            look_up("nobody")


def test_no_score_where_mppt_is_not_worse(results: Results, tmp_path: Path) -> None:
    def swapped(episode: Episode) -> Episode:
        names = {V0.zero: V0.hundred, V0.hundred: V0.zero}
        return dataclasses.replace(episode, entry=names.get(episode.entry, episode.entry))

    swapped_ones = [swapped(episode) for episode in results.episodes]
    ordered = [e for entry in results.entries for e in swapped_ones if e.entry == entry["name"]]
    turned = dataclasses.replace(results, episodes=tuple(ordered))
    with pytest.raises(NoScaleError, match=r"mppt \(mean pinned cost .*\) is not worse than coordinated-piecewise"):
        leaderboard_rows(turned)
    # There is no ranking by the score, but the measurements are kept.
    again = Results.read(turned.write(tmp_path)[0])
    assert again.episodes == turned.episodes
    summary = again.to_dict()["summary"]
    assert set(summary) == {"mppt", "deloaded-10", "coordinated-piecewise"}
    for name, row in summary.items():
        assert row["mean_pinned_cost"] == np.mean(turned.pinned_costs[name]) and "score" not in row


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(which=st.integers(0, 1), data=st.data())
def test_damaged_file_never_passes(copies: tuple[Path, Path], which: int, data: st.DataObject) -> None:
    path = copies[which]
    original = path.read_bytes()
    position = data.draw(st.integers(0, len(original) - 1))
    damaged = data.draw(
        st.one_of(
            st.just(original[:position]),
            st.integers(1, 255).map(
                lambda bits: original[:position] + bytes([original[position] ^ bits]) + original[position + 1 :]
            ),
            st.binary(min_size=1, max_size=8).map(lambda more: original[:position] + more + original[position:]),
        )
    )
    path.write_bytes(damaged)
    try:
        with pytest.raises(ValueError, match=re.escape(path.stem)):
            Results.read(copies[0])
    finally:
        path.write_bytes(original)


def test_missing_file_is_named(copies: tuple[Path, Path]) -> None:
    copies[1].unlink()
    with pytest.raises(ValueError, match=r"cannot read the table of episodes .*standard-test\.csv"):
        Results.read(copies[0])
    copies[0].unlink()
    with pytest.raises(ValueError, match=r"cannot read the results file .*standard-test\.json"):
        Results.read(copies[0])


EDITS: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "number as text": (
        lambda d: d["settings"]["weights"].update(cap="much"),
        "settings must be an object in which weights.cap is a number",
    ),
    "unknown metric": (lambda d: d["metrics"].update(beauty={"unit": "-"}), "metrics.beauty must be left out"),
    "missing metric": (lambda d: d["metrics"].pop("cost"), "metrics.cost must be .*got None"),
    "other unit": (lambda d: d["metrics"]["cost"].update(unit="EUR"), "metrics.cost must be"),
    "missing key": (lambda d: d.pop("seeds"), r"missing keys \['seeds'\]"),
    "unknown key": (lambda d: d.update(winner="me"), r"unknown keys \['winner'\]"),
    "wrong seeds": (lambda d: d.update(seeds=[1.5]), "seeds must be a list of whole numbers"),
    "unknown suite": (lambda d: d.update(suite="easy"), "suite must be one of paper"),
    "short hash": (lambda d: d.update(suite_hash="abc"), "suite_hash must be 64 hexadecimal"),
    "other format": (lambda d: d.update(format=2), "format must be 4, that of this version, or 3, got 2; "),
    "seeds of no draw": (
        lambda d: d.update(split="fresh"),
        "draw must be given for the split 'fresh' alone",
    ),
    "draw of a frozen split": (
        lambda d: d.update(draw={"commit": "a" * 40, "secret_sha256": "0" * 64}),
        "draw must be given for the split",
    ),
    "seeds that cannot be drawn": (
        lambda d: d.update(split="fresh", draw={"commit": "a" * 40, "secret_sha256": "0" * 64}),
        "draw: seeds of a draw must be",
    ),
    "no fingerprint": (lambda d: d["environment"].pop("fingerprint"), "environment must be an object with id"),
    "wrong kind": (
        lambda d: d["entries"][0].update(kind="magic"),
        r"entries\[0\]: kind must be law, feedback or learned",
    ),
    "name that is markup": (
        lambda d: d["entries"][0].update(name="[me](https://example.org)\n"),
        r"entries\[0\]: name must be 1 … 60 printable",
    ),
    "nested too deeply": (
        lambda d: d["settings"].update(a=functools.reduce(lambda inner, _: [inner], range(100), 0)),
        "nested deeper than 20 levels",
    ),
    "no entries": (lambda d: d.update(entries=[]), "entries must be a list"),
    "better score": (lambda d: d["summary"]["mppt"]["score"].update(value=200.0), "sha256 does not fit"),
}


@pytest.mark.parametrize("case", EDITS)
def test_edited_json_names_file_and_key(copies: tuple[Path, Path], case: str) -> None:
    edit, text = EDITS[case]
    data = json.loads(copies[0].read_text(encoding="utf-8"))
    edit(data)
    copies[0].write_text(to_json(data), encoding="utf-8")
    with pytest.raises(ValueError, match=f"standard-test.json.*{text}"):
        Results.read(copies[0])


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
def test_number_that_is_not_finite_is_refused(copies: tuple[Path, Path], number: str) -> None:
    text = copies[0].read_text(encoding="utf-8").replace('"duration_s": 10.0', f'"duration_s": {number}')
    copies[0].write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"standard-test.json.*finite number"):
        Results.read(copies[0])


CELLS = {
    "cost": ("cheap", "cost must be a finite number"),
    "nadir_hz": ("nan", r"nadir_hz must be a finite number \[Hz\]"),
    "energy_mwh": ("", r"energy_mwh must be a finite number \[MWh\]"),
    "seed": ("-1", "seed must be a whole number"),
    "failure": ("bored", "failure must be empty or one of stall"),
    "duration_s": ("inf", r"duration_s must be a finite number \[s\]"),
}


@pytest.mark.parametrize("column", CELLS)
def test_edited_table_names_line_and_column(copies: tuple[Path, Path], column: str) -> None:
    value, text = CELLS[column]
    lines = copies[1].read_text(encoding="utf-8").split("\n")
    cells = lines[2].split(",")
    cells[lines[0].split(",").index(column)] = value
    copies[1].write_text("\n".join([*lines[:2], ",".join(cells), *lines[3:]]), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"standard-test.csv, line 3: {text}"):
        Results.read(copies[0])


def test_better_number_in_the_table_is_noticed(copies: tuple[Path, Path], results: Results) -> None:
    cost = repr(results.episodes[0].metrics["cost"])
    text = copies[1].read_text(encoding="utf-8")
    copies[1].write_text(text.replace(f",{cost},", ",0.5,", 1), encoding="utf-8")
    with pytest.raises(ValueError, match="csv_sha256"):
        Results.read(copies[0])


def test_unknown_column_is_named(copies: tuple[Path, Path]) -> None:
    copies[1].write_text(copies[1].read_text(encoding="utf-8").replace("nadir_hz", "beauty", 1), encoding="utf-8")
    with pytest.raises(ValueError, match=r"unknown columns \['beauty'\], missing columns \['nadir_hz'\]"):
        Results.read(copies[0])


def test_table_without_a_row_is_refused_even_with_fitting_sums(copies: tuple[Path, Path]) -> None:
    table = copies[1].read_text(encoding="utf-8").split("\n", 2)
    short = "\n".join([table[0], table[2]])
    data = json.loads(copies[0].read_text(encoding="utf-8"))
    data["csv_sha256"] = sha256(short.encode())
    data["sha256"] = sha256(to_json({k: v for k, v in data.items() if k != "sha256"}).encode())
    copies[0].write_text(to_json(data), encoding="utf-8")
    copies[1].write_text(short, encoding="utf-8")
    with pytest.raises(ValueError, match=r"expected one row per entry and seed.*9 rows.*got 8"):
        Results.read(copies[0])


def test_metric_names_are_columns(written: tuple[Path, Path]) -> None:
    header = written[1].read_text(encoding="utf-8").split("\n", 1)[0].split(",")
    assert header[6:] == list(METRICS)
