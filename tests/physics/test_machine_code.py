"""Machine code on disk belongs to one version of the sources, heals itself and is shared by processes."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from llvmlite.binding import get_host_cpu_features

import wtg_gym
from wtg_gym.systems import compiled
from wtg_gym.systems.compiled import KINDS

IS_V3 = all(map(get_host_cpu_features().get, KINDS["x86-64-v3"]))
#: Two functions, of which one calls the other, compiled as the simulator's are, in a `folder`.
PROGRAM = """
import numba
from numba.core import event
from wtg_gym.systems.compiled import Compilation, DiskCache

compilation = Compilation(folder)

def compiled(function):
    result = numba.njit(function)
    result._cache = DiskCache(function, folder, "0" * 64)
    return result

@compiled
def square(x):
    return x * x

@compiled
def one_more(x):
    return square(x) + 1

with event.install_listener("numba:compile", compilation):
    found = [one_more(3.0), one_more(3), square(2.0), compilation.n_functions]
"""
IN_A_PROCESS = "import sys\nfrom pathlib import Path\nfolder = Path(sys.argv[1])\n" + PROGRAM + "print(*found)"
COPIED = """
import sys
sys.path.insert(0, sys.argv[1])
from wtg_gym.systems.compiled import cache_folder, source_hash
from wtg_gym.physics.aerodynamics import power_coefficient
assert source_hash().startswith(cache_folder().name)
print(cache_folder().name, float(power_coefficient(7.0)))
"""


def here(folder: Path | None) -> int:
    """Run the functions, defined anew, in this process; return how many were compiled."""
    names = {"__name__": "__main__", "folder": folder}
    exec(PROGRAM, names)
    *results, n_compiled = names["found"]
    assert results == [10.0, 10, 4.0]
    return n_compiled


def run(program: str, folder: Path, **environment: str) -> subprocess.Popen[str]:
    command, pipes = [sys.executable, "-c", program, str(folder)], dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen(command, env={**os.environ, **environment}, text=True, **pipes)


def outcome(process: subprocess.Popen[str]) -> list[str]:
    out, message = process.communicate(timeout=300)
    assert process.returncode == 0 and "Traceback" not in message, message
    return out.split()


@pytest.fixture
def folder(tmp_path):
    """A folder with machine code of all functions."""
    assert here(tmp_path / "code") == 4
    return tmp_path / "code"


def test_damaged_files_are_compiled_again_and_replaced_by_processes_that_start_at_once(folder):
    intact = {path: path.read_bytes() for path in sorted(folder.iterdir())}
    other_bit, cut, empty, exchanged = intact
    content = bytearray(intact[other_bit])
    content[len(content) // 2] ^= 1
    other_bit.write_bytes(content)
    cut.write_bytes(intact[cut][:-100])
    empty.write_bytes(b"")
    exchanged.write_bytes(intact[other_bit])
    for process in [run(IN_A_PROCESS, folder) for _ in range(2)]:
        assert outcome(process)[:3] == ["10.0", "10", "4.0"]
    assert set(folder.iterdir()) == set(intact)
    assert here(folder) == 0


@pytest.mark.skipif(not IS_V3, reason="needs a processor of the kind x86-64-v3")
def test_a_wheels_code_for_a_kind_of_processor_is_used_by_those_of_that_kind(tmp_path, monkeypatch):
    made = outcome(run(IN_A_PROCESS, tmp_path, NUMBA_CPU_NAME="x86-64-v3", NUMBA_CPU_FEATURES=""))
    assert made == ["10.0", "10", "4.0", "4"]
    for place, n_compiled in ((tmp_path, 0), (tmp_path / "none", 4)):
        monkeypatch.setattr(compiled, "SHIPPED", place)
        assert here(None) == n_compiled


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs files that belong to users")
def test_code_that_another_user_could_have_written_is_not_run(folder):
    for path in folder.iterdir():
        path.chmod(0o602)
    assert here(folder) == 4
    assert {path.lstat().st_mode for path in folder.iterdir()} == {0o100600}
    folder.chmod(0o777)
    assert here(folder) == 4


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs folders that belong to users")
def test_machine_code_lies_in_the_first_place_that_only_the_user_can_write_to(tmp_path, monkeypatch):
    shared, of_group, home = (tmp_path / name for name in ("shared", "of-group", "home"))
    for place, mode in ((shared, 0o777), (of_group, 0o770), (home, 0o755)):
        place.mkdir()
        place.chmod(mode)
    monkeypatch.setattr(compiled.numba.config, "CACHE_DIR", str(shared))
    monkeypatch.setenv("XDG_CACHE_HOME", str(of_group))
    monkeypatch.setenv("HOME", str(home))
    used = compiled.cache_folder.__wrapped__()
    assert used.is_relative_to(home / ".cache") and not [*shared.iterdir(), *of_group.iterdir()]
    # A folder in a shared one is as good as any, as long as nobody else made it.
    shared.chmod(0o1777)
    used = compiled.cache_folder.__wrapped__()
    assert used.is_relative_to(shared) and {path.stat().st_mode & 0o777 for path in shared.rglob("*")} == {0o700}
    home.chmod(0o777)
    shared.chmod(0o777)
    monkeypatch.setattr(tempfile, "tempdir", str(of_group))
    assert compiled.cache_folder.__wrapped__() is None


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of processes")
def test_a_full_disk_stops_nothing(tmp_path):
    full = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    assert outcome(run(full + IN_A_PROCESS, tmp_path / "code"))[3] == "4"
    assert list((tmp_path / "code").iterdir()) == []


def test_editing_a_callee_in_another_file_is_never_ignored(tmp_path):
    ignored = shutil.ignore_patterns("__pycache__", "shipped")
    shutil.copytree(Path(wtg_gym.__file__).parent, tmp_path / "wtg_gym", ignore=ignored)
    own = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "NUMBA_CACHE_DIR": ""}
    before = outcome(run(COPIED, tmp_path, **own))
    edited = tmp_path / "wtg_gym" / "systems" / "elementary.py"
    edited.write_text(edited.read_text().replace("    return p\n", "    return 1.01 * p\n"))
    after = outcome(run(COPIED, tmp_path, **own))
    assert after[0] != before[0] and after[1] != before[1]
