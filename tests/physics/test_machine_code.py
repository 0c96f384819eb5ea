"""Machine code on disk heals itself, is shared by processes, and says so when it is compiled."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numba
import pytest

from wtg_gym.physics.compiled import is_compiled
from wtg_gym.physics.machine_code import DiskCache

#: Two functions, of which one calls the other, compiled as the simulator's are; the folder is an argument.
PROGRAM = """
import sys
from pathlib import Path
import numba
from wtg_gym.physics import machine_code
from wtg_gym.physics.machine_code import Compilation, DiskCache
from numba.core import event

machine_code._SILENT_FUNCTIONS = 2
machine_code._SHORT_S = 0.0
folder = Path(sys.argv[1])
compilation = Compilation(folder)
event.register("numba:compile", compilation)

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

print(one_more(3.0), one_more(3), square(2.0), compilation.n_functions)
"""
RESULT = ["10.0", "10", "4.0"]


def run(folder: Path, program: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(program), str(folder)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def outcome(process: subprocess.Popen[str]) -> tuple[list[str], int, str]:
    """What the functions return, how many were compiled, and stderr."""
    out, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    *values, n_compiled = out.split()
    return values, int(n_compiled), said


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("program") / "program.py"
    path.write_text(PROGRAM)
    return path


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory, program: Path) -> tuple[Path, str]:
    """A folder with the code of both functions for two types each, and what was said while it was filled."""
    folder = tmp_path_factory.mktemp("first") / "code"
    values, n_compiled, said = outcome(run(folder, program))
    assert (values, n_compiled) == (RESULT, 4)
    assert len(list(folder.iterdir())) == 4
    return folder, said


def test_what_is_compiled_is_known_for_each_type(tmp_path: Path) -> None:
    def doubled(x: float) -> float:
        return 2.0 * x

    function = numba.njit(doubled)
    function._cache = DiskCache(doubled, tmp_path, "0" * 64)
    assert not is_compiled(function, 1.0)
    function(1.0)
    assert is_compiled(function, 1.0) and not is_compiled(function, 1)
    assert is_compiled(doubled, 1)


@pytest.fixture
def filled(tmp_path: Path, first_run: tuple[Path, str]) -> Path:
    """A copy of that folder."""
    return shutil.copytree(first_run[0], tmp_path / "code")


def _exchange(*paths: Path) -> None:
    contents = [path.read_bytes() for path in paths]
    for path, content in zip(paths, [*contents[1:], contents[0]], strict=True):
        path.write_bytes(content)


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def _cut(*paths: Path) -> None:
    for path in paths:
        path.write_bytes(path.read_bytes()[:-100])


def _damage_in_four_ways(a: Path, b: Path, c: Path, d: Path) -> None:
    _cut(a)
    b.write_bytes(b.read_bytes()[:10])
    c.write_bytes(os.urandom(5000))
    d.write_bytes(b"")


def _damage_in_three_ways(a: Path, b: Path, c: Path, d: Path) -> None:
    _exchange(a, b)
    _flip(c)
    d.unlink()


@pytest.mark.parametrize(
    "damage",
    [_damage_in_four_ways, _damage_in_three_ways],
    ids=["truncated, cut within the checksum, random, empty", "exchanged, one bit, deleted"],
)
def test_damaged_files_are_compiled_again_and_replaced(
    filled: Path, program: Path, damage: Callable[..., None]
) -> None:
    files = sorted(filled.iterdir())
    intact = {path: path.stat().st_size for path in files}
    damage(*files)
    values, n_compiled, said = outcome(run(filled, program))
    assert (values, n_compiled) == (RESULT, 4)
    assert "Traceback" not in said
    assert {path: path.stat().st_size for path in sorted(filled.iterdir())} == intact
    assert outcome(run(filled, program)) == (RESULT, 0, "")


def test_processes_that_start_at_once_over_damaged_files_all_succeed(filled: Path, program: Path) -> None:
    _cut(*filled.iterdir())
    for process in [run(filled, program) for _ in range(2)]:
        assert outcome(process)[0] == RESULT
    assert outcome(run(filled, program)) == (RESULT, 0, "")
    assert len(list(filled.iterdir())) == 4


def test_a_folder_in_the_place_of_a_file_costs_the_compilation_only(filled: Path, program: Path) -> None:
    path = sorted(filled.iterdir())[0]
    path.unlink()
    path.mkdir()
    values, n_compiled, said = outcome(run(filled, program))
    assert values == RESULT and n_compiled >= 1
    assert said.count("wtg_gym cannot keep machine code in") == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_full_disk_is_named_once_and_stops_nothing(tmp_path: Path) -> None:
    # Every write goes to a device that is always full.
    full = "Path.write_bytes = lambda path, content: open('/dev/full', 'wb').write(content)"
    program = tmp_path / "program.py"
    program.write_text(PROGRAM.replace("folder = Path(sys.argv[1])", f"folder = Path(sys.argv[1])\n{full}"))
    values, n_compiled, said = outcome(run(tmp_path / "code", program))
    assert (values, n_compiled) == (RESULT, 4)
    assert said.count("No space left on device") == 1


def test_compiling_says_where_code_is_kept_and_how_long_it_took(first_run: tuple[Path, str]) -> None:
    folder, said = first_run
    first, *rest = said.splitlines()
    assert first.startswith("wtg_gym compiles its simulator to machine code: about a minute, kept in")
    assert first.endswith(str(folder))
    assert any(line.startswith("wtg_gym compiled one_more in ") for line in rest)
