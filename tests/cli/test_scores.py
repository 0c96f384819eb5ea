"""`wtg-gym evaluate`, `leaderboard`, `report`, `results` and `submission` as a user calls them."""

import dataclasses
import html
import re
import shlex
import sys
from pathlib import Path

import pytest

import wtg_gym.cli.scoring
from tests.cli.calls import error_of, json_of, printed_by
from tests.interruption import interrupted
from tests.submissions import models
from tests.submissions.models import TOML, after, folder
from wtg_gym import evaluate, get_suite
from wtg_gym.cli import main
from wtg_gym.cli.scoring import look_into_working_folder
from wtg_gym.evaluation import Results, Workers, evaluator, load_entries
from wtg_gym.evaluation.evaluator import departures, recompute
from wtg_gym.tasks import V0, V1

_LEADERBOARD = ("leaderboard", "--suite", "paper", "--entries")
_PAPER = (*_LEADERBOARD, "mppt", "deloaded-5", "coordinated-piecewise")
HEADINGS = [
    *("Score", "Where control decides", "Bad runs", "Scenarios"),
    *("Operators' tests", "Faults of sensors", "Energy", "Damping"),
]
CLAIMS = {"kind": "feedback", "policy_sha256": "0" * 64, "observation_mode": "privileged", "source": "Somebody"}
OTHER = TOML.replace("Mine", "Other")
_FEW = ("--seeds", "20000", "20001")

pytestmark = pytest.mark.usefixtures("few_scenarios")


def test_evaluate_ranks_a_suite_of_v1_in_its_own_grid(capsys, tmp_path):
    arguments = ["--suite", "standard-v1", "--split", "validation", "--scenarios", "12"]
    mine = tmp_path / "mine"
    entries = ["--entries", "coordinated-piecewise", "fast-droop"]
    out = printed_by(capsys, "evaluate", *entries, *arguments, "--results", str(mine)).out
    assert all(f"  {name} " in out for name in ("fast-droop", *V1.anchors)) and "mppt" not in out
    assert max(map(len, out.splitlines())) <= 120
    assert sorted(p.name for p in mine.iterdir()) == [f"standard-v1-validation.{end}" for end in ("csv", "json")]
    rows = {row.name: row for row in Results.read(mine / "standard-v1-validation.json").ranking}
    for name, row in rows.items():
        (line,) = (line for line in out.splitlines() if f"  {name} " in line)
        mark = " ✓" if row.marked else "  "
        assert re.search(rf" {row.lost_or_beyond_percent:.1f}{mark} .* {row.mean_pinned_cost:.1f}$", line)


def test_workers_of_the_options_play(capsys, monkeypatch):
    pytest.importorskip("joblib")
    asked, real = [], wtg_gym.cli.scoring.evaluate
    here = "wtg_gym.cli.scoring.evaluate"
    monkeypatch.setattr(here, lambda *own, workers=None, **named: [asked.append(workers), real(*own, **named)][1])
    assert main(["evaluate", "--suite", "paper", "--entries", "mppt", "--backend", "loky", "--jobs", "3"]) == 0
    assert asked == [Workers("loky", jobs=3)]


def test_interrupted_leaderboard_keeps_its_finished_parts(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    stop = interrupted(evaluator.play_batch, when=lambda entry, *_: entry.name == "deloaded-10")
    monkeypatch.setattr(evaluator, "play_batch", stop)
    message = printed_by(capsys, *_LEADERBOARD, "deloaded-5", "deloaded-10", "--threads", "1", code=130).err
    partial = Path("results") / "partial"
    assert f"finished parts are kept in {partial}: run the same command again to go on" in message
    assert list(partial.glob("*.json"))
    monkeypatch.setattr(evaluator, "play_batch", interrupted(evaluator.play_batch))
    assert "finished parts" not in printed_by(capsys, *_LEADERBOARD, "deloaded-5", "--results", "other", code=130).err


def test_leaderboard_ranks_writes_and_updates_the_readme(capsys, tmp_path):
    readme, results = tmp_path / "README.md", tmp_path / "results"
    readme.write_text("before\n<!-- leaderboard:paper:start -->\nold\n<!-- leaderboard:paper:end -->\nafter\n")
    arguments = [*_PAPER, "--results", str(results), "--readme", str(readme)]
    printed = printed_by(capsys, *arguments)
    assert f"{readme}: updated" in printed.err
    rows = [line.split() for line in printed.out.splitlines() if line.split()[1:2] and line.split()[0] in "123"]
    assert rows[0][:2] == ["1", "coordinated-piecewise"]
    text = readme.read_text(encoding="utf-8")
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert "| 1 | coordinated-piecewise |" in text
    assert sorted(path.name for path in results.glob("*.*")) == ["paper-test.csv", "paper-test.json"]
    assert f"{readme}: already up to date" in printed_by(capsys, *arguments).err


def test_leaderboard_plays_only_what_is_new(monkeypatch, tmp_path):
    whole = (*_LEADERBOARD, "mppt", "deloaded-5", "coordinated-linear", "coordinated-piecewise")
    assert main([*whole, "--results", str(tmp_path / "at-once")]) == 0
    assert main([*_PAPER, "--results", str(tmp_path)]) == 0
    played: list[str] = []
    real = evaluator.play_batch
    monkeypatch.setattr(evaluator, "play_batch", lambda e, *rest: [played.append(e.name), real(e, *rest)][1])
    assert main([*whole, "--results", str(tmp_path)]) == 0
    assert played == ["coordinated-linear"]
    assert _files(tmp_path) == _files(tmp_path / "at-once")
    monkeypatch.setattr("wtg_gym.evaluation.partial.source_hash", lambda: "0" * 64)
    assert main([*_PAPER, "--results", str(tmp_path)]) == 0
    assert sorted(played[1:]) == ["coordinated-piecewise", "deloaded-5", "mppt"]


def test_results_of_other_scenarios_or_settings_are_not_overwritten(capsys, tmp_path):
    common = ["evaluate", "--suite", "standard", "--results", str(tmp_path), "--entries", "mppt"]
    printed_by(capsys, *common, "--scenarios", "2")
    stored = _files(tmp_path)
    for again, other in (("3", "seeds"), ("1 --duration 10", "settings and seeds")):
        message = error_of(capsys, *common, "--scenarios", *again.split())
        assert f"its standard-validation.json is of other {other} and would be lost; give another folder" in message
    assert _files(tmp_path) == stored
    dataclasses.replace(Results.read(tmp_path / "standard-validation.json"), suite_hash="0" * 64).write(tmp_path)
    assert "is of other suite_hash and would be lost" in error_of(capsys, *common, "--scenarios", "2")
    assert main([*common, "--scenarios", "2", "--split", "test"]) == 0


def test_modules_of_the_working_folder_can_be_imported_only_where_an_entry_is_one(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path != str(tmp_path)])
    look_into_working_folder(["mppt", "law.toml"])
    assert str(tmp_path) not in sys.path
    look_into_working_folder(["mppt", "my_package.controller:make_policy"])
    assert str(tmp_path) in sys.path


def _files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    path = tmp_path_factory.mktemp("results")
    short = ["evaluate", "--suite", "standard", "--entries", "deloaded-5", "--duration", "10"]
    assert main([*short, "--split", "test", "--scenarios", "4", "--results", str(path)]) == 0
    return path


def test_untouched_results_are_identical_and_what_is_not_the_benchmarks_is_named(stored, capsys):
    printed = printed_by(capsys, "results", "recompute", str(stored / "standard-test.json"), "--entries", "deloaded-5")
    assert printed.out.startswith("identical: ")
    assert "not the benchmark's own: 4 scenarios, those of the benchmark are 200" in printed.err
    assert "not the benchmark's own: duration_s is 10.0, that of the benchmark 60.0" in printed.err
    assert len(departures(Results.read(stored / "standard-test.json"))) == 2


def test_numbers_that_were_made_up_are_named(stored, tmp_path, capsys):
    results = Results.read(stored / "standard-test.json")
    first = results.episodes[0]
    better = dataclasses.replace(first, metrics={**first.metrics, "cost": first.metrics["cost"] * 0.5})
    # Written by the package itself, so that all checksums fit.
    path, _ = dataclasses.replace(results, episodes=(better, *results.episodes[1:])).write(tmp_path)
    printed = printed_by(capsys, "results", "recompute", str(path), "--entries", "deloaded-5", code=1)
    head, *_, row = printed.out.splitlines()
    assert head.startswith("not identical: 1 differences")
    where, stored, now = re.split("  +", row)
    assert where == f"{first.entry}, seed {first.seed}: cost" and float(stored) == 0.5 * float(now)


@pytest.mark.parametrize(("key", "value"), CLAIMS.items())
def test_made_up_claims_about_an_entry_are_differences_and_other_texts_none(key, value, stored):
    differs = key != "source"
    results = Results.read(stored / "standard-test.json")
    entries = tuple({**entry, key: value} if entry["name"] == "deloaded-5" else entry for entry in results.entries)
    result = recompute(dataclasses.replace(results, entries=entries), load_entries("deloaded-5"))
    named = [where for where, *_ in (result.differences if differs else result.circumstances)]
    assert named == [f"entry deloaded-5: {key}"] and bool(result.differences) == differs


def test_a_page_has_every_section_loads_nothing_and_escapes_names(tmp_path):
    pytest.importorskip("matplotlib")
    law = tmp_path / "my law.toml"
    law.write_text('name = "a & b"\nk_min = 1.02\nk_nominal = 1.02\nk_max = 1.02\n', encoding="utf-8")
    page = tmp_path / "page.html"
    assert main(["report", str(law), "--scenarios", "3", "--seed", "10000", "--output", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert [html.unescape(heading) for heading in re.findall("<h2[^>]*>(.*?)</h2>", text)] == HEADINGS
    assert re.findall('(?:src|href)="(.{11})', text) == ["data:image/"] * 2
    assert "a &amp; b" in text and "a & b" not in text
    assert "By chance alone so many more would come" in text
    assert f"--split validation --seeds 10000 --entries {shlex.quote(str(law))}" in html.unescape(text)
    assert "Kind: law. Scores" in text


def test_a_page_of_markdown_has_the_numbers_of_the_evaluation_and_the_dearest_scenario_first(tmp_path):
    pytest.importorskip("matplotlib")
    page, seeds = tmp_path / "page.md", get_suite("standard-v1").validation[:3]
    assert main(["report", "fast-droop", "--scenarios", "3", "--output", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    results = evaluate(["fast-droop"], "standard-v1", "validation", seeds=seeds)
    assert f"| all, strata count alike | 3 | {results.scores['fast-droop'].value:.1f} |" in text
    costs = {episode.seed: episode.metrics["cost"] for episode in results.episodes_of("fast-droop")}
    assert "Difference to coordinated-tuned: 0.0 percentage points" in text and "By chance alone" not in text
    shown = [int(seed) for seed in re.findall(r"\(page-seed-(\d+)\.svg\)", text)]
    assert shown == sorted(seeds, key=costs.get, reverse=True)


def test_template_beside_a_policy_is_accepted_once_it_is_filled_in(capsys, tmp_path):
    target, check = tmp_path / "new", ("submission", "check", str(tmp_path / "new"))
    printed_by(capsys, "submission", "new", str(target))
    (target / "policy.onnx").write_bytes(models.of_v1().SerializeToString())
    entry = target / "entry.toml"
    empty = entry.read_text(encoding="utf-8")
    assert "authors must be a list of 1 … 40 names" in printed_by(capsys, *check, code=1).out
    filled = empty.replace("authors = []", 'authors = ["A"]').replace('name = ""', 'name = "Mine"')
    entry.write_text(filled, encoding="utf-8")
    message = printed_by(capsys, *check).out
    assert message.count(" passed ") == 6 and "accepted, sha256" in message


def test_score_is_that_of_evaluate(capsys, tmp_path):
    seeds = [folder(tmp_path / str(i), toml=TOML.replace("seed = 0", f"seed = {i}")) for i in range(2)]
    (seeds[1] / "policy.onnx").write_bytes(models.other().SerializeToString())
    results = tmp_path / "results"
    message = printed_by(capsys, "submission", "score", *map(str, seeds), *_FEW, "--results", str(results)).out
    assert "Mine (2 seeds)" in message and "mppt" in message
    stored = Results.read(results / "standard-test.json")
    again = evaluate([load_entries(seed)[0] for seed in seeds], "standard", "test", seeds=[20_000, 20_001])
    assert stored.episodes == again.episodes and stored.entries == again.entries


def test_score_ranks_what_is_not_refused(capsys, tmp_path):
    good, bad = folder(tmp_path / "a"), folder(tmp_path / "b", after("action = Tile(linear)"), OTHER)
    score = ("submission", "score", str(good))
    printed = printed_by(capsys, *score, str(bad), *_FEW, "--results", str(tmp_path / "r"), code=1)
    assert "Mine" in printed.out and "Other" not in printed.out
    assert "b: loading: onnxruntime cannot load the policy" in printed.err
    assert {e["name"] for e in Results.read(tmp_path / "r" / "standard-test.json").entries} == {"Mine", *V0.anchors}
    twin = folder(tmp_path / "c")
    printed = printed_by(capsys, *score, str(twin), *_FEW, "--results", str(tmp_path / "s"), code=1)
    assert printed.out == "" and "Mine (training seed 0) is given twice" in printed.err
    assert not list((tmp_path / "s").glob("*.*"))


def test_score_plays_each_folder_on_the_standard_suite_of_its_version(capsys, tmp_path):
    few = ("--split", "validation", "--scenarios", "12", "--results", str(tmp_path / "results"))
    # However the key is written, one parser reads it; without it, the version is v1.
    key = 'environment = "GFMWTG-14bus-v0"'
    old = folder(tmp_path / "a", toml=TOML.replace(key, "'environment'='GFMWTG-14bus-v0'#"))
    new = folder(tmp_path / "b", models.of_v1(), OTHER.replace(key, ""))
    assert "--json prints one suite" in error_of(capsys, "submission", "score", str(old), str(new), *few, "--json")
    assert main(["submission", "score", str(old), str(new), *few]) == 0
    for suite, name in (("standard", "Mine"), ("standard-v1", "Other")):
        entries = Results.read(tmp_path / "results" / f"{suite}-validation.json").entries
        assert [entry["name"] for entry in entries if entry["training_seed"] is not None] == [name]


def test_pages_about_entries_of_v1_come_with_their_scores(capsys, tmp_path):
    pytest.importorskip("matplotlib")
    mine = folder(tmp_path / "mine", models.of_v1(), TOML.replace('environment = "GFMWTG-14bus-v0"', ""))
    seeds = ("--seeds", "20000", "20001", "20002")
    assert main(["submission", "score", str(mine), *seeds, "--cards", str(tmp_path / "cards")]) == 0
    assert {"mine.html", "mine.md"} <= {path.name for path in (tmp_path / "cards").iterdir()}
    assert "| all, strata count alike | 3 |" in (tmp_path / "cards" / "mine.md").read_text(encoding="utf-8")


def test_leaderboard_shows_laws_before_policies_are_played(capsys, tmp_path):
    arguments = [*_LEADERBOARD, "mppt", str(folder(tmp_path / "mine")), "--results", str(tmp_path)]
    first, both = printed_by(capsys, *arguments).out.split("suite paper")[1:]
    assert "mppt" in first and "Mine" not in first and "Mine" in both


def test_check_compares_with_the_entries_beside(capsys, tmp_path):
    old, mine = folder(tmp_path / "old"), folder(tmp_path / "new", toml=OTHER)
    data = json_of(capsys, "submission", "check", str(mine), "--beside", str(old), str(mine), "--json", code=1)
    assert data["submissions"][0]["accepted"] and "the same policy file is given twice" in data["together"][0]
    assert main(["submission", "check", str(old), "--beside", str(old)]) == 0
