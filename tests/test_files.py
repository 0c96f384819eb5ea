"""Facts about files: read or refused in one sentence that names them, and written whole."""

import os
import re
from pathlib import Path

import pytest

from wtg_gym import files

REFUSED_JSON = (
    ("", "is not JSON, or was cut short"),
    ('{"a": [1, 2', "is not JSON, or was cut short"),
    ("[" * 100_000, "is not JSON, or was cut short"),
    ("[" * 30 + "]" * 30, "is nested deeper than 20 levels"),
    ('{"a":' * 500 + "1" + "}" * 500, "is nested deeper than 20 levels"),
    ("[NaN]", "NaN is not a finite number"),
    ("[-Infinity]", "Infinity is not a finite number"),
    ("[1e400]", "not a finite number"),
    (f"[{'9' * 400}]", "whole number outside the allowed range"),
    (f"[{'9' * 5000}]", "is not JSON, or was cut short"),
    ('{"a": {"b": 1, "c": 2, "b": 1}}', "it gives the key 'b' more than once"),
    ('["\\ud800"]', "holds a text with half a character"),
    ('{"\\udfff": 1}', "holds a text with half a character"),
    ("\ufeff[]", "is not JSON"),
)
REFUSED_TOML = (
    ("name = ", "is not TOML"),
    ("a = " + "[" * 5000, "is not TOML"),
    ("a." * 1000 + "a = 1", "is nested deeper than 20 levels"),
    ("a = " + "9" * 400, "whole number outside the allowed range"),
    ("a = " + "9" * 5000, "is not TOML"),
    ("a = 2020-01-01", "holds a date; allowed: texts, numbers, lists and objects"),
)
CASES = [(f"data.{kind}", *case) for kind, cases in (("json", REFUSED_JSON), ("toml", REFUSED_TOML)) for case in cases]


@pytest.mark.parametrize(("name", "text", "said"), CASES, ids=lambda value: value[:20])
def test_what_nothing_can_work_with_is_refused_with_the_name_of_the_file(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    read, what = (files.read_json, "suite") if name.endswith("json") else (files.read_toml, "law file")
    with pytest.raises(ValueError, match=rf"the {what} .*{name} .*{said}"):
        read(tmp_path / name, what)


def test_lists_and_objects_are_counted_before_any_is_made(tmp_path):
    (tmp_path / "data.json").write_text("[" + "{}," * (2**17 - 1) + "0]")
    assert len(files.read_json(tmp_path / "data.json", "grid")) == 2**17
    (tmp_path / "data.json").write_text("[" + "{}," * 2**17 + "0]")
    with pytest.raises(ValueError, match=r"the grid .*data\.json has more than 131072 lists and objects"):
        files.read_json(tmp_path / "data.json", "grid")


def test_numbers_and_sizes_up_to_the_limits_are_read_as_they_are(tmp_path):
    path = tmp_path / "data"
    path.write_text("[1e308, -1e308, 5e-324, 18446744073709551615, -0.0, 0]")
    assert files.read_json(path, "suite") == [1e308, -1e308, 5e-324, 2**64 - 1, 0, 0]
    start = "a = 1 # "
    path.write_text(start + "x" * (files.LARGEST_BYTES["law file"] - len(start)))
    assert files.read_toml(path, "law file") == {"a": 1}


@pytest.fixture
def odd(tmp_path):
    """A folder with what is no file, or too large a one."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        (tmp_path / "device").symlink_to("/dev/zero")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(2**40)
    return tmp_path


@pytest.mark.parametrize("what", files.LARGEST_BYTES)
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("", ""),
        ("no/such/file", "No such file"),
        ("with\0null", "null"),
        ("folder", ""),
        ("loop", "symbolic links"),
        ("pipe", "it is no plain file"),
        ("device", "it is no plain file"),
        ("large", "it has 1099511627776 bytes; allowed: at most"),
    ],
)
def test_what_is_no_file_or_too_large_is_named_at_once(odd, what, name, reason):
    with pytest.raises(ValueError, match=rf"^cannot read the {what} .*{re.escape(ascii(name)[1:-1])}.*: .*{reason}"):
        files.read_bytes(odd / name, what)


UNEXPECTED = [
    (KeyError("wind"), "it misses 'wind'"),
    (ValueError("k_min = 9\np.u."), "k_min = 9 p.u."),
    (TypeError("no number"), r"it holds what cannot be used \(TypeError: no number\)"),
    (RecursionError("deep"), r"it holds what cannot be used \(RecursionError: deep\)"),
    (OSError(2, "No such file", "other.json"), "other.json: No such file"),
]


@pytest.mark.parametrize(("error", "said"), UNEXPECTED)
def test_an_error_of_the_content_names_the_file_in_one_line(error, said):
    with pytest.raises(ValueError, match=rf"grid a\\nb\.json: {said}$"), files.interpreting(Path("a\nb.json"), "grid"):
        raise error


def test_an_error_that_no_content_causes_stays_as_it_is():
    with pytest.raises(AssertionError), files.interpreting(Path("a.json"), "grid"):
        raise AssertionError


START, END = "<!-- table:start -->", "<!-- table:end -->"


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_only_what_is_between_the_markers_changes_through_links_too(tmp_path, newline):
    path, link = tmp_path / "README.md", tmp_path / "link.md"
    path.write_bytes(newline.join(["# Title ä", START, "old", "older", END, "end  "]).encode())
    path.chmod(0o640)
    link.symlink_to(path)
    assert files.update_between_markers(link, "| a |\n| b |", "table")
    assert path.read_bytes() == newline.join(["# Title ä", START, "| a |", "| b |", END, "end  "]).encode()
    assert not files.update_between_markers(path, "| a |\n| b |", "table")
    assert link.is_symlink() and path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("text", ["", START, f"{END}\n{START}", f"{START}\n{START}\n{END}"])
def test_missing_markers_are_named(tmp_path, text):
    path = tmp_path / "README.md"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"README.md must have the markers <!-- table:start --> and"):
        files.update_between_markers(path, "table", "table")
    assert path.read_text() == text


def test_temporary_names_do_not_follow_from_file_and_process(tmp_path, monkeypatch):
    names: list[Path] = []
    real = os.replace
    monkeypatch.setattr(os, "replace", lambda one, other: [names.append(one), real(one, other)])
    for _ in range(2):
        files.write_together({tmp_path / "first": "new", tmp_path / "second": "new"})
    assert len(set(names)) == 4 and len({path.name.rpartition(".tmp")[0][-16:] for path in names}) == 4


@pytest.mark.parametrize("blocked", ["first", "second"])
def test_files_that_belong_together_are_replaced_all_or_none(tmp_path, blocked):
    first, second = tmp_path / "first", tmp_path / "second"
    files.write_together({first: "old", second: b"old too"})
    (tmp_path / blocked).unlink()
    (tmp_path / blocked).mkdir()
    left = {path: path.is_dir() or path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(IsADirectoryError, match="directory") as caught:
        files.write_together({first: "new", second: "new"})
    assert caught.value.filename == str(tmp_path / blocked)
    assert {path: path.is_dir() or path.read_bytes() for path in tmp_path.iterdir()} == left
