"""`wtg-gym submission` as a user calls it."""

import pytest

from tests.cli.calls import error_of, json_of
from tests.submissions import models
from tests.submissions.models import TOML, after, folder
from wtg_gym.cli import main
from wtg_gym.evaluation import Results, evaluate, load_entries
from wtg_gym.tasks import V0

OTHER = TOML.replace("Mine", "Other")
_FEW = ("--seeds", "20000", "20001")


pytestmark = pytest.mark.usefixtures("few_scenarios")


def test_template_beside_a_policy_is_accepted_once_it_is_filled_in(capsys, tmp_path):
    target = tmp_path / "new"
    assert main(["submission", "new", str(target)]) == 0
    capsys.readouterr()
    (target / "policy.onnx").write_bytes(models.of_v1().SerializeToString())
    entry = target / "entry.toml"
    empty = entry.read_text(encoding="utf-8")
    assert main(["submission", "check", str(target)]) == 1
    assert "authors must be a list of 1 … 40 names" in capsys.readouterr().out
    filled = empty.replace("authors = []", 'authors = ["A"]').replace('name = ""', 'name = "Mine"')
    entry.write_text(filled, encoding="utf-8")
    assert main(["submission", "check", str(target)]) == 0
    message = capsys.readouterr().out
    assert message.count(" passed ") == 6 and "accepted, sha256" in message


def test_score_is_that_of_evaluate(capsys, tmp_path):
    seeds = [folder(tmp_path / str(i), toml=TOML.replace("seed = 0", f"seed = {i}")) for i in range(2)]
    (seeds[1] / "policy.onnx").write_bytes(models.other().SerializeToString())
    results = tmp_path / "results"
    assert main(["submission", "score", *map(str, seeds), *_FEW, "--results", str(results)]) == 0
    message = capsys.readouterr().out
    assert "Mine (2 seeds)" in message and "mppt" in message
    stored = Results.read(results / "standard-test.json")
    again = evaluate([load_entries(seed)[0] for seed in seeds], "standard", "test", seeds=[20_000, 20_001])
    assert stored.episodes == again.episodes and stored.entries == again.entries


def test_score_ranks_what_is_not_refused(capsys, tmp_path):
    good, bad = folder(tmp_path / "a"), folder(tmp_path / "b", after("action = Tile(linear)"), OTHER)
    assert main(["submission", "score", str(good), str(bad), *_FEW, "--results", str(tmp_path / "r")]) == 1
    printed = capsys.readouterr()
    assert "Mine" in printed.out and "Other" not in printed.out
    assert "b: loading: onnxruntime cannot load the policy" in printed.err
    assert {e["name"] for e in Results.read(tmp_path / "r" / "standard-test.json").entries} == {"Mine", *V0.anchors}
    twin = folder(tmp_path / "c")
    assert main(["submission", "score", str(good), str(twin), *_FEW, "--results", str(tmp_path / "s")]) == 1
    printed = capsys.readouterr()
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
    arguments = ["leaderboard", "--suite", "paper", "--entries", "mppt", str(folder(tmp_path / "mine"))]
    assert main([*arguments, "--results", str(tmp_path)]) == 0
    first, both = capsys.readouterr().out.split("suite paper")[1:]
    assert "mppt" in first and "Mine" not in first and "Mine" in both


def test_check_compares_with_the_entries_beside(capsys, tmp_path):
    old, mine = folder(tmp_path / "old"), folder(tmp_path / "new", toml=OTHER)
    data = json_of(capsys, "submission", "check", str(mine), "--beside", str(old), str(mine), "--json", code=1)
    assert data["submissions"][0]["accepted"] and "the same policy file is given twice" in data["together"][0]
    assert main(["submission", "check", str(old), "--beside", str(old)]) == 0
