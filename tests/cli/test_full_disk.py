"""A disk that is full when results are written: nothing of the old ones is lost, and one line says what happened."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.cli.calls import ROOT

resource = pytest.importorskip("resource")

_NAMES = ("standard-validation.csv", "standard-validation.json")
_COMMAND = ("evaluate", "--suite", "standard", "--scenarios", "2", "--duration", "5", "--no-resume", "--entries")
#: Mounts a disk of $1 bytes at $2 that nobody else sees, and copies the old results from $3 to it and back in the end.
_ON_A_DISK = """\
disk=$2 kept=$3; mount -t tmpfs -o size=$1 tmpfs "$disk" && cp "$kept"/* "$disk" || exit 99
shift 3; "$@"; code=$?; rm "$kept"/*; cp -a "$disk"/. "$kept"; exit $code"""
_PAGE = os.sysconf("SC_PAGE_SIZE")


def _evaluate(
    folder: Path, *entries: str, before: Sequence[str] = (), limit: Callable[[], None] | None = None
) -> subprocess.CompletedProcess[str]:
    command = [*before, sys.executable, "-m", "wtg_gym.cli", *_COMMAND, *entries, "--results", str(folder)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}
    return subprocess.run(
        command, env=environment, encoding="utf-8", capture_output=True, timeout=300, check=False, preexec_fn=limit
    )


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def old_and_new(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, int]]:
    """A folder with results, and the sizes of those that are to replace them [B]."""
    old, new = tmp_path_factory.mktemp("old"), tmp_path_factory.mktemp("new")
    for folder, entries in ((old, ("mppt",)), (new, ("mppt", "deloaded-5", "coordinated-linear"))):
        assert _evaluate(folder, *entries).returncode == 0
    sizes = {name: (new / name).stat().st_size for name in _NAMES}
    assert sizes[_NAMES[0]] + 2 * _PAGE < sizes[_NAMES[1]]
    return old, sizes


@pytest.mark.parametrize("how", ["disk", "largest file"])
def test_old_results_stay_where_the_new_ones_do_not_fit(
    how: str, old_and_new: tuple[Path, dict[str, int]], tmp_path: Path
) -> None:
    old, sizes = old_and_new
    kept = tmp_path / "kept"
    kept.mkdir()
    for name, content in _contents(old).items():
        (kept / name).write_bytes(content)
    folder, entries = kept, ("mppt", "deloaded-5", "coordinated-linear")
    if how == "disk":
        folder = tmp_path / "disk"
        folder.mkdir()
        if subprocess.run(["unshare", "-rm", "mount", "-t", "tmpfs", "tmpfs", folder], check=False).returncode:
            pytest.skip("this user cannot mount a disk")
        # There is room for the new table beside the old files, but even without the old table not for the description.
        pages = {name: -(-size // _PAGE) for name, size in sizes.items()}
        used = sum(-(-len(content) // _PAGE) for content in _contents(old).values())
        room = used + sum(pages.values()) - -(-(old / _NAMES[0]).stat().st_size // _PAGE) - 1
        before = ("unshare", "-rm", "sh", "-c", _ON_A_DISK, "sh", str(room * _PAGE), str(folder), str(kept))
        done, cause = _evaluate(folder, *entries, before=before), "No space left on device"
    else:
        largest = sizes[_NAMES[1]] - 1
        done = _evaluate(folder, *entries, limit=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest)))
        cause = "File too large"
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.splitlines()[-1] == f"wtg-gym: error: {folder / _NAMES[1]}: {cause}"
    assert "Traceback" not in done.stderr
    # No temporary file is left either.
    assert _contents(kept) == _contents(old)
