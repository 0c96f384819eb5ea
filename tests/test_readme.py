"""The README's examples run as printed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
PROGRAMS = re.findall(r"^```python\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def test_there_are_programs_to_run() -> None:
    assert len(PROGRAMS) >= 3


def test_every_program_runs_as_printed(tmp_path: Path) -> None:
    # In the printed order and in one folder: a later one may load what an earlier one saved.
    for program in PROGRAMS:
        done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, f"{program}\n{done.stderr}"


@pytest.mark.parametrize("path", re.findall(r"\]\(([^)#:]+)\)", README))
def test_every_linked_file_is_there(path: str) -> None:
    assert (Path(__file__).parent.parent / path).exists()
