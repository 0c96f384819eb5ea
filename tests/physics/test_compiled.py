"""The disk cache of machine code belongs to exactly one version of the sources."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import wtg_gym
from wtg_gym.physics.compiled import cache_folder, source_hash

PROGRAM = """
import sys
sys.path.insert(0, {root!r})
from wtg_gym.physics.compiled import cache_folder
from wtg_gym.physics.aerodynamics import power_coefficient
print(cache_folder().name, float(power_coefficient(7.0)))
"""


def run_copy(root: Path, cache: Path) -> tuple[str, float]:
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "NUMBA_CACHE_DIR": ""}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(root=str(root))],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    folder, value = done.stdout.split()
    return folder, float(value)


def test_editing_a_callee_in_another_file_is_never_ignored(tmp_path: Path) -> None:
    package = Path(wtg_gym.__file__).parent
    shutil.copytree(package, tmp_path / "wtg_gym", ignore=shutil.ignore_patterns("__pycache__"))
    cache = tmp_path / "cache"
    before = run_copy(tmp_path, cache)
    edited = tmp_path / "wtg_gym" / "physics" / "elementary.py"
    edited.write_text(edited.read_text().replace("    return p * p\n", "    return 1.01 * p * p\n"))
    after = run_copy(tmp_path, cache)
    assert after[0] != before[0]
    assert after[1] != before[1]


def test_cache_folder_is_named_after_the_sources() -> None:
    folder = cache_folder()
    assert folder is not None
    assert source_hash().startswith(folder.name)
