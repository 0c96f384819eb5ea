"""The gate accepts honest submissions and refuses the others: folders, and entry.toml in every shape."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.submissions import models
from tests.submissions.models import TOML, folder, seed
from wtg_gym.evaluation import load_entries
from wtg_gym.policies import gate, policy_process
from wtg_gym.policies.entry_folder import ROOT, parse_submission, read_files
from wtg_gym.policies.gate import check_submission, read_submission, rollout

SHIPPED = ROOT / "agents" / "policies" / "ppo-v1-0"


@pytest.mark.parametrize("given", [None, SHIPPED], ids=["linear", "shipped"])
def test_plain_policies_pass_every_check(given, tmp_path):
    report = check_submission(folder(tmp_path / "a") if given is None else given)
    assert report.accepted and all(check.verdict == "passed" and check.reason for check in report.checks)
    assert not report.notes and report.shipped == (given is not None)


def test_policy_is_judged_in_the_environment_that_it_names(tmp_path, monkeypatch):
    monkeypatch.setattr(gate, "_ROLLOUT_LANES", 4)
    report = check_submission(folder(tmp_path / "a", models.of_v1(), models.TOML_V1))
    assert report.accepted and report.played().environment == "GFMWTG-14bus-v1"
    assert rollout(report.played()).shape[1:] == (4, 8)


def test_policy_that_is_slow_is_refused_and_no_later_check_is_made(monkeypatch, tmp_path):
    monkeypatch.setattr(gate, "ANSWER_S", 1e-9)
    report = check_submission(folder(tmp_path / "a"))
    assert [check.verdict for check in report.checks] == ["passed"] * 3 + ["refused"] + ["not reached"] * 2
    assert not report.accepted
    assert report.refusal.name == "speed" and "more than 1e-06 ms for an action" in report.refusal.reason


def test_policy_that_remembers_other_scenarios_is_refused(monkeypatch, tmp_path):
    """No file is known that can: one is played here by a process that mixes its scenarios."""
    mixes = """
answer = worker._Served.answer
def mixed(served, n, source):
    answer(served, n, source)
    served.outputs[0][-1] += 1e-6
worker._Served.answer = mixed"""
    monkeypatch.setattr(policy_process, "_SCRIPT", models.worker(tmp_path / "worker.py", mixes))
    monkeypatch.setattr(gate, "_ROLLOUT_LANES", 4)
    refusal = check_submission(folder(tmp_path / "a")).refusal
    assert refusal.name == "repeated" and "in another order" in refusal.reason


def _socket(path: Path) -> None:
    # A path of a socket has at most 108 bytes, so it is made from within its folder.
    before = os.getcwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(path.name)
    finally:
        os.chdir(before)


def _file(content: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content)


def _link(target: str) -> Callable[[Path], object]:
    return lambda path: path.symlink_to(target)


_NO_FILE = "no plain file"
#: A file of a sound submission, what makes another thing of it, and what the refusal says.
FOLDERS: list[tuple[str, Callable[[Path], object], str]] = [
    ("policy.onnx", os.mkfifo, _NO_FILE),
    ("policy.onnx", _socket, _NO_FILE),
    ("policy.onnx", _link("/dev/zero"), _NO_FILE),
    ("entry.toml", _link("/etc/passwd"), _NO_FILE),
    ("README.md", _link("/proc/self/mem"), _NO_FILE),
    ("entry.toml", _file(bytes(16_385)), "entry.toml: it has 16385 bytes; allowed: at most 16384"),
    ("policy.onnx", _file(bytes(5_000_001)), "policy.onnx: it has 5000001 bytes; allowed: at most 5000000"),
    ("README.md", _file(bytes(65_537)), "README.md: it has 65537 bytes; allowed: at most 65536"),
    ("policy.onnx", lambda path: None, "it has no policy.onnx"),
    ("numpy.py", _file(b"import os"), "it holds 'numpy.py'; allowed are entry.toml, policy.onnx, README.md"),
    (".gitattributes", _file(b"* filter=evil"), "it holds '.gitattributes'"),
    ("Policy.onnx", _file(b"in other capitals"), "it holds 'Policy.onnx'"),
]


@pytest.mark.parametrize(("name", "make", "said"), FOLDERS)
def test_folder_with_other_files_is_refused(name, make, said, tmp_path):
    path = folder(tmp_path / "a")
    (path / name).unlink(missing_ok=True)
    make(path / name)
    refusal = read_submission(path).refusal
    assert refusal.name == "folder" and said in refusal.reason and refusal.reason.isprintable()


def test_link_to_a_folder_and_what_is_no_folder_are_refused(tmp_path):
    (tmp_path / "link").symlink_to(folder(tmp_path / "a"))
    (tmp_path / "file").touch()
    for name in ("link", "file", "none"):
        with pytest.raises(ValueError, match="it is not a folder, or a link to one"):
            read_files(tmp_path / name)


@pytest.mark.parametrize(
    "name",
    ["a;touch x", "$(id)", "--weak-isolation", "mine\n::error::hi", ".hidden", "ü", "a.toml", "AUX", "con.x", "a."],
)
def test_folder_whose_name_would_mean_something_to_a_shell_is_refused(name, tmp_path):
    (tmp_path / name).mkdir()
    with pytest.raises(ValueError, match="the folder's name must be"):
        read_files(tmp_path / name)


_KEY = 'environment = "GFMWTG-14bus-v0"\n'
_REST = TOML.replace(_KEY, "")
_VERSION = "environment must be one of GFMWTG-14bus-v0, GFMWTG-14bus-v1"
WRONG: list[tuple[str | bytes, str]] = [
    (b"\xff\xfe", "not TOML"),
    ("name = ", "not TOML"),
    (TOML.replace("= 0", "= " + 5000 * "[" + 5000 * "]"), "not TOML"),
    ("", "missing: ['name', 'authors', 'training_seed', 'action_mode']"),
    (TOML + "law = 'x'\n", "unknown: ['law']"),
    (TOML.replace("Jane Doe", "x" * 401), "an author must be 1 … 60 characters"),
    (TOML.replace('["Jane Doe"]', '"me"'), "authors must be a list of 1 … 40 names"),
    (TOML.replace('["Jane Doe"]', '["a", "*b*"]'), "an author must be"),
    (TOML.replace('["Jane Doe"]', "[]"), "authors must be a list of 1 … 40 names"),
    (TOML + 'description = "_a_"', "description must be"),
    (TOML + 'trained_on = "a@b"', "trained_on must be"),
    *(
        (TOML.replace("Mine", name), "name must say nothing of seeds")
        for name in ("Mine (training seed 0)", "PPO (5 Seeds)", "M5seeds", "M 5 S.E.E.D.S", "5_training_seeds")
    ),
    (seed(-1), "training_seed must be a whole number 0 … 4294967295, got -1"),
    (TOML.replace('"k+tau"', "[]"), "action_mode must be one of"),
    (TOML + 'observation_mode = "all"\n', "observation_mode must be one of"),
    (TOML + 'strategy = "../law.toml"\n', "strategy must be one of mppt"),
    (TOML + _KEY, "not TOML"),
    (TOML + '"environment" = "GFMWTG-14bus-v1"\n', "not TOML"),
    *((mark + TOML, "not TOML") for mark in ("\ufeff", "\r", "\0")),
    (_REST + '[environment]\nid = "GFMWTG-14bus-v0"\n', _VERSION),
    (_REST + 'environment = "GFMWTG\u201014bus-v0"\n', _VERSION),
    (_REST + '"\u0435nvironment" = "GFMWTG-14bus-v0"\n', "unknown: ['\\u0435nvironment']"),
]


@pytest.mark.parametrize(("toml", "said"), WRONG)
def test_wrong_entry_files_are_refused(toml, said, tmp_path):
    refusal = read_submission(folder(tmp_path / "a", toml=toml)).refusal
    assert refusal.name == "entry.toml" and said in refusal.reason
    assert refusal.reason.isprintable() and len(refusal.reason) < 1600


@pytest.mark.parametrize(
    ("line", "version"),
    [
        ('"\\u0065nvironment" = "GFMWTG-14bus-v\\u0030"\r\n', "v0"),
        ('environment = "GFMWTG-14bus-v0" # "GFMWTG-14bus-v1"\n', "v0"),
        ('# environment = "GFMWTG-14bus-v0"\n', "v1"),
        ('trained_on = """\\\n    environment = GFMWTG-14bus-v0"""\n', "v1"),
    ],
)
def test_every_reader_of_entry_toml_sees_the_same_version(line, version, tmp_path):
    content = (_REST + line).encode()
    env_id = f"GFMWTG-14bus-{version}"
    assert parse_submission(content).environment == env_id
    assert load_entries(folder(tmp_path / "a", toml=content))[0].environment == env_id
