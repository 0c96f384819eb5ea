"""The gate accepts honest submissions and refuses the others."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from onnx import ModelProto, helper

import baselines
from tests.submissions import models
from tests.submissions.models import ACTION, OBSERVATION, TOML, M, N, after, constant, folder, info, node
from tests.submissions.models import model as make
from wtg_gym.policies import gate, onnx_worker, policy_process
from wtg_gym.policies.gate import CHECKS, Report, check_submission
from wtg_gym.policies.submission_folder import parse_submission, read_files

POLICIES = Path(baselines.__file__).parent.parent / "agents" / "policies"


def refusal(report: Report) -> tuple[str, str]:
    """The one check that was refused, and why; all after it were not reached."""
    assert report.refusal is not None
    verdicts = [check.verdict for check in report.checks]
    assert [check.name for check in report.checks] == list(CHECKS)
    assert verdicts.count("refused") == 1 and not report.accepted
    index = verdicts.index("refused")
    assert set(verdicts[:index]) <= {"passed"} and set(verdicts[index + 1 :]) <= {"not reached"}
    reason = report.checks[index].reason
    assert reason and reason.isprintable() and len(reason) < 1600
    return report.checks[index].name, reason


def recurrent() -> ModelProto:
    """An LSTM of ONNX's own, its states in and out as (batch, n)."""
    rng = np.random.default_rng(0)
    nodes = [
        node("Unsqueeze", ["observation", "zero"], "x"),
        node("Unsqueeze", ["state_0", "zero"], "h"),
        node("Unsqueeze", ["state_1", "zero"], "c"),
        helper.make_node("LSTM", ["x", "w", "r", "", "", "h", "c"], ["y", "yh", "yc"], hidden_size=8),
        node("Squeeze", ["yh", "zero"], "next_state_0"),
        node("Squeeze", ["yc", "zero"], "next_state_1"),
        node("Gemm", ["next_state_0", "head"], "action"),
    ]
    constants = [
        constant("zero", [0], np.int64),
        constant("w", rng.normal(0, 0.1, (1, 32, N))),
        constant("r", rng.normal(0, 0.1, (1, 32, 8))),
        constant("head", rng.normal(0, 0.1, (8, M))),
    ]
    states = [info(f"state_{i}", "batch", 8) for i in range(2)]
    following = [info(f"next_state_{i}", "batch", 8) for i in range(2)]
    return make(nodes, [OBSERVATION, *states], [ACTION, *following], constants)


@pytest.mark.parametrize("content", [make(), recurrent()], ids=["linear", "recurrent"])
def test_plain_policies_pass_every_check(content: ModelProto, tmp_path: Path) -> None:
    report = check_submission(folder(tmp_path / "a", content))
    assert report.accepted, [check for check in report.checks if check.verdict != "passed"]
    assert all(check.reason for check in report.checks)
    assert not report.notes


@pytest.mark.parametrize("name", ["entry.toml", "policy.onnx", "README.md"])
@pytest.mark.parametrize("kind", ["pipe", "folder", "/etc/passwd", "/dev/zero"])
def test_what_is_no_plain_file_is_refused(name: str, kind: str, tmp_path: Path) -> None:
    path = folder(tmp_path / "a")
    (path / name).unlink(missing_ok=True)
    makes: dict[str, Callable[[Path], object]] = {"pipe": os.mkfifo, "folder": Path.mkdir}
    makes.get(kind, lambda path: path.symlink_to(kind))(path / name)
    check, reason = refusal(check_submission(path))
    assert check == "folder" and "not a plain file" in reason


def test_link_to_a_folder_and_missing_files_are_refused(tmp_path: Path) -> None:
    path = folder(tmp_path / "a")
    (tmp_path / "b").symlink_to(path)
    assert "a link" in refusal(check_submission(tmp_path / "b"))[1]
    assert "cannot read" in refusal(check_submission(tmp_path / "none"))[1]
    (path / "policy.onnx").unlink()
    assert "it has no policy.onnx" in refusal(check_submission(path))[1]


@pytest.mark.parametrize(
    ("name", "size"), [("entry.toml", 10_000_000), ("policy.onnx", 5_000_001), ("README.md", 65_537)]
)
def test_large_files_are_refused(name: str, size: int, tmp_path: Path) -> None:
    path = folder(tmp_path / "a")
    (path / name).write_bytes(b"#" * size)
    check, reason = refusal(check_submission(path))
    assert check == "folder" and f"{name} is larger than" in reason


@pytest.mark.parametrize(
    ("toml", "text"),
    [
        (b"\xff\xfe", "not TOML"),
        ("name = ", "not TOML"),
        ("", "missing: ['name', 'authors', 'training_seed', 'action_mode']"),
        (TOML + "law = 'x'\n", "unknown: ['law']"),
        (TOML.replace("Jane Doe", "x" * 401), "an author must be up to 400"),
        (TOML.replace('["Jane Doe"]', '"me"'), "authors must be a list of texts"),
        (TOML.replace('["Jane Doe"]', "[]"), "authors must be a list of 1 … 40"),
        (TOML.replace("seed = 0", "seed = -1"), "training_seed must be"),
        (TOML.replace("k+tau", "pitch"), "action_mode must be one of k, tau, k+tau"),
        (TOML.replace('"k+tau"', "[]"), "action_mode must be one of"),
        (TOML + 'observation_mode = "all"\n', "observation_mode must be one of"),
        (TOML + 'strategy = "../law.toml"\n', "strategy must be one of mppt"),
        (TOML + "trained_on = 3\n", "trained_on must be"),
        (TOML + "links = ['javascript:alert(1)']\n", "a link must be a plain https:// address"),
        (TOML + "links = ['http://a.b']\n", "a link must be a plain https:// address"),
        (TOML + "links = ['https://a.b/)<img src=x>']\n", "a link must be a plain https:// address"),
        (TOML + "links = ['https://a.bc/ x']\n", "a link must be a plain https:// address"),
    ],
)
def test_wrong_entry_files_are_refused(toml: str | bytes, text: str, tmp_path: Path) -> None:
    check, reason = refusal(check_submission(folder(tmp_path / "a", toml=toml)))
    assert check == "entry.toml" and text in reason


WIDTHS = "it takes {} observations and gives {} actions; in its modes there are 20 and 4"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (after(node("Not", ["linear"], "action")), "onnxruntime cannot load the policy"),
        (models.linear(35, 4), WIDTHS.format(35, 4)),
        (models.of_v1(), WIDTHS.format(32, 8)),
    ],
)
def test_what_onnxruntime_cannot_load_or_has_other_widths_is_refused(
    content: ModelProto, text: str, tmp_path: Path
) -> None:
    check, reason = refusal(check_submission(folder(tmp_path / "a", content)))
    assert check == "loading" and text in reason


def test_policy_is_judged_in_the_environment_that_it_names(tmp_path: Path) -> None:
    report = check_submission(folder(tmp_path / "a", models.of_v1(), models.TOML_V1))
    assert report.accepted and report.played().environment == "GFMWTG-14bus-v1"
    assert report.actions is not None and report.actions.shape[2] == 8


def test_policy_that_is_slow_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(gate, "ANSWER_S", 1e-9)
    check, reason = refusal(check_submission(folder(tmp_path / "a")))
    assert check == "speed" and "ms for an action" in reason


def test_policy_that_remembers_other_scenarios_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No file is known that can: one is played here by a process that mixes its scenarios."""
    script = tmp_path / "worker.py"
    place = str(Path(onnx_worker.__file__).parent)
    script.write_text(
        f"import sys\nsys.path.insert(0, {place!r})\nimport onnx_worker as worker\nanswer = worker._Served.answer\n"
        "def mixed(served, n, source):\n    answer(served, n, source)\n    served.outputs[0][-1] += 1e-6\n"
        "worker._Served.answer = mixed\nworker.main()\n",
        encoding="utf-8",
    )
    monkeypatch.setattr(policy_process, "_SCRIPT", str(script))
    check, reason = refusal(check_submission(folder(tmp_path / "a")))
    assert check == "repeated" and "in another order" in reason


@pytest.mark.parametrize(
    "name",
    ["a;touch x", "$(id)", "--weak-isolation", "mine\n::error::hi", ".hidden", "ü", "a.toml", "AUX", "con.x", "a."],
)
def test_folder_whose_name_would_mean_something_to_a_shell_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.mkdir()
    with pytest.raises(ValueError, match="the folder's name must be"):
        read_files(path)


@pytest.mark.parametrize("name", ["linear-feedback", "gradient-v1-0"])
def test_shipped_entries_pass_every_check(name: str) -> None:
    report = check_submission(POLICIES / name)
    assert report.accepted, report.refusal


def test_folders_and_texts_of_all_shipped_entries_pass() -> None:
    folders = list(POLICIES.iterdir())
    assert len(folders) == 26 + 16 and all(parse_submission(read_files(path)["entry.toml"]).authors for path in folders)
