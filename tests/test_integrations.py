"""The page of other libraries shows the programs that are run, and the versions that they name."""

from __future__ import annotations

import ast

import pytest

from tests.integrations import PAGE, PROGRAMS, TRIED, _rows, block, name_of, packages

TEXT = PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", PROGRAMS)
def test_page_shows_the_program_that_is_run(name: str) -> None:
    shown = TEXT[TEXT.index(f"<!-- {name}:start -->") : TEXT.index(f"<!-- {name}:end -->")]
    assert shown.partition("\n")[2].strip() == block(PROGRAMS[name])
    if PROGRAMS[name].suffix == ".py":
        ast.parse(block(PROGRAMS[name]).removeprefix("```python\n").removesuffix("```"))


def test_table_has_a_row_for_every_program_with_the_versions_that_it_names() -> None:
    rows = _rows(PAGE)
    assert list(rows) == [*PROGRAMS, *TRIED]
    for name, program in PROGRAMS.items():
        versions, verdict = rows[name]
        assert verdict == "runs"
        for package in packages(program):
            if "==" in package:
                assert f"{name_of(package)} {package.partition('==')[2]}" in versions.split(", ")
