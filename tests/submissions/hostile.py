"""Hostile submissions, one a row: what it tries, how it is made, and which check refuses it.

`python -m tests.submissions.hostile --page docs/submissions.md` puts all of them through the gate and writes what it
says into the page.
"""

from __future__ import annotations

import argparse
import io
import os
import pickle
import sys
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from onnx import ModelProto

from tests.submissions import models
from tests.submissions.models import LINEAR, TOML, WEIGHTS, M, N, after, constant, field, folder, node
from tests.submissions.models import model as make
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.submissions.gate import check_submission
from wtg_gym.submissions.together import conflicts

#: What refuses a folder that is accepted on its own.
TOGETHER = "together"
PAGE, SECTION = "docs/submissions.md", "submissions:hostile"


class Attack(NamedTuple):
    """What a submission tries, the check that must refuse it, and what makes its folders in a folder that is there.

    The last of several folders is the hostile one.
    """

    name: str
    check: str
    build: Callable[[Path], list[Path]]


# --- the folder ------------------------------------------------------------------------------------------------------


class Evil:
    """Would write a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.path}",)


def _with(name: str, content: bytes) -> Callable[[Path], list[Path]]:
    """A sound submission with one more file."""

    def build(place: Path) -> list[Path]:
        path = folder(place / "a")
        (path / name).write_bytes(content)
        return [path]

    return build


def _linked(name: str, target: str) -> Callable[[Path], list[Path]]:
    """A submission one of whose files is a link."""

    def build(place: Path) -> list[Path]:
        path = folder(place / "a")
        (path / name).unlink(missing_ok=True)
        (path / name).symlink_to(target)
        return [path]

    return build


def _pipe(place: Path) -> list[Path]:
    path = folder(place / "a")
    (path / "README.md").unlink(missing_ok=True)
    os.mkfifo(path / "README.md")
    return [path]


def _pickled(place: Path) -> list[Path]:
    return [folder(place / "a", pickle.dumps(Evil(place / "trace")))]


def _archive(place: Path) -> bytes:
    """As Stable-Baselines3 saves a model: a zip with a pickle in it."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("data", pickle.dumps(Evil(place / "trace")))
        archive.writestr("../../escaped", "x")
    return buffer.getvalue()


def _archived(place: Path) -> list[Path]:
    return [folder(place / "a", _archive(place))]


def _beside_archive(place: Path) -> list[Path]:
    return _with("model.zip", _archive(place))(place)


def _named(name: str, place: Path) -> list[Path]:
    path = place / name
    path.mkdir()
    return [path]


# --- several together ------------------------------------------------------------------------------------------------


def seed(number: int, toml: str = TOML) -> str:
    """Return an entry.toml of another training seed."""
    return toml.replace("training_seed = 0", f"training_seed = {number}")


def _second(content: ModelProto, toml: str) -> Callable[[Path], list[Path]]:
    """The plain submission, and a second folder."""
    return lambda place: [folder(place / "first"), folder(place / "second", content, toml)]


def _of(content: bytes | ModelProto | Callable[[], bytes | ModelProto]) -> Callable[[Path], list[Path]]:
    """A submission of a file."""
    return lambda place: [folder(place / "a", content() if callable(content) else content)]


def _toml(old: str, new: str) -> Callable[[Path], list[Path]]:
    """A submission whose entry.toml has something else in one place."""
    return lambda place: [folder(place / "a", toml=TOML.replace(old, new))]


_BIG = constant("big", [1_000_000, 1_000_000], np.int64)
ATTACKS = (
    Attack("code in a pickle, as policy.onnx", "file format", _pickled),
    Attack("code in an archive of Stable-Baselines3, as policy.onnx", "file format", _archived),
    Attack("code in an archive of Stable-Baselines3, beside it", "folder", _beside_archive),
    Attack("a script beside it", "folder", _with("run.py", b"import os")),
    Attack("weights beside it", "folder", _with("weights.bin", bytes(320))),
    Attack("a link to a file of the machine", "folder", _linked("policy.onnx", "/etc/passwd")),
    Attack("a link out of the folder", "folder", _linked("README.md", "../../secret")),
    Attack("a device without an end", "folder", _linked("policy.onnx", "/dev/zero")),
    Attack("a pipe that nobody writes to", "folder", _pipe),
    Attack("a command as the folder's name", "folder", lambda place: _named("$(id)", place)),
    Attack("a folder that Windows cannot have", "folder", lambda place: _named("aux", place)),
    Attack("a folder that is taken for a law's file", "folder", lambda place: _named("mine.toml", place)),
    Attack("a file of 5 MB and a byte", "folder", _of(bytes(5_000_001))),
    Attack("a zip bomb", "file format", _of(models.zip_bomb)),
    Attack("a file of noise", "file format", _of(lambda: models.noise(4_000_000))),
    Attack("onnxruntime's own format", "file format", _of(b"\x08\x00\x00\x00ORTM" + models.make_bytes())),
    Attack("graphs in graphs, 10,000 deep", "file format", _of(lambda: models.nested(10_000))),
    Attack("a length of a terabyte", "file format", _of(b"\x3a" + models.varint(2**40) + b"x")),
    Attack(
        "2,400,000 empty nodes",
        "model",
        _of(lambda: b"\x08\x08\x42\x02\x10\x11" + field(b"\x3a", b"\x0a\x00" * 2_400_000)),
    ),
    Attack("weights in another file, ../../../../etc/passwd", "constants", _of(models.external)),
    Attack("weights in another file, /etc/passwd", "constants", _of(lambda: models.external("/etc/passwd"))),
    Attack("weights in another file, within a node", "constants", _of(models.external_in_constant)),
    Attack(
        "more than a million weights",
        "constants",
        _of(lambda: make(constants=[WEIGHTS, constant("many", np.zeros(1_000_001), np.bool_)])),
    ),
    Attack(
        "weights that are not finite",
        "constants",
        _of(lambda: make(constants=[constant("weights", np.full((N, M), np.nan))])),
    ),
    Attack(
        "an endless Loop",
        "operators",
        _of(lambda: make([node("Loop", ["", "", "observation"], "action", body=models.body())])),
    ),
    Attack(
        "a Scan",
        "operators",
        _of(lambda: make([node("Scan", ["observation"], "action", body=models.body(), num_scan_inputs=1)])),
    ),
    Attack(
        "a branch",
        "operators",
        _of(lambda: make([node("If", ["c"], "action", then_branch=models.body(), else_branch=models.body())])),
    ),
    Attack(
        "10¹² numbers by Expand",
        "operators",
        _of(lambda: after(node("Expand", ["linear", "big"], "action"), constants=[_BIG])),
    ),
    Attack(
        "10¹² numbers by Tile",
        "operators",
        _of(lambda: after(node("Tile", ["linear", "big"], "action"), constants=[_BIG])),
    ),
    Attack(
        "10¹² numbers by Range",
        "operators",
        _of(lambda: after(node("Range", ["linear", "linear", "linear"], "action"))),
    ),
    Attack(
        "10¹² numbers by ConstantOfShape",
        "operators",
        _of(lambda: make([node("ConstantOfShape", ["big"], "action")], constants=[_BIG])),
    ),
    Attack("memory: 400,000 values in a lane and step", "operators", _of(models.many_values)),
    Attack("time: 9,600,000 multiplications in a lane and step", "size", _of(models.many_products)),
    Attack("time: slow operators within all limits of size", "speed", _of(models.slow)),
    Attack("random actions", "operators", _of(lambda: after(node("RandomNormalLike", ["linear"], "action")))),
    Attack("random dropout", "operators", _of(lambda: after(node("Dropout", ["linear"], "action")))),
    Attack(
        "looking for the clock: no operator reads it, a library's would",
        "model",
        _of(lambda: make([LINEAR], domains=[("ai.onnx.contrib", 1)])),
    ),
    Attack(
        "looking for files: no operator opens one, a library's would",
        "operators",
        _of(lambda: models.own_domain("ReadFile")),
    ),
    Attack("an operator of the file's own", "model", _of(models.with_function)),
    Attack(
        "learning about the other scenarios: a mean over the lanes",
        "operators",
        _of(lambda: after(node("ReduceMean", ["linear"], "a", axes=[0]), node("Add", ["a", "linear"], "action"))),
    ),
    Attack(
        "learning about the other scenarios: a product of lanes",
        "operators",
        _of(lambda: after(node("Transpose", ["linear"], "t"), node("MatMul", ["linear", "t"], "action"))),
    ),
    Attack("actions that are infinite", "finite", _of(lambda: after(node("Reciprocal", ["linear"], "action")))),
    Attack("a state that grows without end", "finite", _of(models.growing)),
    Attack("actions that are not finite in real episodes only", "rollout", _of(models.trap)),
    Attack("markup as a name", "entry.toml", _toml("Mine", "[Mine](https://example.org)")),
    Attack("emphasis in a name", "entry.toml", _toml("Mine", "The _best_")),
    Attack("a command to the terminal in a name", "entry.toml", _toml("Mine", "a\\u001b[31mb")),
    Attack("a strategy's name", "entry.toml", _toml("Mine", "MPPT")),
    Attack("the name of a controller made by hand", "entry.toml", _toml("Mine", "Tip-speed feedback")),
    Attack("a name that is another's whole row", "entry.toml", _toml("Mine", "PPO (k) (5 seeds)")),
    Attack("an author nobody sees", "entry.toml", _toml("Jane Doe", "\\u3164")),
    Attack("an author with a link", "entry.toml", _toml("Jane Doe", "www.example.org")),
    Attack(
        "a script as a link", "entry.toml", _toml("training_seed", "links = ['javascript:alert(1)']\ntraining_seed")
    ),
    Attack("one policy as two training seeds", TOGETHER, _second(make(), seed(1))),
    Attack("one policy in other bytes as two training seeds", TOGETHER, _second(models.disguised(), seed(1))),
    Attack("one policy under two names", TOGETHER, _second(models.disguised(), TOML.replace("Mine", "Yours"))),
    Attack("joining another's row", TOGETHER, _second(models.other(), seed(1, TOML.replace("Jane Doe", "John Roe")))),
    Attack(
        "joining a row in another mode",
        TOGETHER,
        _second(models.privileged(), seed(1, TOML + 'observation_mode = "privileged"\n')),
    ),
    Attack("a name that looks like another's", TOGETHER, _second(models.other(), TOML.replace("Mine", "mi-ne"))),
)


def verdict(attack: Attack, place: Path) -> tuple[str, str]:
    """Return the check that refuses an attack, and why, its folders called by their names; ("", "") if none does."""
    reports = [check_submission(path) for path in attack.build(place)]
    for report in reports:
        if report.refusal is not None:
            return report.refusal.name, report.refusal.reason
    for conflict in conflicts(reports):
        return TOGETHER, conflict.reason.replace(f"{place}{os.sep}", "")
    return "", ""


def row(attack: Attack, check: str, reason: str) -> str:
    """Return an attack's line of the table."""
    # Lists of what is allowed are long, and in the check's own output.
    short = reason.split("; allowed: ")[0]
    if len(short) > 180:
        short = f"{short[:110].rsplit(' ', 1)[0]} … {short[-60:].split(' ', 1)[1]}"
    # As it is printed, so that what is hostile shows and does nothing.
    return markdown_table((attack.name, check, f"`{short}`"), []).splitlines()[0]


def main(argv: Sequence[str] | None = None) -> int:
    """Write the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.submissions.hostile", description=__doc__)
    parser.add_argument("--page", default=PAGE, help=f"file with the markers (default: {PAGE})")
    given = parser.parse_args(argv)
    lines = markdown_table(("attack", "refused by", "reason"), []).splitlines()
    missed = 0
    for attack in ATTACKS:
        with tempfile.TemporaryDirectory() as place:
            check, reason = verdict(attack, Path(place))
        lines.append(row(attack, check, reason))
        if check != attack.check:
            missed += 1
            print(f"{attack.name}: refused by {check or 'nothing'}, expected {attack.check}: {reason}", file=sys.stderr)
    update_between_markers(given.page, "\n".join(lines), SECTION)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
