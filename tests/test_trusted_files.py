"""Facts about files whose content is run: another user can neither have put nor changed what is read."""

import os
import pickle
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from agents.run import loading
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.files import is_trusted, read_trusted, trusted_folder, write_trusted
from wtg_gym.policies import Entry

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs files that belong to users")


@pytest.fixture
def path(tmp_path, monkeypatch):
    """A file of the user alone, two folders below a folder that everybody may write to, as /tmp is."""
    monkeypatch.setattr(os, "getgid", lambda: os.getuid() + 1)
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    path = shared / "user" / "code" / "file"
    write_trusted(path, b"code")
    return path


def _is_a_link(path: Path) -> None:
    path.rename(path.with_name("other"))
    path.symlink_to("other")


def _is_a_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


SPOILED: dict[str, Callable[[Path], object]] = {
    "a file that everybody writes": lambda path: path.chmod(0o602),
    "a file that a group writes": lambda path: path.chmod(0o620),
    "a link": _is_a_link,
    "a pipe that nobody writes into": _is_a_pipe,
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
    for name in (path, link / path.name):
        assert read_trusted(name, largest=1000) == b"code"
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
    for spoil in (_is_a_pipe, _is_a_link, lambda path: path.chmod(0o666)):
        spoil(path)
        write_trusted(path, b"new")
        assert read_trusted(path) == b"new" and not path.is_symlink() and path.stat().st_mode & 0o777 == 0o600
    path.parent.chmod(0o777)
    with pytest.raises(PermissionError, match="another user could change it"):
        write_trusted(path, b"never")
    assert path.read_bytes() == b"new" and {each.name for each in path.parent.iterdir()} == {"file", "other"}


def test_a_folder_is_looked_at_without_being_made(tmp_path):
    with pytest.raises(FileNotFoundError):
        trusted_folder(tmp_path / "none" / "code")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("group", "is_private"), [(12345, True), (12346, False)])
def test_a_group_with_the_number_of_its_user_has_this_user_alone(group, is_private, monkeypatch):
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
