"""`.ci/submissions`: which pull requests are submissions, and that it is the branch's gate that judges them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

#: Says what the script answers to a pull request that makes a change: its exit code, and all that it says.
Judge = Callable[[Callable[[Path], object]], tuple[int, str]]

ROOT = Path(__file__).parent.parent
POLICIES = ROOT / "agents" / "policies"
SCRIPT = ROOT / ".ci" / "submissions"
CACHES = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")

pytestmark = pytest.mark.skipif(
    shutil.which("git") is None or shutil.which("bash") is None or sys.platform != "linux",
    reason="needs git, bash and Linux",
)


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main")
    done = subprocess.run(
        ["git", *identity, *arguments], cwd=folder, check=True, capture_output=True, text=True, timeout=60
    )
    return done.stdout


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """A repository with two entries and some code."""
    folder = tmp_path / "base"
    for name in ("ppo-k-0", "ppo-k-1"):
        shutil.copytree(POLICIES / name, folder / "agents" / "policies" / name)
    (folder / "code.py").write_text("pass\n")
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "--message", "base")
    return folder


@pytest.fixture
def judge(base: Path, tmp_path: Path) -> Judge:
    """Return what the script says about a pull request that makes a change."""
    command = tmp_path / "bin" / "wtg-gym"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -P -m wtg_gym.cli "$@"\n')
    command.chmod(0o755)

    def judged(change: Callable[[Path], object]) -> tuple[int, str]:
        pull = tmp_path / "pull"
        git(tmp_path, "clone", "--quiet", str(base), str(pull))
        change(pull)
        git(pull, "add", "--all", "--force")
        git(pull, "commit", "--quiet", "--message", "change", "--allow-empty")
        done = subprocess.run(
            ["bash", str(SCRIPT), str(base), str(pull), str(tmp_path / "results")],
            capture_output=True,
            text=True,
            timeout=600,
            # No user's settings of git; but the machine code is kept, since compiling takes a minute.
            env={"PATH": f"{command.parent}:/usr/bin:/bin", "HOME": str(tmp_path), "XDG_CACHE_HOME": CACHES},
        )
        return done.returncode, done.stdout + done.stderr

    return judged


def policy(name: str) -> Callable[[Path], object]:
    return lambda pull: shutil.copytree(POLICIES / name, pull / "agents" / "policies" / name)


def test_new_folder_is_checked_and_scored(judge: Judge, tmp_path: Path) -> None:
    code, said = judge(policy("linear-feedback"))
    assert code == 0, said
    assert "linear-feedback" in said and "coordinated-piecewise" in said
    assert (tmp_path / "results" / "standard-test.csv").is_file()


def test_copy_of_an_entry_that_is_there_is_refused(
    judge: Judge,
) -> None:
    def copy(pull: Path) -> None:
        folder = pull / "agents" / "policies" / "mine"
        shutil.copytree(POLICIES / "ppo-k-0", folder)
        text = (folder / "entry.toml").read_text()
        (folder / "entry.toml").write_text(text.replace("training_seed = 0", "training_seed = 77"))

    code, said = judge(copy)
    assert code == 1 and "refused" in said


CHANGES: dict[str, Callable[[Path], object]] = {
    "code": lambda pull: (pull / "code.py").write_text("raise SystemExit\n"),
    "another's policy": lambda pull: (pull / "agents/policies/ppo-k-0/policy.onnx").write_bytes(b"mine"),
    "a file more": lambda pull: (pull / "agents/policies/ppo-k-0/README.md").write_text("mine"),
    "a part less": lambda pull: (pull / "agents/policies/ppo-k-0/README.md").unlink(),
    "a file beside the folders": lambda pull: (pull / "agents/policies/x").write_text("mine"),
    "a name for the shell": lambda pull: (pull / "agents/policies/ppo-k-0/$(id)\n").write_text("mine"),
    "a link": lambda pull: (pull / "agents/policies/link").symlink_to("ppo-k-0"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_other_changes_are_refused(change: str, judge: Judge) -> None:
    code, said = judge(CHANGES[change])
    assert code == 1 and "changes nothing else" in said


def test_whole_folder_may_be_withdrawn(judge: Judge) -> None:
    code, said = judge(lambda pull: shutil.rmtree(pull / "agents/policies/ppo-k-1"))
    assert code == 0
    assert "may ask for:\n  agents/policies/ppo-k-1\n" in said and "nothing to score" in said


def test_merge_that_takes_back_what_the_branch_did_is_refused(base: Path, judge: Judge) -> None:
    """Two common ancestors: seen from the one, the pull request only adds; merged, it undoes what the other did."""
    git(base, "checkout", "--quiet", "-b", "earlier")
    (base / "agents" / "policies" / "first").mkdir()
    (base / "agents" / "policies" / "first" / "README.md").write_text("a submission that was merged\n")
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
        policy("ppo-k-2")(pull)

    code, said = judge(undo)
    assert code == 1 and "must have one latest common ancestor, they have 2" in said


def test_history_of_another_repository_is_refused(
    judge: Judge,
) -> None:
    code, said = judge(lambda pull: git(pull, "checkout", "--quiet", "--orphan", "other"))
    assert code == 1 and "must have one latest common ancestor, they have 0" in said
