"""Facts about the installed package."""

import importlib.metadata
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import wtg_gym

ROOT = Path(__file__).parent.parent
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def pins(name: str) -> dict[str, list[str]]:
    text = (ROOT / name).read_text(encoding="utf-8").replace("\\\n", "")
    lines = (line.split("--hash=") for line in text.splitlines() if not line.startswith("#"))
    return {requirement.strip(): [one.strip() for one in hashes] for requirement, *hashes in lines}


def installed(requirement: Requirement, seen: set[str]) -> set[str]:
    """Return the names of all that a requirement brings into this environment, extras in brackets."""
    for extra in ("", *sorted(requirement.extras)):
        key = f"{canonicalize_name(requirement.name)}[{extra}]"
        if key not in seen:
            seen.add(key)
            for needed in map(Requirement, importlib.metadata.requires(requirement.name) or ()):
                if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                    installed(needed, seen)
    return seen


def test_importing_the_package_loads_nothing_heavy():
    program = "import sys, json, wtg_gym; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(json.loads(done.stdout))
    heavy = {"torch", "onnx", "onnxruntime", "matplotlib", "pandas", "stable_baselines3", "rich"}
    assert not loaded & {*heavy, "baselines", "agents"}


def test_public_names_are_those_of_their_modules_and_no_others_and_typed():
    assert all(getattr(wtg_gym, name) is not None and name in dir(wtg_gym) for name in wtg_gym.__all__)
    assert (Path(wtg_gym.__file__).parent / "py.typed").exists()
    assert wtg_gym.GFMWTGEnv is wtg_gym.envs.GFMWTGEnv and wtg_gym.evaluate is wtg_gym.evaluation.evaluate
    with pytest.raises(AttributeError, match="no attribute 'evaluat'"):
        wtg_gym.evaluat  # noqa: B018


@pytest.mark.skipif(shutil.which("git") is None or not (ROOT / ".git").exists(), reason="needs a checkout and git")
def test_nothing_that_is_made_anew_is_in_the_repository():
    """Results, environments and machine code that somebody had added would be used instead of one's own."""
    command = ["git", "ls-files", "--cached", "--ignored", "--exclude-standard"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == ""


@pytest.mark.parametrize("name", ["constraints.txt", ".ci/uv.txt"])
def test_every_pin_is_one_version_with_its_hashes(name):
    for requirement, hashes in pins(name).items():
        assert re.fullmatch(r"[a-z0-9-]+==[a-z0-9.]+( ; .+)?", requirement)
        assert hashes and all(re.fullmatch("sha256:[0-9a-f]{64}", one) for one in hashes), requirement


def test_tools_of_the_release_and_all_that_tests_install_are_pinned():
    pinned = {requirement.split("==")[0] for requirement in (*pins("constraints.txt"), *pins(".ci/uv.txt"))}
    assert {"build", "editables", "hatchling", "twine", "uv"} <= pinned
    brought = {key.partition("[")[0] for key in installed(Requirement("wtg-gym[dev]"), set())}
    assert {"numpy", "pytest", "torch"} <= brought and brought - pinned == {"wtg-gym"}


def test_checkout_installs_by_its_pins_only():
    for path in (ROOT / "Makefile", *WORKFLOWS, *(ROOT / ".ci").iterdir()):
        assert not re.search(r"-m pip |/pip |^ *(- run: )?pip ", path.read_text(encoding="utf-8"), re.MULTILINE), path


def test_workflows_name_actions_by_their_commit():
    uses = [line for path in WORKFLOWS for line in path.read_text(encoding="utf-8").splitlines() if "uses:" in line]
    assert uses
    for line in uses:
        assert re.fullmatch(r" *(- )?uses: [\w.-]+/[\w.-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line), line
