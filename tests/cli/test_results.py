"""`wtg-gym results` as a user calls it: stored results computed again and compared."""

import dataclasses
import re
from pathlib import Path

import pytest

from wtg_gym.cli import main
from wtg_gym.evaluation import Results, load_entries
from wtg_gym.evaluation.recompute import departures, recompute


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    short = ["evaluate", "--suite", "standard", "--entries", "deloaded-5", "--duration", "10"]
    assert main([*short, "--split", "test", "--scenarios", "4", "--results", str(folder)]) == 0
    return folder


def _recompute(path: Path, *options: str) -> int:
    return main(["results", "recompute", str(path), "--entries", "deloaded-5", *options])


def test_untouched_results_are_identical_and_what_is_not_the_benchmarks_is_named(folder, capsys):
    assert _recompute(folder / "standard-test.json") == 0
    said = capsys.readouterr()
    assert said.out.startswith("identical: ")
    assert "not the benchmark's own: 4 scenarios, those of the benchmark are 200" in said.err
    assert "not the benchmark's own: duration_s is 10.0, that of the benchmark 60.0" in said.err
    assert len(departures(Results.read(folder / "standard-test.json"))) == 2


def test_numbers_that_were_made_up_are_named(folder, tmp_path, capsys):
    results = Results.read(folder / "standard-test.json")
    first = results.episodes[0]
    better = dataclasses.replace(first, metrics={**first.metrics, "cost": first.metrics["cost"] * 0.5})
    # Written by the package itself, so that all checksums fit.
    path, _ = dataclasses.replace(results, episodes=(better, *results.episodes[1:])).write(tmp_path)
    assert _recompute(path) == 1
    head, *_, row = capsys.readouterr().out.splitlines()
    assert head.startswith("not identical: 1 differences")
    where, stored, now = re.split("  +", row)
    assert where == f"{first.entry}, seed {first.seed}: cost" and float(stored) == 0.5 * float(now)


@pytest.mark.parametrize(
    ("key", "value", "differs"),
    [
        ("kind", "feedback", True),
        ("policy_sha256", "0" * 64, True),
        ("observation_mode", "privileged", True),
        ("source", "Somebody", False),
    ],
)
def test_made_up_claims_about_an_entry_are_differences_and_other_texts_none(key, value, differs, folder):
    results = Results.read(folder / "standard-test.json")
    entries = tuple({**entry, key: value} if entry["name"] == "deloaded-5" else entry for entry in results.entries)
    found = recompute(dataclasses.replace(results, entries=entries), load_entries("deloaded-5"))
    named = [where for where, *_ in (found.differences if differs else found.circumstances)]
    assert named == [f"entry deloaded-5: {key}"] and bool(found.differences) == differs
