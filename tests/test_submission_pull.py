"""`.ci/submissions`: which pull requests are submissions, and what of them is scored by the branch's own command."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / ".ci" / "submissions"

CAN_RUN = sys.platform == "linux" and shutil.which("git") and shutil.which("bash")
pytestmark = pytest.mark.skipif(not CAN_RUN, reason="needs git, bash and Linux")
CHANGES: dict[str, Callable[[Path], object]] = {
    "code": lambda pull: (pull / "code.py").write_text("raise SystemExit\n"),
    "another's policy": lambda pull: (pull / "agents/policies/first/policy.onnx").write_bytes(b"mine"),
    "a file more": lambda pull: (pull / "agents/policies/first/more.md").write_text("mine"),
    "a part less": lambda pull: (pull / "agents/policies/first/README.md").unlink(),
    "a file beside the folders": lambda pull: (pull / "agents/policies/x").write_text("mine"),
    "a name for the shell": lambda pull: (pull / "agents/policies/first/$(id)\n").write_text("mine"),
    "a link": lambda pull: (pull / "agents/policies/link").symlink_to("first"),
}


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main")
    command = ["git", *identity, *arguments]
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, timeout=60).stdout


def entry(name: str) -> Callable[[Path], object]:
    def add(checkout: Path) -> None:
        folder = checkout / "agents" / "policies" / name
        folder.mkdir(parents=True)
        for file in ("entry.toml", "policy.onnx", "README.md"):
            (folder / file).write_text(f"{file} of {name}\n")

    return add


@pytest.fixture
def base(tmp_path):
    folder = tmp_path / "base"
    for name in ("first", "second"):
        entry(name)(folder)
    (folder / "code.py").write_text("pass\n")
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "--message", "base")
    return folder


@pytest.fixture
def judge(base, tmp_path):
    """Return what the script says about a pull request that makes a change; the command says what it was asked."""
    command = tmp_path / "bin" / "wtg-gym"
    command.parent.mkdir()
    command.write_text('#!/bin/sh\necho "wtg-gym $@"\n')
    command.chmod(0o755)

    def judged(change: Callable[[Path], object]) -> tuple[int, str]:
        pull = tmp_path / "pull"
        git(tmp_path, "clone", "--quiet", str(base), str(pull))
        change(pull)
        git(pull, "add", "--all", "--force")
        git(pull, "commit", "--quiet", "--message", "change", "--allow-empty")
        # No user's settings of git.
        environment = {"PATH": f"{command.parent}:/usr/bin:/bin", "HOME": str(tmp_path)}
        arguments = ["bash", str(SCRIPT), str(base), str(pull), "results"]
        done = subprocess.run(arguments, capture_output=True, text=True, timeout=60, env=environment)
        return done.returncode, done.stdout + done.stderr

    return judged


def test_new_folder_is_checked_beside_the_others_and_scored(judge, tmp_path):
    code, message = judge(entry("mine"))
    beside = " ".join(f"{tmp_path}/base/agents/policies/{name}/" for name in ("first", "second"))
    mine = f"{tmp_path}/pull/agents/policies/mine"
    options = f"--beside {beside} --results results --cards results/cards"
    assert (code, message) == (0, f"wtg-gym submission score {mine} {options}\n")


@pytest.mark.parametrize("change", CHANGES)
def test_other_changes_are_refused(change, judge):
    code, message = judge(CHANGES[change])
    assert code == 1 and "changes nothing else" in message and "wtg-gym" not in message


def test_whole_folder_may_be_withdrawn(judge):
    code, message = judge(lambda pull: shutil.rmtree(pull / "agents/policies/second"))
    assert code == 0 and "may ask for:\n  agents/policies/second\nnothing to score" in message


def test_merge_that_takes_back_what_the_branch_did_is_refused(base, judge):
    """Two common ancestors: seen from the one, the pull request only adds; merged, it undoes what the other did."""
    git(base, "checkout", "--quiet", "-b", "earlier")
    entry("merged")(base)
    git(base, "add", ".")
    git(base, "commit", "--quiet", "--message", "earlier")
    git(base, "checkout", "--quiet", "main")
    (base / "code.py").write_text("raise SystemExit\n")
    git(base, "commit", "--quiet", "--all", "--message", "mended")
    mended = git(base, "rev-parse", "HEAD").strip()
    git(base, "merge", "--quiet", "--no-ff", "--message", "merged", "earlier")

    def undo(pull: Path) -> None:
        git(pull, "reset", "--quiet", "--hard", "origin/earlier")
        git(pull, "merge", "--quiet", "--strategy", "ours", "--message", "nothing of it", mended)
        entry("mine")(pull)

    code, message = judge(undo)
    assert code == 1 and "must have one latest common ancestor, they have 2" in message
