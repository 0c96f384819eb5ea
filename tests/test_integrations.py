"""The page of other libraries names every program and the versions that it was run with."""

from __future__ import annotations

from tests.integrations import PAGE, PROGRAMS, TRIED, _rows, name_of, packages


def test_table_has_a_row_for_every_program_with_the_versions_that_it_names() -> None:
    rows = _rows(PAGE)
    assert list(rows) == [*PROGRAMS, *TRIED]
    for name, program in PROGRAMS.items():
        versions, verdict = rows[name]
        assert verdict == "runs"
        for package in packages(program):
            if "==" in package:
                assert f"{name_of(package)} {package.partition('==')[2]}" in versions.split(", ")
