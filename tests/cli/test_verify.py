"""`wtg-gym results recompute` as a user runs it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from wtg_gym.cli import main
from wtg_gym.evaluation import Results, load_entries
from wtg_gym.evaluation.recompute import departures, recompute
from wtg_gym.files import sha256, to_json


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    arguments = [
        "--suite",
        "standard",
        "--entries",
        "deloaded-5",
        "--split",
        "test",
        "--scenarios",
        "3",
        "--duration",
        "10",
        "--results",
        str(folder),
    ]
    assert main(["evaluate", *arguments]) == 0
    return folder / "standard-test.json"


def test_untouched_results_are_identical(stored: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["results", "recompute", str(stored), "--entries", "deloaded-5", "deloaded-10"]) == 0
    assert capsys.readouterr().out.startswith("identical: ")


def test_numbers_that_were_made_up_are_named(stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = Results.read(stored)
    first = results.episodes[0]
    metrics = {**first.metrics, "cost": first.metrics["cost"] * 0.5}
    better = dataclasses.replace(first, metrics=metrics)
    # Written by the package itself, so that all checksums fit.
    path, _ = dataclasses.replace(results, episodes=(better, *results.episodes[1:])).write(tmp_path)
    assert main(["results", "recompute", str(path), "--entries", "deloaded-5", "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert not said["identical"]
    (difference,) = said["differences"]
    assert difference["where"] == f"{first.entry}, seed {first.seed}: cost"
    assert float(difference["stored"]) == 0.5 * float(difference["now"])
    assert main(["results", "recompute", str(path), "--entries", "deloaded-5"]) == 1
    assert "not identical: 1 differences" in capsys.readouterr().out


def test_another_policy_and_other_circumstances_are_named(stored: Path) -> None:
    results = Results.read(stored)
    (entry,) = load_entries("deloaded-5")
    other = dataclasses.replace(entry, strategy="deloaded-10")
    found = recompute(dataclasses.replace(results, versions={**results.versions, "numpy": "1"}), [other])
    assert found.differences[0].where == "deloaded-5: sha256"
    assert [difference.where for difference in found.circumstances] == ["numpy"]
    assert any(": cost" in difference.where for difference in found.differences)


@pytest.mark.parametrize(
    ("key", "value"), [("kind", "feedback"), ("policy_sha256", "0" * 64), ("observation_mode", "privileged")]
)
def test_made_up_claims_about_an_entry_are_differences(key: str, value: str, stored: Path) -> None:
    results = Results.read(stored)
    entries = tuple({**entry, key: value} if entry["name"] == "deloaded-5" else entry for entry in results.entries)
    found = recompute(dataclasses.replace(results, entries=entries), load_entries("deloaded-5"))
    assert [difference.where for difference in found.differences] == [f"deloaded-5: {key}"]


def test_another_author_is_named(stored: Path) -> None:
    results = Results.read(stored)
    entries = tuple({**entry, "source": "Somebody"} for entry in results.entries)
    found = recompute(dataclasses.replace(results, entries=entries), load_entries("deloaded-5"))
    assert found.differences == []
    assert [text.where for text in found.circumstances] == ["deloaded-5: source"]


def test_summary_that_the_table_does_not_give_is_refused(
    stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = json.loads(stored.read_text(encoding="utf-8"))
    data["summary"]["deloaded-5"]["score"] = {"value": 140.0, "low": 139.0, "high": 141.0}
    del data["sha256"]
    data["sha256"] = sha256(to_json(data).encode())
    path = tmp_path / stored.name
    path.write_text(to_json(data), encoding="utf-8")
    path.with_suffix(".csv").write_bytes(stored.with_suffix(".csv").read_bytes())
    assert main(["results", "recompute", str(path), "--entries", "deloaded-5"]) == 2
    assert "summary.deloaded-5.score.value is 140.0, the table sums up to" in capsys.readouterr().err


def test_texts_of_a_file_are_no_commands_to_the_terminal(
    stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = Results.read(stored)
    versions = {**results.versions, "numpy": "1\x1b[2J\u202e\n::error::no"}
    path, _ = dataclasses.replace(results, versions=versions).write(tmp_path)
    assert main(["results", "recompute", str(path), "--entries", "deloaded-5"]) == 0
    assert r"numpy was 1\x1b[2J\u202e\n::error::no, is" in capsys.readouterr().err


def test_results_that_are_not_the_benchmarks_are_called_so(stored: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["results", "recompute", str(stored), "--entries", "deloaded-5"]) == 0
    said = capsys.readouterr().err
    assert "not the benchmark's own: 3 scenarios, those of the benchmark are 200" in said
    assert "not the benchmark's own: duration_s is 10.0, that of the benchmark 60.0" in said
    assert len(departures(Results.read(stored))) == 2


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--entries", "mppt"], "hold entries that were not given: deloaded-5"),
        (["--entries", "no-such-thing"], "unknown entry"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], text: str, stored: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["results", "recompute", str(stored), *arguments]) == 2
    error = capsys.readouterr().err
    assert text in error and error.count("\n") == 1


def test_missing_file_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["results", "recompute", "nowhere.json"]) == 2
    assert "nowhere.json" in capsys.readouterr().err
