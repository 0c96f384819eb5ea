"""JSON and TOML of any content are read, or refused in one sentence that names the file."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from wtg_gym.files import LARGEST_TOML_BYTES, read_json, read_toml
from wtg_gym.physics.tracking_law import read_law

REFUSED_JSON = {
    "empty": ("", "is not JSON, or was cut short"),
    "cut short": ('{"a": [1, 2', "is not JSON, or was cut short"),
    "deep list": ("[" * 100_000, "is not JSON, or was cut short"),
    "deep list that ends": ("[" * 30 + "]" * 30, "is nested deeper than 20 levels"),
    "deep objects": ('{"a":' * 500 + "1" + "}" * 500, "is nested deeper than 20 levels"),
    "NaN": ("[NaN]", "NaN is not a finite number"),
    "Infinity": ("[-Infinity]", "Infinity is not a finite number"),
    "1e400": ("[1e400]", "not a finite number"),
    "400 digits": (f"[{'9' * 400}]", "whole number outside the allowed range"),
    "5000 digits": (f"[{'9' * 5000}]", "is not JSON, or was cut short"),
}


@pytest.mark.parametrize("case", REFUSED_JSON)
def test_json_that_nothing_can_work_with_is_refused_with_the_name_of_the_file(tmp_path: Path, case: str) -> None:
    text, said = REFUSED_JSON[case]
    path = tmp_path / "data.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"the results .*data\.json .*{said}"):
        read_json(path, "results")


def test_numbers_in_the_range_of_floating_point_are_read_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "data.json"
    path.write_text("[1e308, -1e308, 5e-324, 18446744073709551615, -0.0, 0]")
    assert read_json(path, "results") == [1e308, -1e308, 5e-324, 2**64 - 1, 0, 0]


REFUSED_TOML = {
    "empty value": ("name = ", "is not TOML"),
    "deep list": ("a = " + "[" * 5000, "is not TOML"),
    "long dotted key": ("a." * 1000 + "a = 1", "is nested deeper than 20 levels"),
    "400 digits": ("a = " + "9" * 400, "whole number outside the allowed range"),
    "5000 digits": ("a = " + "9" * 5000, "is not TOML"),
    "50,000 dotted keys": ("\n".join(f"a.b{i} = 1" for i in range(50_000)), "is larger than 16384 bytes"),
}


@pytest.mark.parametrize("case", REFUSED_TOML)
def test_toml_that_nothing_can_work_with_is_refused_with_the_name_of_the_file(tmp_path: Path, case: str) -> None:
    text, said = REFUSED_TOML[case]
    path = tmp_path / "law.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"the law file .*law\.toml .*{said}"):
        read_law(path)


def test_toml_of_the_largest_size_is_read(tmp_path: Path) -> None:
    path = tmp_path / "law.toml"
    start = "a = 1 # "
    path.write_text(start + "x" * (LARGEST_TOML_BYTES - len(start)))
    assert read_toml(path, "law file") == {"a": 1}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs files of no end")
def test_a_file_without_end_is_not_read_to_the_end(tmp_path: Path) -> None:
    path = tmp_path / "law.toml"
    path.symlink_to("/dev/zero")
    with pytest.raises(ValueError, match=r"law\.toml is larger than 16384 bytes"):
        read_toml(path, "law file")


@pytest.mark.parametrize("name", ["", "no/such/file.json", "with\0null.json"])
def test_what_is_no_file_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="cannot read the results"):
        read_json(tmp_path / name, "results")


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=plain, position=st.floats(0.0, 1.0), more=st.binary(max_size=3))
def test_mutated_json_is_read_or_refused(tmp_path: Path, data: Any, position: float, more: bytes) -> None:
    path = tmp_path / "data.json"
    content = json.dumps(data).encode()
    at = int(position * len(content))
    path.write_bytes(content[:at] + more + content[at + 1 :])
    try:
        json.dumps(read_json(path, "results"), allow_nan=False)
    except ValueError as error:
        assert "data.json" in str(error)
