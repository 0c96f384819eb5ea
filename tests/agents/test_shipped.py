"""Every shipped policy is as its training left it, and docs/agents.md says how it was trained."""

import json

from agents import shipped
from agents.run import Run, RunSettings
from wtg_gym.evaluation import load_entries
from wtg_gym.files import sha256
from wtg_gym.policies.entry_folder import policy_folders


def test_every_trained_policy_is_the_one_of_its_record():
    records = json.loads(shipped.RECORDS.read_text(encoding="utf-8"))
    for folder in policy_folders():
        (entry,) = load_entries(folder)
        # One feedback is older than the records; policies of others have none.
        if folder.name == "linear-feedback" or entry.source != "The wtg_gym authors":
            continue
        record = records.pop(folder.name)
        assert record["policy_sha256"] == sha256((folder / "policy.onnx").read_bytes())
        assert f"--seed {entry.training_seed} " in record["command"] and entry.kind == "learned"
    assert not records


def test_the_page_has_the_table_that_the_command_makes():
    assert shipped.table() in shipped.PAGE.read_text(encoding="utf-8")


def test_a_run_is_added_by_its_best_policy(tmp_path, monkeypatch):
    (folder,) = [folder for folder in policy_folders() if folder.name == "ppo-v1-2"]
    best = tmp_path / "run" / "best" / f"{2_150_400:012d}"
    best.mkdir(parents=True)
    (best / "policy.onnx").write_bytes((folder / "policy.onnx").read_bytes())
    run = Run.new(tmp_path / "run", RunSettings(algo="ppo", hyperparameters={}, timesteps=2_250_000, n_envs=512))
    rows = ((2_150_400, 102.46, 60.0), (2_304_000, 1.0, 70.0))
    names = ("timesteps", "score", "wall_time_s")
    run.curve = [{**dict(zip(names, row, strict=True)), "marked": 1.0} for row in rows]
    run.write()
    for name in ("RECORDS", "PAGE"):
        copy = tmp_path / name
        copy.write_bytes(getattr(shipped, name).read_bytes())
        monkeypatch.setattr(shipped, name, copy)
    assert shipped.main([str(tmp_path / "run")]) == 0
    record = json.loads(shipped.RECORDS.read_text(encoding="utf-8"))["ppo-v1-2"]
    assert (record["steps"], record["validation_score"], record["wall_time_s"]) == (2_150_400, 102.5, 70)
    assert "| 1.2 |" in shipped.table()
