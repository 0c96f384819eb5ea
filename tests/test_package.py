"""Facts about the installed package."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import wtg_gym

ROOT = Path(__file__).parent.parent


def test_importing_the_package_loads_nothing_heavy() -> None:
    program = "import sys, json, wtg_gym; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(json.loads(done.stdout))
    assert not loaded & {
        "torch",
        "onnx",
        "onnxruntime",
        "matplotlib",
        "pandas",
        "stable_baselines3",
        "rich",
        "baselines",
        "agents",
    }


def test_public_names_are_those_of_their_modules_and_no_others() -> None:
    assert all(getattr(wtg_gym, name) is not None and name in dir(wtg_gym) for name in wtg_gym.__all__)
    assert wtg_gym.GFMWTGEnv is wtg_gym.envs.GFMWTGEnv and wtg_gym.evaluate is wtg_gym.evaluation.evaluate
    with pytest.raises(AttributeError, match="no attribute 'evaluat'"):
        wtg_gym.evaluat  # noqa: B018


def test_package_is_typed() -> None:
    assert (Path(wtg_gym.__file__).parent / "py.typed").exists()


@pytest.mark.skipif(shutil.which("git") is None or not (ROOT / ".git").exists(), reason="needs a checkout and git")
def test_nothing_that_is_made_anew_is_in_the_repository() -> None:
    """Results, environments and machine code that somebody had added would be used instead of one's own."""
    command = ["git", "ls-files", "--cached", "--ignored", "--exclude-standard"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == ""
