"""`wtg-gym results sensitivity` as a user calls it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.calls import error_of, json_of
from wtg_gym.cli import main

_FEW = (
    "results",
    "sensitivity",
    "--suite",
    "standard",
    "--entries",
    "deloaded-5",
    "--scenarios",
    "2",
    "--weights",
    "duty",
    "overload",
)


def test_table_names_what_does_not_matter(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(_FEW) == 0
    said = capsys.readouterr()
    assert "validation: 2 scenarios" in said.out
    assert "no score: the entry at 0 is not worse than that at 100" in said.out
    assert said.out.endswith("Weights that change neither the order nor a score by a point: overload.\n")
    assert [line.split()[:3] for line in said.out.splitlines() if line.startswith(("duty", "overload"))] == [
        ["duty", "0", "no"],
        ["duty", "2", "same"],
        ["overload", "0", "same"],
        ["overload", "2", "same"],
    ]


def test_json_is_the_whole_study(capsys: pytest.CaptureFixture[str]) -> None:
    data = json_of(capsys, *_FEW, "--factors", "0.5", "--json")
    assert set(data["scores"]) == {"deloaded-5", "mppt", "coordinated-piecewise"}
    assert [(v["weight"], v["factor"]) for v in data["variants"]] == [("duty", 0.5), ("overload", 0.5)]
    assert data["idle"] == ["overload"]
    change = data["variants"][0]["scores"]["deloaded-5"] - data["scores"]["deloaded-5"]
    assert data["variants"][0]["changes"] == {"deloaded-5": change}


def test_page_gets_the_table_between_its_markers(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "before\n<!-- sensitivity:standard:start -->\n<!-- sensitivity:standard:end -->\nafter\n", encoding="utf-8"
    )
    assert main([*_FEW, "--page", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert text.startswith(
        "before\n<!-- sensitivity:standard:start -->\nScores on 2 validation scenarios of `standard` with"
    )
    assert "| weight | factor | order | scores that change by a point or more |" in text
    assert text.endswith("by a point: overload.\n<!-- sensitivity:standard:end -->\nafter\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--entries", "turbo"), "unknown entry 'turbo'"),
        (("--weights", "cap"), "invalid choice: 'cap'"),
        (("--factors", "1"), "other than 1, which changes nothing"),
        (("--factors", "-2"), "outside the allowed range 0 … 1000"),
        (("--scenarios", "0"), "scenarios = 0 is outside the allowed range 1 … 200"),
        (("--split", "train"), "too many to play them all"),
        (("--page", "missing.md"), "cannot read the file with the markers missing.md"),
    ],
)
def test_bad_input_is_refused(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    entries = () if "--entries" in arguments else ("--entries", "mppt")
    assert said in error_of(capsys, "results", "sensitivity", *entries, *arguments)
