"""What the gate lets pass, and what it refuses before onnxruntime sees it."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import ModelProto, TensorProto, helper

import baselines
from tests.submissions import models
from tests.submissions.models import (
    ACTION,
    LINEAR,
    OBSERVATION,
    TOML,
    WEIGHTS,
    M,
    N,
    after,
    constant,
    field,
    folder,
    info,
    node,
    varint,
)
from tests.submissions.models import model as make
from wtg_gym.submissions.folder import parse_entry, read_files
from wtg_gym.submissions.gate import CHECKS, Report, check_submission
from wtg_gym.submissions.graph import inspect
from wtg_gym.submissions.limits import MEMORY_BYTES
from wtg_gym.submissions.probes import PROBES

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


def static(content: ModelProto | bytes) -> list[tuple[str, bool, str]]:
    """What is found without running anything."""
    return inspect(content if isinstance(content, bytes) else content.SerializeToString(), N, M)


def static_refusal(content: ModelProto | bytes) -> tuple[str, str]:
    *_, (name, passed, reason) = static(content)
    assert not passed
    return name, reason


# --- accepted --------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    "nodes",
    [
        (node("Reshape", ["linear", "split"], "a"), node("Flatten", ["a"], "action")),
        (node("Transpose", ["linear"], "a"), node("Transpose", ["a"], "action")),
        (node("Softmax", ["linear"], "action", axis=1),),
        (node("ReduceMean", ["linear"], "a", axes=[1]), node("Mul", ["a", "linear"], "action")),
        (node("Gather", ["linear", "order"], "action", axis=1),),
        (node("Greater", ["linear", "half"], "a"), node("Where", ["a", "linear", "half"], "action")),
    ],
)
def test_operators_that_keep_lanes_apart_are_allowed(nodes: tuple[Any, ...]) -> None:
    constants = [
        constant("split", [-1, 2, 2], np.int64),
        constant("order", [3, 2, 1, 0], np.int64),
        constant("half", 0.5),
    ]
    found = static(after(*nodes, constants=constants))
    assert all(passed for _, passed, _ in found) and len(found) == 6, found[-1]


# --- the folder ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["model.zip", "weights.bin", "vec_normalize.pkl", "run.py", ".hidden", "a\n\x1b[31m"])
def test_other_files_are_refused(name: str, tmp_path: Path) -> None:
    path = folder(tmp_path / "a")
    (path / name).write_bytes(b"x")
    check, reason = refusal(check_submission(path))
    assert check == "folder" and "allowed are entry.toml, policy.onnx, README.md" in reason


@pytest.mark.parametrize("name", ["entry.toml", "policy.onnx", "README.md"])
@pytest.mark.parametrize("kind", ["link", "pipe", "folder", "device"])
def test_what_is_no_plain_file_is_refused(name: str, kind: str, tmp_path: Path) -> None:
    path = folder(tmp_path / "a")
    (path / name).unlink(missing_ok=True)
    if kind == "link":
        (path / name).symlink_to("/etc/passwd")
    elif kind == "device":
        (path / name).symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path / name)
    else:
        (path / name).mkdir()
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
        ("a = " + "[" * 8000, "not TOML"),
        ("", "missing: ['name', 'authors', 'training_seed', 'action_mode']"),
        (TOML + "strategy = 'x'\n", "unknown: ['strategy']"),
        (TOML.replace("Jane Doe", "x" * 401), "an author must be up to 400"),
        (TOML.replace('["Jane Doe"]', '"me"'), "authors must be a list of 1 … 40"),
        (TOML.replace('["Jane Doe"]', "[1]"), "an author must be"),
        (TOML.replace("seed = 0", "seed = true"), "training_seed must be"),
        (TOML.replace("seed = 0", "seed = -1"), "training_seed must be"),
        (TOML.replace("seed = 0", "seed = 0x" + "f" * 4000), "training_seed must be"),
        (TOML.replace("k+tau", "pitch"), "action_mode must be one of k, tau, k+tau"),
        (TOML.replace('"k+tau"', "[]"), "action_mode must be one of"),
        (TOML + 'observation_mode = "all"\n', "observation_mode must be one of"),
        (TOML + 'description = "[x](y)"\n', "description must be"),
        (TOML + 'description = "<script>"\n', "description must be"),
        (TOML + 'trained_on = "see http://x.y"\n', "trained_on must be"),
        (TOML + "trained_on = 3\n", "trained_on must be"),
        *(
            (TOML + f"links = ['{link}']\n", "a link must be a plain https:// address")
            for link in (
                "javascript:alert(1)",
                "http://a.b",
                "https://a.b/)<img src=x>",
                "https://me@a.bc",
                "https://a.bc/ x",
            )
        ),
    ],
)
def test_wrong_entry_files_are_refused(toml: str | bytes, text: str, tmp_path: Path) -> None:
    check, reason = refusal(check_submission(folder(tmp_path / "a", toml=toml)))
    assert check == "entry.toml" and text in reason


# --- the policy file -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "check"),
    [
        (b"\x08\x08" + field(b"\x3a", b"\x0a\x00" * 2_400_000), "model"),  # empty nodes
        (b"\x08\x08" + field(b"\x3a", field(b"\x2a", b"\x08\x01" * 2_400_000)), "file format"),  # dims of no field
        (b"\x08\x08" + b"\x42\x00" * 2_400_000 + field(b"\x3a", b"\x0a\x00"), "model"),  # opsets
        (b"\x08\x08" + field(b"\x3a", field(b"\x0a", b"\x0a\x00" * 2_400_000)), "model"),  # inputs of one node
        (b"\x08\x08" + field(b"\x3a", field(b"\x2a", b"\x0a" + varint(4_000_000) + b"\x01" * 4_000_000)), "model"),
        (b"\x08" + b"\xff" * 4_000_000, "file format"),
    ],
    ids=["nodes", "fields", "opsets", "inputs", "dims", "varint"],
)
def test_protobuf_bombs_are_refused_in_bounded_time(content: bytes, check: str, tmp_path: Path) -> None:
    import resource

    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.monotonic()
    found, _ = refusal(check_submission(folder(tmp_path / "a", content)))
    assert found in (check, "file format", "model", "constants")
    assert time.monotonic() - began < 30.0
    # In this process nothing of it is parsed; in the other one memory has a limit.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - largest < 200_000
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss < MEMORY_BYTES // 1024


def resized(dims: list[int]) -> ModelProto:
    content = make()
    content.graph.initializer[0].dims[:] = dims
    return content


def unknown_field() -> bytes:
    return make().SerializeToString() + field(b"\xfa\x07", b"something else")


@pytest.mark.parametrize(
    ("content", "check", "text"),
    [
        (resized([N, 5]), "constants", "100 numbers has 320 bytes"),
        (resized([2**40, 2**40]), "constants", "allowed are up to 6 axes"),
        (resized([-1, 4]), "constants", "allowed are up to 6 axes"),
        (resized([1_000_000, 1_000_000]), "constants", "1000000000000 numbers has 320 bytes"),
        (resized([1] * 1000), "constants", "allowed are up to 6 axes"),
        (make(constants=[constant("weights", np.full((N, M), np.inf))]), "constants", "not finite"),
        (make(constants=[WEIGHTS, constant("many", np.zeros(1_000_001), np.bool_)]), "constants", "1000000"),
        (make(constants=[WEIGHTS, helper.make_tensor("s", TensorProto.STRING, [1], [b"x"])]), "constants", "type 8"),
        (make(constants=[WEIGHTS, WEIGHTS]), "constants", "given twice"),
        (make(opset=12), "model", "opset 12 is outside the allowed range 13 … 21"),
        (make(opset=2**62), "model", "outside the allowed range"),
        (make(ir_version=99), "model", "IR version 99 is outside"),
        (make(domains=[("com.microsoft", 1)]), "model", "com.microsoft"),
        (make(domains=[("evil\x1b[31m", 1)]), "model", "evil"),
        (unknown_field(), "file format", "fields that ONNX does not know"),
        (make([LINEAR] * 2001), "model", "2001 nodes"),
        (
            make([helper.make_node("MatMul", ["observation", "weights"], ["action"], domain="evil")]),
            "operators",
            "evil",
        ),
        (after(node("Relu", ["linear"], "action", body=models.body())), "operators", "not a plain number"),
        (make([node("RandomNormal", [], "action", shape=[1, M])]), "operators", "not allowed"),
        (after(node("Multinomial", ["linear"], "action")), "operators", "not allowed"),
        (after(node("Bernoulli", ["linear"], "action")), "operators", "not allowed"),
        (after(node("Cast", ["linear"], "action", to=TensorProto.STRING)), "operators", "casts to type"),
        (after(node("Identity", ["later"], "action")), "operators", "not computed before"),
        (after(node("Softmax", ["linear"], "action", axis=0)), "operators", "lanes, which must stay apart"),
        (after(node("ReduceMean", ["linear"], "action")), "operators", "its axes must be given"),
        (after(node("Transpose", ["linear"], "t"), node("MatMul", ["t", "linear"], "action")), "operators", "apart"),
        (after(node("Concat", ["linear", "linear"], "action", axis=0)), "operators", "apart"),
        (
            after(node("Reshape", ["linear", "s"], "action"), constants=[constant("s", [-1, 2], np.int64)]),
            "operators",
            "4 elements per lane do not fit",
        ),
        (
            after(node("Reshape", ["linear", "s"], "action"), constants=[constant("s", [2**40, 2**40], np.int64)]),
            "operators",
            "loses the axis of the lanes",
        ),
        (
            after(node("Gather", ["linear", "s"], "action", axis=1), constants=[constant("s", [4], np.int64)]),
            "operators",
            "its indices must be -4 … 3",
        ),
        (make([node("Gemm", ["observation", "weights", "observation"], "action")]), "operators", "do not fit"),
        (make(inputs=[info("observation", 1, N)]), "operators", "with a name for the batch"),
        (make(inputs=[info("observation", 2**40, N)]), "operators", "with a name for the batch"),
        (make(inputs=[info("observation", "batch", "n")]), "operators", "with a name for the batch"),
        (make(inputs=[info("observation", "batch", N, kind=TensorProto.DOUBLE)]), "operators", "must be a float32"),
        (make(inputs=[info("observation", "batch", 18)]), "operators", "do not fit"),
        (make(outputs=[info("action", "batch", 2)]), "signature", "action must be float32 of shape (batch, 4)"),
        (make(outputs=[]), "signature", "must take observation"),
        (make(outputs=[ACTION, ACTION]), "signature", "given twice"),
        (make(inputs=[OBSERVATION, info("time", "batch", 1)]), "signature", "must take observation, state_0"),
        (make(inputs=[OBSERVATION, info("state_0", "batch", 1)]), "signature", "must take observation, state_0"),
        (make(inputs=[OBSERVATION, info("state_0", "batch", 2**50)]), "operators", "allowed are 1 … 1000000"),
    ],
)
def test_hostile_policy_files_are_refused_unrun(content: ModelProto | bytes, check: str, text: str) -> None:
    found, reason = static_refusal(content)
    assert (found, text in reason) == (check, True), (found, reason)
    assert reason.isprintable() and len(reason) < 1500


# --- behaviour -------------------------------------------------------------------------------------------------------


def test_what_onnxruntime_cannot_load_is_refused(tmp_path: Path) -> None:
    # Logical operators of numbers pass the shapes, not the types.
    content = after(node("Not", ["linear"], "action"))
    check, reason = refusal(check_submission(folder(tmp_path / "a", content)))
    assert check == "loading" and "onnxruntime cannot load it" in reason


class Fake:
    """Stands for a policy that got past the gate for files."""

    n_observation = N

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def predict(self, observation: Any, state: Any = None) -> tuple[Any, Any]:
        return self.answer(observation).astype(np.float32), None


def test_answers_that_depend_on_anything_else_are_refused() -> None:
    rng = np.random.default_rng(0)
    for answer, refused in (
        (lambda x: x[:, :M], None),
        (lambda x: x[:, :M] + rng.normal(size=(len(x), M)), "repeatable"),
        (lambda x: x[:, :M] + 0.01 * x.mean(), "lanes apart"),
        (lambda x: x[:, :M] + np.arange(len(x))[:, None], "lanes apart"),
    ):
        fake: Any = Fake(answer)
        passed = []
        with pytest.raises(ValueError) if refused else contextlib.nullcontext():
            for name, probe in PROBES:
                probe(fake)
                passed.append(name)
        names = [name for name, _ in PROBES]
        assert passed == (names[: names.index(refused)] if refused else names)


@pytest.mark.parametrize(
    "name",
    ["a;touch x", "$(id)", "--weak-isolation", "mine\n::error::hi", ".hidden", "ü", "a.toml", "AUX", "con.x", "a."],
)
def test_folder_whose_name_would_mean_something_to_a_shell_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.mkdir()
    with pytest.raises(ValueError, match="the folder's name must be"):
        read_files(path)


@pytest.mark.parametrize("name", ["linear-feedback", "ppo-k-0", "sac-k+tau-3"])
def test_shipped_entries_pass_every_check(name: str) -> None:
    report = check_submission(POLICIES / name)
    assert report.accepted, report.refusal


def test_folders_and_texts_of_all_shipped_entries_pass() -> None:
    folders = list(POLICIES.iterdir())
    assert len(folders) == 21 and all(parse_entry(read_files(path)["entry.toml"]).authors for path in folders)
