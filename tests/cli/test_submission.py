"""`wtg-gym submission` as a user calls it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.calls import error_of, json_of
from tests.submissions.models import TOML, after, folder, node
from tests.submissions.models import model as make
from wtg_gym.cli import main
from wtg_gym.evaluation import Results, evaluate, load_entries

_FEW = ("--seeds", "20000:20002")


def test_template_with_a_policy_is_accepted(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "some.onnx").write_bytes(make().SerializeToString())
    target = tmp_path / "new"
    assert main(["submission", "new", str(target), "--policy", str(tmp_path / "some.onnx")]) == 0
    assert sorted(path.name for path in target.iterdir()) == ["entry.toml", "policy.onnx"]
    capsys.readouterr()
    assert main(["submission", "check", str(target)]) == 0
    said = capsys.readouterr().out
    assert said.count(" passed ") == 13 and "accepted, sha256" in said
    assert "has entry.toml already" in error_of(capsys, "submission", "new", str(target))


def test_check_prints_every_check_and_why_one_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    good, bad = (
        folder(tmp_path / "good"),
        folder(tmp_path / "bad", after(node("RandomNormalLike", ["linear"], "action"))),
    )
    data = json_of(capsys, "submission", "check", str(good), str(bad), "--json", code=1)
    first, second = data["submissions"]
    assert first["accepted"] and not second["accepted"]
    assert [check["verdict"] for check in second["checks"]].count("not reached") == 7
    assert main(["submission", "check", str(bad)]) == 1
    assert "refused" in capsys.readouterr().out


def test_score_is_that_of_evaluate(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    seeds = [folder(tmp_path / str(i), toml=TOML.replace("seed = 0", f"seed = {i}")) for i in range(2)]
    second = make()
    second.graph.initializer[0].raw_data = bytes(320)
    (seeds[1] / "policy.onnx").write_bytes(second.SerializeToString())
    results = tmp_path / "results"
    assert main(["submission", "score", *map(str, seeds), *_FEW, "--results", str(results)]) == 0
    said = capsys.readouterr().out
    assert "Mine (2 seeds)" in said and "mppt" in said
    stored = Results.read(results / "standard-test.json")
    again = evaluate([load_entries(seed)[0] for seed in seeds], "standard", seeds=[20_000, 20_001])
    assert stored.episodes == again.episodes and stored.entries == again.entries


def test_score_refuses_before_it_plays(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    good, bad = folder(tmp_path / "a"), folder(tmp_path / "b", after(node("Tile", ["linear"], "action")))
    assert main(["submission", "score", str(good), str(bad), *_FEW, "--results", str(tmp_path / "r")]) == 1
    said = capsys.readouterr()
    assert said.out == "" and "b: operators: node 1, 'Tile': the operator is not allowed" in said.err
    assert not (tmp_path / "r").exists()
    twin = folder(tmp_path / "c")
    assert main(["submission", "score", str(good), str(twin), *_FEW]) == 1
    assert "Mine, training seed 0 is given twice" in capsys.readouterr().err
    assert "unknown suite" in error_of(capsys, "submission", "score", str(good), "--suite", "storm")
