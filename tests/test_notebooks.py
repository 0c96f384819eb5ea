"""Facts about the notebooks as they are in the repository; `make notebooks` runs them."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "docs/notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def _cells(path: Path) -> list[dict[str, Any]]:
    return list(json.loads(path.read_text(encoding="utf-8"))["cells"])


def test_index_names_every_notebook() -> None:
    assert NOTEBOOKS
    text = (FOLDER / "index.md").read_text(encoding="utf-8")
    assert [path.name for path in NOTEBOOKS if f"]({path.name})" not in text] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_was_run_from_top_to_bottom_without_an_error(path: Path) -> None:
    code = [cell for cell in _cells(path) if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert outputs and not [output for output in outputs if output["output_type"] == "error"]
    # No warning, and no path of the machine that it ran on.
    assert not [output for output in outputs if output.get("name") == "stderr"]
    assert not [output for output in outputs if "/site-packages/" in json.dumps(output)]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_first_cell_installs_the_package_where_it_is_missing(path: Path) -> None:
    cells = _cells(path)
    assert cells[0]["cell_type"] == "markdown"
    first = "".join(cells[1]["source"])
    (folder,) = re.findall(r'%pip install --quiet "(.*)\[[a-z,]+\]"', first)
    assert (FOLDER / folder / "pyproject.toml").is_file() and "find_spec" in first


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_code_is_python_but_for_magic_lines(path: Path) -> None:
    for cell in _cells(path):
        if cell["cell_type"] == "code":
            lines = "".join(cell["source"]).splitlines()
            plain = ["pass" if line.lstrip().startswith(("%", "!")) else line for line in lines]
            indents = [line[: len(line) - len(line.lstrip())] for line in lines]
            ast.parse("\n".join(f"{i}pass" if p == "pass" else p for i, p in zip(indents, plain, strict=True)))
