"""Facts about files: read or refused in one sentence that names them, whoever has changed them, and written whole.

What is run or unpickled can neither have been put nor changed by another user.
"""

import dataclasses
import json
import os
import pickle
import re
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agents.run import RUN_FILE, Run, RunSettings, loading
from agents.train import CONFIG_FOLDER, read_config
from tests.changes import changed, read_or_refused, write
from wtg_gym import Entry, files
from wtg_gym.cli import main
from wtg_gym.cli.simulation import read_scenario
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.files import find_markers, is_trusted, parse_toml, read_trusted, to_json, write_trusted
from wtg_gym.physics.grid import FOLDER, get_grid
from wtg_gym.physics.parameters import ROTOR_TABLE
from wtg_gym.physics.rotor_table import read_rotor_table
from wtg_gym.physics.tracking_law import read_law
from wtg_gym.policies.entry_folder import ENTRY_FILE, POLICY_FILE, load_entry_folder, policy_folders
from wtg_gym.scenarios import get_suite, read_wind_csv

REFUSED_JSON = {
    "is not JSON, or was cut short": ("", '{"a": [1, 2', "[" * 100_000, f"[{'9' * 5000}]"),
    "is nested deeper than 20 levels": ("[" * 30 + "]" * 30, '{"a":' * 500 + "1" + "}" * 500),
    "(NaN|Infinity) is not a finite number": ("[NaN]", "[-Infinity]"),
    "not a finite number": ("[1e400]",),
    "whole number outside the allowed range": (f"[{'9' * 400}]",),
    "it gives the key 'b' more than once": ('{"a": {"b": 1, "c": 2, "b": 1}}',),
    "holds a text with half a character": ('["\\ud800"]', '{"\\udfff": 1}'),
    "is not JSON": ("\ufeff[]",),
}
REFUSED_TOML = {
    "is not TOML": ("name = ", "a = " + "[" * 5000, "a = " + "9" * 5000),
    "is nested deeper than 20 levels": ("a." * 1000 + "a = 1",),
    "whole number outside the allowed range": ("a = " + "9" * 400,),
    "holds a date; allowed: texts, numbers, lists and objects": ("a = 2020-01-01",),
}
CASES = [
    *(("data.json", text, said) for said, texts in REFUSED_JSON.items() for text in texts),
    *(("data.toml", text, said) for said, texts in REFUSED_TOML.items() for text in texts),
]
UNEXPECTED = [
    (KeyError("wind"), "it misses 'wind'"),
    (ValueError("k_min = 9\np.u."), "k_min = 9 p.u."),
    (TypeError("no number"), r"it holds what cannot be used \(TypeError: no number\)"),
    (RecursionError("deep"), r"it holds what cannot be used \(RecursionError: deep\)"),
    (OSError(2, "No such file", "other.json"), "other.json: No such file"),
]
START, END = "<!-- table:start -->", "<!-- table:end -->"
NO_FILES = [
    *(("", ""), ("folder", ""), ("no/such/file", "No such file"), ("with\0null", "null"), ("loop", "symbolic links")),
    *(("pipe", "it is no plain file"), ("device", "it is no plain file")),
    ("large", "it has 1099511627776 bytes; allowed: at most"),
]


@pytest.mark.parametrize(("name", "text", "said"), CASES, ids=lambda value: value[:20])
def test_what_nothing_can_work_with_is_refused_with_the_name_of_the_file(tmp_path, name, text, said):
    read, what = (files.read_json, "suite") if name.endswith("json") else (files.read_toml, "law file")
    with pytest.raises(ValueError, match=rf"the {what} .*{name} .*{said}"):
        read(write(tmp_path / name, text), what)


def test_numbers_counts_and_sizes_up_to_the_limits_are_read_as_they_are(tmp_path):
    path = write(tmp_path / "data", "[" + "{}," * (2**17 - 1) + "0]")
    assert len(files.read_json(path, "grid")) == 2**17
    path.write_text("[" + "{}," * 2**17 + "0]")
    with pytest.raises(ValueError, match=r"the grid .*data has more than 131072 lists and objects"):
        files.read_json(path, "grid")
    path.write_text("[1e308, -1e308, 5e-324, 18446744073709551615, -0.0, 0]")
    assert files.read_json(path, "suite") == [1e308, -1e308, 5e-324, 2**64 - 1, 0, 0]
    start = "a = 1 # "
    path.write_text(start + "x" * (files.LARGEST_BYTES["law file"] - len(start)))
    assert files.read_toml(path, "law file") == {"a": 1}


@pytest.mark.parametrize("what", files.LARGEST_BYTES)
@pytest.mark.parametrize(("name", "reason"), NO_FILES)
def test_what_is_no_file_or_too_large_is_named_at_once(tmp_path, what, name, reason):
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        (tmp_path / "device").symlink_to("/dev/zero")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(ValueError, match=rf"^cannot read the {what} .*{re.escape(ascii(name)[1:-1])}.*: .*{reason}"):
        files.read_bytes(tmp_path / name, what)


@pytest.mark.parametrize(("error", "said"), UNEXPECTED)
def test_an_error_of_the_content_names_the_file_in_one_line_and_another_stays_as_it_is(error, said):
    with pytest.raises(ValueError, match=rf"grid a\\nb\.json: {said}$"), files.interpreting(Path("a\nb.json"), "grid"):
        raise error
    with pytest.raises(AssertionError), files.interpreting(Path("a.json"), "grid"):
        raise AssertionError


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
    path = write(tmp_path / "README.md", text)
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


@pytest.fixture
def path(tmp_path, monkeypatch):
    """A file of the user alone, two folders below a folder that everybody may write to, as /tmp is."""
    if not hasattr(os, "getuid"):
        pytest.skip("needs files that belong to users")
    monkeypatch.setattr(os, "getgid", lambda: os.getuid() + 1)
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    path = shared / "user" / "code" / "file"
    write_trusted(path, b"code")
    return path


SPOILED: dict[str, Callable[[Path], object]] = {
    "a file that everybody writes": lambda path: path.chmod(0o602),
    "a file that a group writes": lambda path: path.chmod(0o620),
    "a link": lambda path: [path.rename(path.with_name("other")), path.symlink_to("other")],
    "a pipe": lambda path: [path.unlink(), os.mkfifo(path)],
    "a file larger than the most that is read": lambda path: path.write_bytes(bytes(1001)),
    "a folder that everybody writes": lambda path: path.parent.chmod(0o703),
    "a folder that a group writes": lambda path: path.parent.chmod(0o770),
    "a folder for temporary files": lambda path: path.parent.chmod(0o1777),
    "a folder within one that a group writes": lambda path: path.parent.parent.chmod(0o720),
    "a folder within a link's that a group writes": lambda path: path.parents[2].chmod(0o770),
}


@pytest.mark.parametrize("spoil", SPOILED.values(), ids=list(SPOILED))
def test_what_another_user_could_have_written_is_not_read(path, spoil):
    link = path.parents[2].parent / "link"
    link.symlink_to(path.parent)
    assert [read_trusted(name, largest=1000) for name in (path, link / path.name)] == [b"code"] * 2
    spoil(path)
    for name in (path, link / path.name):
        with pytest.raises(OSError, match=r"another user could change|no plain file|allowed: at most|symbolic link"):
            read_trusted(name, largest=1000)


@pytest.mark.parametrize("level", range(4))
def test_what_belongs_to_another_user_is_not_read(path, level, monkeypatch):
    foreign = (path, *path.parents)[level]
    if os.getuid() == 0:
        os.chown(foreign, 12345, 12345)
    else:
        user = os.getuid()
        monkeypatch.setattr(os, "getuid", lambda: user + 1)
    with pytest.raises(PermissionError):
        read_trusted(path)


def test_what_is_written_is_the_users_alone_and_replaces_whatever_is_there(path):
    assert path.stat().st_mode & 0o777 == 0o600
    assert [folder.stat().st_mode & 0o777 for folder in path.parents[:2]] == [0o700, 0o700]
    for spoil in (SPOILED["a pipe"], SPOILED["a link"], lambda path: path.chmod(0o666)):
        spoil(path)
        write_trusted(path, b"new")
        assert read_trusted(path) == b"new" and not path.is_symlink() and path.stat().st_mode & 0o777 == 0o600
    # A folder is looked at without being made.
    with pytest.raises(FileNotFoundError):
        files.trusted_folder(path.parent / "none" / "code")
    path.parent.chmod(0o777)
    with pytest.raises(PermissionError, match="another user could change it"):
        write_trusted(path, b"never")
    assert path.read_bytes() == b"new" and {each.name for each in path.parent.iterdir()} == {"file", "other"}


@pytest.mark.parametrize(("group", "is_private"), [(12345, True), (12346, False)])
def test_a_group_with_the_number_of_its_user_has_this_user_alone(path, group, is_private, monkeypatch):
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    monkeypatch.setattr(os, "getgid", lambda: 12345)
    for mode, passes in ((0o770, is_private), (0o777, False), (0o700, True)):
        assert is_trusted(os.stat_result((stat.S_IFDIR | mode, 0, 0, 1, 12345, group, 0, 0, 0, 0))) == passes


@pytest.mark.parametrize("case", ["a file that a group writes", "a link", "a folder within one that a group writes"])
def test_a_checkpoint_that_another_user_could_have_written_is_not_loaded(path, case):
    write_trusted(path, pickle.dumps("state"))
    with loading(path.parent) as folder:
        assert pickle.loads((folder / path.name).read_bytes()) == "state"
    SPOILED[case](path)
    with pytest.raises(ValueError, match="another user could"), loading(path.parent):
        pytest.fail("nothing is loaded")


def test_finished_batches_of_another_user_are_played_again(path, caplog):
    # Beside a sticky folder of all users, as in /tmp, batches are the user's alone.
    entry, folder = Entry(name="mppt", strategy="mppt"), path.parents[2] / "results" / "batches"
    store = PartialStore(folder, "context")
    store.save(entry, [], [])
    (batch,) = folder.iterdir()
    assert folder.stat().st_mode & 0o777 == 0o700
    assert PartialStore(folder, "context").load(entry, []) == []
    batch.chmod(0o606)
    assert PartialStore(folder, "context").load(entry, []) is None and "is not used" in caplog.text
    batch.chmod(0o600)
    folder.chmod(0o777)
    store = PartialStore(folder, "context")
    assert store.load(entry, []) is None and "another user could change it" in caplog.text
    store.save(entry, [1], [])
    assert list(folder.iterdir()) == [batch]


LAW = {"name": "mine", "k_min": 1.0, "k_nominal": 0.66, "deloading_max": 20.0, "tau_s": 0.2}
STANDARD_V1 = get_suite("standard-v1")
GRIDS = {name: json.loads((FOLDER / f"{name}.json").read_text()) for name in ("ieee14", "nordic45")}
SUITE = json.loads((FOLDER / "suites" / "ieee39.json").read_text())
SCENARIO = STANDARD_V1.scenario(10_001, duration_s=2.0).to_dict()
CONFIG = yaml.safe_load((CONFIG_FOLDER / "ppo.yml").read_text())
WIND = [["time_s", "a", "b"], *([0.5 * i, 8.0, 9.5] for i in range(9))]
COMMANDS = {
    "ieee14": ["grid", "check", "grid.json"],
    "suite": ["suites", "suite.json", "--seed", "10000"],
    "scenario": ["simulate", "--suite", "standard-v1", "--duration", "1", "--scenario", "scenario.json"],
    "law": ["simulate", "--duration", "1", "--strategy", "law.toml"],
}


def toml_text(data) -> str:
    # Texts and lists are written alike in both.
    return "".join(f"{json.dumps(key)} = {json.dumps(value)}\n" for key, value in data.items())


def lines_text(rows) -> str:
    return "\n".join(",".join(map(str, row if isinstance(row, list) else [row])) for row in rows)


def entry_of_folder(path: Path) -> None:
    (path.parent / POLICY_FILE).write_bytes(b"never looked at")
    load_entry_folder(path.parent)


def a_run():
    settings = RunSettings(algo="ppo", hyperparameters={"gamma": 0.99}, timesteps=100, n_envs=2)
    run = Run.new(Path(), settings)
    run.curve.append({"timesteps": 50, "wall_time_s": 1.0, "score": 3.0, "marked": 1.0})
    run.resumptions.append(run.provenance)
    data = {name: value for name, value in dataclasses.asdict(run).items() if name not in ("folder", "_began")}
    return json.loads(to_json(data))


#: By kind: a file's name, its data, what makes a text of data, and what reads the file.
KINDS = {
    **{name: ("grid.json", own, json.dumps, lambda path: get_grid(str(path))) for name, own in GRIDS.items()},
    "suite": ("suite.json", SUITE, json.dumps, lambda path: get_suite(str(path))),
    "scenario": ("scenario.json", SCENARIO, json.dumps, lambda path: read_scenario(path, STANDARD_V1)),
    "law": ("law.toml", LAW, toml_text, read_law),
    "entry": (ENTRY_FILE, parse_toml((policy_folders()[0] / ENTRY_FILE).read_text(), "it"), toml_text, entry_of_folder),
    "run": (RUN_FILE, a_run(), json.dumps, lambda path: Run.read(path.parent)),
    "config": ("ppo.yml", CONFIG, yaml.dump, lambda path: read_config(path, "GFMWTG-14bus-v1")),
    "wind": ("wind.csv", WIND, lines_text, lambda path: read_wind_csv(path, duration_s=3.0)),
    "rotor": ("rotor.txt", ROTOR_TABLE.read_text().splitlines(), lines_text, read_rotor_table),
    "markers": ("README.md", ["# Title", START, "old", END], lines_text, lambda path: find_markers(path, "table")),
}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_changed_file_is_read_or_refused_in_a_line_with_its_name(tmp_path, kind, data):
    name, original, text_of, read = KINDS[kind]
    path = write(tmp_path / name, text_of(original))
    read(path)
    write(path, text_of(data.draw(changed(original))))
    read_or_refused(path, read)


@pytest.mark.parametrize("kind", COMMANDS)
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_command_works_with_a_changed_file_or_ends_in_a_line(tmp_path, kind, data, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, original, text_of, _ = KINDS[kind]
    write(tmp_path / name, text_of(data.draw(changed(original))))
    code, printed = main(COMMANDS[kind]), capsys.readouterr()
    assert code in (0, 1) or (code, printed.out, printed.err.count("\n")) == (2, "", 1)
