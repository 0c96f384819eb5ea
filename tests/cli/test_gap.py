"""Fresh scenarios as a user plays them: `evaluate --split fresh`, and the commands of `results`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.calls import error_of
from wtg_gym.cli import main
from wtg_gym.evaluation import recompute

COMMIT = "0123456789abcdef0123456789abcdef01234567"
SECRET = "a secret for these tests\n"
SHORT = ["--suite", "standard", "--entries", "deloaded-5", "--duration", "10"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gap")
    (folder / "secret.txt").write_text(SECRET)
    (folder / "page.md").write_text("before\n<!-- gap:standard:start -->\n<!-- gap:standard:end -->\nafter\n")
    assert main(["evaluate", *SHORT, "--split", "test", "--seeds", "20000:20004", "--results", str(folder)]) == 0
    drawn = ["--split", "fresh", "--commit", COMMIT, "--secret-file", str(folder / "secret.txt")]
    assert main(["evaluate", *SHORT, *drawn, "--scenarios", "4", "--results", str(folder)]) == 0
    return folder


def test_results_say_what_the_seeds_were_drawn_from(folder: Path) -> None:
    data = json.loads((folder / "standard-fresh.json").read_text())
    assert data["draw"]["commit"] == COMMIT and len(data["seeds"]) == 4
    # The secret itself is nowhere.
    assert SECRET.strip() not in (folder / "standard-fresh.json").read_text()


def test_gap_is_printed_and_put_on_a_page(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(folder / f"standard-{split}.json") for split in ("test", "fresh")]
    assert main(["results", "gap", *files, "--page", str(folder / "page.md")]) == 0
    out = capsys.readouterr().out
    assert "4 public and 4 fresh scenarios" in out and "deloaded-5" in out
    page = (folder / "page.md").read_text()
    assert "| deloaded-5 |" in page and page.startswith("before\n") and page.endswith("after\n")
    assert main(["results", "gap", *files, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [gap["name"] for gap in said["gaps"]] == ["deloaded-5"] and said["draw"]["commit"] == COMMIT


def test_gap_of_v1_is_between_scenarios_of_its_suite(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "secret.txt").write_text(SECRET)
    short = ["--entries", "fast-droop", "deloaded-5", "--duration", "10"]
    common = ["evaluate", "--suite", "standard-v1", *short, "--results", str(tmp_path)]
    assert main([*common, "--split", "test", "--seeds", "20000:20012"]) == 0
    drawn = ["--split", "fresh", "--commit", COMMIT, "--secret-file", str(tmp_path / "secret.txt")]
    assert main([*common, *drawn, "--scenarios", "12"]) == 0
    capsys.readouterr()
    files = [str(tmp_path / f"standard-v1-{split}.json") for split in ("test", "fresh")]
    assert main(["results", "gap", *files, "--json"]) == 0
    # The anchors of v1 fix the scale and have no gap.
    assert {gap["name"] for gap in json.loads(capsys.readouterr().out)["gaps"]} == {"fast-droop", "deloaded-5"}
    assert main(["results", "recompute", files[1], "--secret-file", str(tmp_path / "secret.txt")]) == 0


@pytest.mark.parametrize("command", ["gap", "page", "recompute"])
def test_results_of_an_older_version_are_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    data = json.loads((folder / "standard-test.json").read_text())
    old = tmp_path / "standard-test.json"
    del data["metrics"]["largest_power_change_pu"]
    old.write_text(json.dumps({**data, "format": 2}))
    rest = {
        "gap": [str(folder / "standard-fresh.json")],
        "page": ["--output", str(tmp_path / "page.html")],
        "recompute": ["--entries", "deloaded-5"],
    }[command]
    said = error_of(capsys, "results", command, str(old), *rest)
    assert said.endswith("format must be 4, that of this version, or 3, got 2; evaluate again")


def test_verify_checks_the_seeds_against_the_secret(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = [str(folder / "standard-fresh.json"), "--entries", "deloaded-5"]
    assert main(["results", "recompute", *stored]) == 0
    assert "drawn or chosen is not known: check them with --secret-file" in capsys.readouterr().err
    assert main(["results", "recompute", *stored, "--secret-file", str(folder / "secret.txt")]) == 0
    capsys.readouterr()
    (folder / "other.txt").write_text("another secret for these tests")
    assert main(["results", "recompute", *stored, "--secret-file", str(folder / "other.txt")]) == 1
    assert "not of this secret" in capsys.readouterr().out
    (folder / "short.txt").write_text("short")

    def play(*_: object, **__: object) -> None:
        raise AssertionError("a secret that cannot be one is refused before anything is played")

    monkeypatch.setattr(recompute, "evaluate", play)
    assert main(["results", "recompute", *stored, "--secret-file", str(folder / "short.txt")]) == 2
    assert "the secret must have 16 bytes or more, got 5" in capsys.readouterr().err


BAD = {
    "no commit": (["--split", "fresh"], "missing: --commit, --secret-file"),
    "short commit": (
        ["--split", "fresh", "--commit", "abc", "--secret-file", "SECRET"],
        "full git hash of 40 or 64 hexadecimal digits, got 'abc'",
    ),
    "seeds of one's own": (
        ["--split", "fresh", "--commit", COMMIT, "--secret-file", "SECRET", "--seeds", "5"],
        "without --seeds",
    ),
    "other split": (["--commit", COMMIT], "--commit: for --split fresh only, the split is validation"),
    "no file": (
        ["--split", "fresh", "--commit", COMMIT, "--secret-file", "nowhere.txt"],
        "--secret-file nowhere.txt: No such file",
    ),
    "fixed cases": (
        ["--suite", "paper", "--split", "fresh", "--commit", COMMIT, "--secret-file", "SECRET"],
        "suite 'paper' has fixed cases",
    ),
    "too few": (
        ["--split", "fresh", "--commit", COMMIT, "--secret-file", "SECRET", "--scenarios", "0"],
        "must be 1 … 100000, got 0",
    ),
    "short secret": (
        ["--split", "fresh", "--commit", COMMIT, "--secret-file", "SHORT"],
        "must have 16 bytes or more, got 5",
    ),
    "large secret": (
        ["--split", "fresh", "--commit", COMMIT, "--secret-file", "LARGE"],
        "larger than 4096 bytes",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_draw_is_one_line(case: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options, text = BAD[case]
    (tmp_path / "short").write_text("12345")
    (tmp_path / "large").write_bytes(bytes(5000))
    paths = {"SECRET": folder / "secret.txt", "SHORT": tmp_path / "short", "LARGE": tmp_path / "large"}
    assert main(["evaluate", "--entries", "mppt", *(str(paths.get(option, option)) for option in options)]) == 2
    error = capsys.readouterr().err
    assert text in error and error.count("\n") == 1


def test_gap_wants_both_kinds_of_results(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same = str(folder / "standard-test.json")
    assert main(["results", "gap", same, same]) == 2
    assert "in this order; got 'test' and 'test'" in capsys.readouterr().err


def test_secret_for_seeds_that_were_not_drawn_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [str(folder / "standard-test.json"), "--entries", "deloaded-5", "--secret-file"]
    assert main(["results", "recompute", *arguments, str(folder / "secret.txt")]) == 2
    assert "were not drawn" in capsys.readouterr().err
