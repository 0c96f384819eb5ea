"""The gate accepts honest submissions and refuses the others: folders, and entry.toml in every shape."""

import contextlib
import os
import re
import shutil
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from onnx import ModelProto

from tests.submissions import models
from tests.submissions.models import TOML, folder, seed
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.tracking_law import LAW_NAMES
from wtg_gym.policies import gate, policy_process
from wtg_gym.policies.entry_folder import ROOT, parse_submission, policy_folders, policy_name, read_files
from wtg_gym.policies.gate import Report, check_submission, conflicts, read_submission
from wtg_gym.tasks import V0, V1

SHIPPED = ROOT / "agents" / "policies" / "ppo-v1-0"
DIFFERENT = {
    **{"authors": '["John Roe"]', "action_mode": '"k"', "environment": '"GFMWTG-14bus-v1"', "per_group": "true"},
    **{"observation_mode": '"privileged"', "strategy": '"mppt"'},
    **{"description": '"Better"', "trained_on": '"The test scenarios"'},
}
YOURS = TOML.replace("Mine", "Yours")
POLICIES = ROOT / "agents" / "policies"
#: Of folders, and of entries; both are refused whatever their capitals, signs, and letters that look alike.
TAKEN_FOLDERS = """
baselines Baselines base-lines baselines.fast_droop policies po1icies POLICIES. agents agents.train tests wtg_gym
wtg-gym.evaluation mppt MPPT coordinated-tuned coordinated_tuned deloaded5 fast-droop fast_droop FastDroop
tip-speed-feedback tip.speed.feedback T1p-Speed-Feedback ppo-k-0 PPO-K-0 ppo-k-O ppo-k ppo-ktau-0 linear-feedback
linear_feedback Gradient-0 \u017fac-v1-0 ppo-\u212a-0
"""
TAKEN_NAMES = """
baselines; policies; Policies; b a s e l i n e s; baselines.mppt; Coordinated-Piecewise; coordinated piecewise;
coordinated (tuned); Fast Droop; fast droop.; TIP_SPEED_FEEDBACK; PPO k 0; ppo k, tau; Iinear-feedback
"""
TAKEN = [("folder", name) for name in TAKEN_FOLDERS.split()]
TAKEN += [("entry.toml", name.strip()) for name in TAKEN_NAMES.split(";")]
VERSIONS = [
    ('"\\u0065nvironment" = "GFMWTG-14bus-v\\u0030"\r\n', "v0"),
    ('environment = "GFMWTG-14bus-v0" # "GFMWTG-14bus-v1"\n', "v0"),
    ('# environment = "GFMWTG-14bus-v0"\n', "v1"),
    ('trained_on = """\\\n    environment = GFMWTG-14bus-v0"""\n', "v1"),
]
ALIKE = [
    ("One", YOURS, "differ in capitals alone"),
    ("one", YOURS, "looks like"),
    ("m-ine", YOURS, "looks like"),
    ("b", TOML.replace("Mine", "O N E"), "looks like"),
]


@pytest.mark.parametrize("given", [None, SHIPPED], ids=["linear", "shipped"])
def test_plain_policies_pass_every_check_and_their_files_are_listed(given, tmp_path):
    path = given or folder(tmp_path / "a")
    if given is None:
        (path / "README.md").write_text("Mine.")
    report = check_submission(path)
    assert all(f"{each.name} {each.stat().st_size} bytes" in report.made[0].reason for each in path.iterdir())
    assert report.accepted and all(check.verdict == "passed" and check.reason for check in report.checks)
    assert not report.notes and report.shipped == (given is not None)


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
    answers = answer(served, n, source)
    answers[0][-1] += 1e-6
    return answers
worker._Served.answer = mixed"""
    monkeypatch.setattr(policy_process, "_SCRIPT", models.worker(tmp_path / "worker.py", mixes))
    monkeypatch.setattr(gate, "_ROLLOUT_ENVS", 4)
    refusal = check_submission(folder(tmp_path / "a")).refusal
    assert refusal.name == "repeated" and "in another order" in refusal.reason


def _socket(path: Path) -> None:
    # A path of a socket has at most 108 bytes, so it is made from within its folder.
    with contextlib.chdir(path.parent), socket.socket(socket.AF_UNIX) as one:
        one.bind(path.name)


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


SHELL = ["a;touch x", "$(id)", "--weak-isolation", "mine\n::error::hi", ".hidden", "ü", "a.toml", "AUX", "con.x", "a."]


@pytest.mark.parametrize("name", SHELL)
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
    (TOML.replace('["Jane Doe"]', '"me"'), "authors must be a list of 1 … 40 names"),
    (TOML.replace('["Jane Doe"]', '["a", "*b*"]'), "an author must be"),
    (TOML.replace('["Jane Doe"]', "[]"), "authors must be a list of 1 … 40 names"),
    (TOML + 'description = "_a_"', "description must be"),
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


@pytest.mark.parametrize(("line", "version"), VERSIONS)
def test_every_reader_of_entry_toml_sees_the_same_version(line, version, tmp_path):
    content = (_REST + line).encode()
    env_id = f"GFMWTG-14bus-{version}"
    assert parse_submission(content).environment == env_id
    assert load_entries(folder(tmp_path / "a", toml=content))[0].environment == env_id


def report(path: Path, content: ModelProto | None = None, toml: str = TOML) -> Report:
    made = read_submission(folder(path, content, toml))
    assert made.accepted, made.refusal
    return made


def different(key: str) -> str:
    lines = [line for line in seed(1).splitlines() if not line.startswith(f"{key} =")]
    return "\n".join([*lines, f"{key} = {DIFFERENT[key]}\n"])


OTHER_ROWS = [
    (seed(1).replace("Mine", "M I N E"), "the names Mine and M I N E look alike"),
    (TOML, r"Mine \(training seed 0\) is given twice"),
    *((different(key), rf"must agree on .*{key}.*, got .+ and .+: /") for key in DIFFERENT),
]


@pytest.mark.parametrize(("toml", "said"), OTHER_ROWS)
def test_nobody_joins_anothers_row(toml, said, tmp_path):
    first, second = report(tmp_path / "a"), report(tmp_path / "b", models.other(), toml)
    (conflict,) = conflicts([first, second])
    assert conflict.folders == (first.folder, second.folder) and re.search(said, conflict.reason)
    # Not even who says the same joins a row that is there.
    (conflict,) = conflicts([second], [first])
    assert conflict.folders == (second.folder,) and "is taken by Mine of" in conflict.reason


def test_seeds_of_one_entry_are_accepted_and_a_file_counts_once_whatever_it_is_called(tmp_path):
    first, second = report(tmp_path / "a"), report(tmp_path / "b", toml=seed(1))
    third = report(tmp_path / "c", toml=YOURS)
    for result in (conflicts([first, second]), conflicts([first, third]), conflicts([third], [first])):
        assert "the same policy file is given twice" in result[0].reason
    assert conflicts([first, report(tmp_path / "d", models.other(), seed(1))]) == []
    assert conflicts([first], [report(tmp_path / "e", models.other(), YOURS)]) == []


@pytest.mark.parametrize(("name", "toml", "said"), ALIKE)
def test_folder_is_not_called_as_another_folder_or_entry(name, toml, said, tmp_path):
    first, second = report(tmp_path / "a" / "one"), report(tmp_path / "b" / name, models.other(), toml)
    for result in (conflicts([first, second]), conflicts([second], [first])):
        assert said in result[0].reason


def test_what_is_there_is_compared_as_far_as_it_can_be_read(tmp_path):
    broken = read_submission(folder(tmp_path / "a", toml="name = "))
    assert not broken.accepted
    (conflict,) = conflicts([report(tmp_path / "b")], [broken])
    assert "the same policy file is given twice" in conflict.reason


def refused(path: Path) -> tuple[str, str]:
    """The check that refuses a folder, and why, which is one line."""
    refusal = read_submission(path).refusal
    assert refusal.reason.isprintable()
    return refusal.name, refusal.reason


@pytest.mark.parametrize(("check", "name"), TAKEN)
def test_neither_folder_nor_entry_has_a_name_by_which_something_is_found(check, name, tmp_path):
    of_folder = check == "folder"
    path = folder(tmp_path / name) if of_folder else folder(tmp_path / "a", toml=TOML.replace("Mine", name))
    result, reason = refused(path)
    assert result == check and reason.startswith("the folder's name must" if of_folder else "name must not be")


def test_everything_that_is_found_by_name_is_refused_as_a_name(tmp_path):
    baselines = {entry.name for version in (V0, V1) for entry in load_entries("baselines", task=version)}
    shipped = {name for path in policy_folders() for name in (path.name, policy_name(path))}
    for index, name in enumerate(sorted({*LAW_NAMES, *baselines, *filter(None, shipped)})):
        assert load_entries(name)
        assert refused(folder(tmp_path / str(index), toml=TOML.replace("Mine", name)))[0] == "entry.toml"


@pytest.mark.parametrize("name", ["baselines", "policies", "mppt", "fast-droop"])
def test_folder_at_hand_does_not_stand_before_a_word_or_a_baseline(name, tmp_path, monkeypatch):
    expected = [entry.name for entry in load_entries(name)]
    shutil.copytree(POLICIES / "ppo-k-2", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert [entry.name for entry in load_entries(name)] == expected
    assert [entry.name for entry in load_entries(f"./{name}")] == ["PPO (k)"]


@pytest.mark.parametrize("name", ["Fast Droop", "baselines", "po1icies"])
def test_own_law_and_own_folder_are_not_called_like_a_baseline(name, tmp_path):
    law = tmp_path / "mine.toml"
    law.write_text(f'name = "{name}"\nk_min = 1.0\nk_nominal = 0.8\nk_max = 0.6\n')
    with pytest.raises(ValueError, match=r"^the name of the law in .*mine.toml must not be, or look like"):
        load_entries(law)
    with pytest.raises(ValueError, match=r"^the entry file .*entry.toml: name must not be, or look like"):
        load_entries(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))


def test_shipped_folders_pass_beside_all_others():
    reports = [read_submission(path) for path in policy_folders()]
    assert all(report.accepted and report.shipped for report in reports)
    assert conflicts(reports) == [] == conflicts(reports[:1], reports[1:])
