"""Machine code on disk heals itself, is shared by processes, and says so when it is compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

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


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    return path


@pytest.fixture
def filled(tmp_path: Path, program: Path) -> Path:
    """A folder with the code of both functions for two types each."""
    folder = tmp_path / "code"
    values, n_compiled, _ = outcome(run(folder, program))
    assert (values, n_compiled) == (RESULT, 4)
    assert len(list(folder.iterdir())) == 4
    return folder


def _exchange(files: list[Path]) -> None:
    contents = [path.read_bytes() for path in files]
    for path, content in zip(files, [*contents[1:], contents[0]], strict=True):
        path.write_bytes(content)


def _flip(files: list[Path]) -> None:
    for path in files:
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)


DAMAGES: dict[str, Callable[[list[Path]], object]] = {
    "truncated": lambda files: [path.write_bytes(path.read_bytes()[:-100]) for path in files],
    "cut within the checksum": lambda files: [path.write_bytes(path.read_bytes()[:10]) for path in files],
    "random bytes": lambda files: [path.write_bytes(os.urandom(5000)) for path in files],
    "empty": lambda files: [path.write_bytes(b"") for path in files],
    "exchanged": _exchange,
    "one bit": _flip,
    "deleted": lambda files: [path.unlink() for path in files],
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_files_are_compiled_again_and_replaced(filled: Path, program: Path, damage: str) -> None:
    files = sorted(filled.iterdir())
    intact = {path: path.stat().st_size for path in files}
    DAMAGES[damage](files)
    values, n_compiled, said = outcome(run(filled, program))
    assert (values, n_compiled) == (RESULT, 4)
    assert "Traceback" not in said
    assert {path: path.stat().st_size for path in sorted(filled.iterdir())} == intact
    assert outcome(run(filled, program)) == (RESULT, 0, "")


def test_processes_that_start_at_once_over_damaged_files_all_succeed(filled: Path, program: Path) -> None:
    DAMAGES["truncated"](sorted(filled.iterdir()))
    for process in [run(filled, program) for _ in range(3)]:
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
def test_a_full_disk_is_named_once_and_stops_nothing(tmp_path: Path, program: Path) -> None:
    # What is written goes to a device that is always full.
    full = "Path.write_bytes = lambda path, content: open('/dev/full', 'wb').write(content)"
    program.write_text(PROGRAM.replace("folder = Path(sys.argv[1])", f"folder = Path(sys.argv[1])\n{full}"))
    values, n_compiled, said = outcome(run(tmp_path / "code", program))
    assert (values, n_compiled) == (RESULT, 4)
    assert said.count("No space left on device") == 1


def test_compiling_says_where_code_is_kept_and_how_long_it_took(tmp_path: Path, program: Path) -> None:
    folder = tmp_path / "code"
    said = outcome(run(folder, program))[2].splitlines()
    assert said[0].startswith("wtg_gym compiles its simulator to machine code: about half a minute, kept in")
    assert said[0].endswith(str(folder))
    assert any(line.startswith("wtg_gym compiled one_more in ") for line in said)
    assert outcome(run(folder, program))[2] == ""
