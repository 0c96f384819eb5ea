"""Hostile submissions: the attack, the check that stops it, and the code that makes it.

`python -m tests.submissions.hostile --page docs/submissions.md` puts all of them through the gate, scores those that
the gate accepts, and writes the verdicts into the page.
"""

from __future__ import annotations

import argparse
import functools
import os
import pickle
import socket
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from onnx import AttributeProto, ModelProto

from tests.submissions import models
from tests.submissions.models import TOML, M, N, after, constant, folder, info, node
from tests.submissions.models import model as make
from wtg_gym.evaluation import Entry, OnnxPolicy, evaluate
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.policies.conflicts import conflicts
from wtg_gym.policies.gate import check_submission

#: Verdicts on a folder that the checks of :data:`wtg_gym.policies.gate.CHECKS` do not refuse.
TOGETHER, SCORED, HARMLESS = "together", "its own score", "harmless"
#: Every verdict, in the order of the page, with its meaning. The gate's check "repeated" stops none.
MEANINGS = {
    "folder": "its files are not those of a submission",
    "entry.toml": "this file is refused",
    "loading": "onnxruntime refuses the file, or finds inputs and outputs that are not a policy's",
    "speed": "the policy cannot answer a batch, or not in time",
    "rollout": "an episode gets an invalid action",
    TOGETHER: "it copies another folder, or contradicts it",
    SCORED: "the gate accepts the policy; it fails in the middle of a test scenario, and has no score",
    HARMLESS: "it is accepted and scored; every scenario costs the same to the last bit, alone and beside others",
}
PAGE, SECTION = "docs/submissions.md", "submissions:hostile"
_SEEDS, _SHORT_S = (20_000, 20_001), 5.0


class Attack(NamedTuple):
    """A hostile submission; the last of several folders is the hostile one."""

    name: str  # what it tries
    end: str  # the verdict that it must get, a key of MEANINGS
    build: Callable[[Path], list[Path]]  # makes its folders in an existing one


@functools.cache
def beginning() -> Any:
    """Return what a policy observes at the beginning of the first test scenario, (n_observation,)."""
    return models.first_observation("standard", _SEEDS[0], _SHORT_S)


# --- the folder ------------------------------------------------------------------------------------------------------


class Evil:
    """Would write a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.path}",)


def _with(name: str, content: bytes) -> Callable[[Path], list[Path]]:
    """A sound submission with one more file, or another one in its place."""

    def build(place: Path) -> list[Path]:
        path = folder(place / "a")
        (path / name).write_bytes(content)
        return [path]

    return build


def _pickled(place: Path) -> list[Path]:
    return [folder(place / "a", pickle.dumps(Evil(place / "trace"), protocol=0))]


def _in_place_of(name: str, make_it: Callable[[Path], object]) -> Callable[[Path], list[Path]]:
    """A sound submission, one of whose files is something else: a folder, a socket, a pipe or a link."""

    def build(place: Path) -> list[Path]:
        path = folder(place / "a")
        (path / name).unlink(missing_ok=True)
        make_it(path / name)
        return [path]

    return build


def _socket(path: Path) -> None:
    # A path of a socket has at most 108 bytes, so it is made from within its folder.
    before = os.getcwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(path.name)
    finally:
        os.chdir(before)


def _linked_folder(place: Path) -> list[Path]:
    folder(place / "real")
    (place / "link").symlink_to(place / "real")
    return [place / "link"]


# --- several together ------------------------------------------------------------------------------------------------


def seed(number: int, toml: str = TOML) -> str:
    """Return an entry.toml of another training seed."""
    return toml.replace("training_seed = 0", f"training_seed = {number}")


def _pair(first: ModelProto, second: bytes | ModelProto, toml: str) -> Callable[[Path], list[Path]]:
    """A sound submission, and a second folder."""
    return lambda place: [folder(place / "first", first), folder(place / "second", second, toml)]


def _of(build: Callable[[], bytes | ModelProto]) -> Callable[[Path], list[Path]]:
    """A submission of a file."""
    return lambda place: [folder(place / "a", build())]


def _knows(build: Callable[[Any, float], ModelProto]) -> Callable[[Path], list[Path]]:
    """A submission that does something in the first test scenario, which it knows by its beginning, and only there."""
    return _of(lambda: build(beginning(), 1e-3))


def _toml(old: str, new: str) -> Callable[[Path], list[Path]]:
    """A submission whose entry.toml has something else in one place."""
    return lambda place: [folder(place / "a", toml=TOML.replace(old, new))]


def _over_lanes(operator: str, **attributes: Any) -> Callable[[Path], list[Path]]:
    """A submission that adds something over all scenarios of its batch to its actions."""
    nodes = node(operator, ["linear"], "over", **attributes), node("Add", ["over", "linear"], "action")
    return _of(lambda: after(*nodes))


def _mislabelled(name: str, kind: int, **values: Any) -> Callable[[Path], list[Path]]:
    return _of(lambda: models.mislabelled(name, kind, **values))


_INT_MIN = -(2**31)
_NO_MEMORY = "*/_ORT_MEM_ADDR_/*"
_HIDDEN = models.two_layers(range(8))
ATTACKS = (
    # The folder.
    Attack("code in a pickle that is named policy.onnx", "loading", _pickled),
    Attack("a module that Python would import", "folder", _with("numpy.py", b"import os")),
    Attack("a hidden file", "folder", _with(".gitattributes", b"* filter=evil")),
    Attack("a second policy file, in other capitals", "folder", _with("Policy.onnx", b"x")),
    Attack("a README one byte too long", "folder", _with("README.md", bytes(65_537))),
    Attack("a folder named policy.onnx", "folder", _in_place_of("policy.onnx", Path.mkdir)),
    Attack("a socket named policy.onnx", "folder", _in_place_of("policy.onnx", _socket)),
    Attack("a pipe named policy.onnx, to which nothing is written", "folder", _in_place_of("policy.onnx", os.mkfifo)),
    Attack(
        "a link to a process's memory",
        "folder",
        _in_place_of("README.md", lambda p: p.symlink_to("/proc/self/mem")),
    ),
    Attack("a link to a folder", "folder", _linked_folder),
    # Two readers of one file.
    Attack(
        "a Constant whose value_int is declared FLOAT",
        "loading",
        _mislabelled("value_int", AttributeProto.FLOAT, f=1.0),
    ),
    Attack(
        "a Constant whose value_int is declared INTS",
        HARMLESS,
        _mislabelled("value_int", AttributeProto.INTS, ints=[0]),
    ),
    Attack("a Constant whose value_ints is declared INT", "speed", _mislabelled("value_ints", AttributeProto.INT, i=0)),
    Attack(
        "a Constant whose value_ints is declared TENSOR",
        HARMLESS,
        _mislabelled("value_ints", AttributeProto.TENSOR, t=constant("t", [0], np.int64)),
    ),
    Attack("a Constant whose value is declared INTS", HARMLESS, _mislabelled("value", AttributeProto.INTS, ints=[0])),
    Attack(
        "a Constant with value_ints and other values",
        HARMLESS,
        _mislabelled("value_ints", AttributeProto.INTS, ints=[0], i=1, f=2.0),
    ),
    Attack("a mean over the scenarios with keepdims = 2", HARMLESS, _over_lanes("ReduceMean", axes=[0], keepdims=2)),
    Attack("a mean over the scenarios with keepdims = -1", HARMLESS, _over_lanes("ReduceMean", axes=[0], keepdims=-1)),
    Attack(
        "a running sum over the scenarios",
        HARMLESS,
        _of(lambda: after(node("CumSum", ["linear", "first"], "action"), constants=[constant("first", 0, np.int64)])),
    ),
    Attack("products of scenarios, and their number", HARMLESS, _of(models.mixed)),
    Attack(
        "rounding at the end of a vector, times 10⁸, which tells the last scenario from the others",
        HARMLESS,
        _of(models.last_lane),
    ),
    Attack(
        "rounding of a sum of states, times 10⁸, which depends on their address",
        HARMLESS,
        _of(models.sums_of_a_state),
    ),
    Attack(
        "a name that is not UTF-8",
        "loading",
        _of(lambda: models.renamed(models.make_bytes(), b"observation", b"\xffbservation")),
    ),
    # Other files and other memory.
    Attack("weights in /proc/self/environ", "loading", _of(lambda: models.external("/proc/self/environ"))),
    Attack("weights in a file beside Python's", "loading", _of(lambda: models.external("usr/lib/os-release"))),
    Attack(
        "weights in another file, named in a node", "loading", _of(lambda: models.external_in_constant("etc/hostname"))
    ),
    Attack(
        "weights at a memory address",
        "loading",
        _of(lambda: models.external(_NO_MEMORY, offset="4096", length="320")),
    ),
    Attack("sparse weights outside their shape", "loading", _of(models.sparse)),
    # Kind of the file.
    Attack("an empty file", "loading", _of(lambda: b"")),
    Attack("nested graphs, 50,000 deep", "loading", _of(lambda: models.nested(50_000))),
    Attack("a field that claims 2⁶² bytes", "loading", _of(lambda: b"\x3a" + models.varint(2**62) + b"x")),
    Attack("a function that calls itself", "loading", _of(models.recursive)),
    Attack("a graph with a cycle", "loading", _of(models.circle)),
    Attack("a decision tree without a leaf", "loading", _of(models.tree)),
    Attack("an operator that reads files", "loading", _of(lambda: models.own_domain("ReadFile"))),
    Attack("actions of 10⁹ values", "loading", _of(lambda: make(outputs=[info("action", "batch", 10**9)]))),
    Attack("17 states of 60,000 values", "loading", _of(models.many_states)),
    Attack("actions in double precision", "loading", _of(models.in_doubles)),
    Attack(
        "a batch of two and no other",
        "loading",
        _of(lambda: make(inputs=[info("observation", 2, N)], outputs=[info("action", 2, M)])),
    ),
    Attack(
        "actions of another shape than declared",
        "speed",
        _of(
            lambda: make(
                [
                    node("Concat", ["observation", "observation"], "twice", axis=0),
                    node("MatMul", ["twice", "weights"], "action"),
                ]
            )
        ),
    ),
    Attack("10¹⁰ numbers", "speed", _of(lambda: models.much(10**10))),
    Attack("5 million numbers for each scenario", "speed", _of(lambda: models.in_every_session(5_000_000))),
    Attack("an endless loop", "speed", _of(models.endless)),
    Attack("a slow operator", "speed", _of(lambda: models.slow(200_000))),
    # What is done in one scenario only.
    Attack("NaN at the observations with which episodes begin, and nowhere else", "rollout", _of(models.trap)),
    Attack("NaN", SCORED, _knows(models.turns_nan)),
    Attack("an endless loop", SCORED, _knows(models.hangs)),
    Attack("10¹¹ numbers", SCORED, _knows(models.grows)),
    Attack(
        "the least integer divided by −1",
        SCORED,
        _knows(lambda seen, near: models.divides(seen, near, "Div", _INT_MIN, -1)),
    ),
    Attack(
        "the remainder of the least integer and −1",
        SCORED,
        _knows(lambda seen, near: models.divides(seen, near, "Mod", _INT_MIN, -1)),
    ),
    Attack(
        "an integer divided by zero",
        SCORED,
        _knows(lambda seen, near: models.divides(seen, near, "Div", 1, 0)),
    ),
    Attack("actions for two scenarios", SCORED, _knows(models.changes_shape)),
    Attack("an index outside the weights", SCORED, _knows(models.points_outside)),
    # What cannot be repeated.
    Attack(
        "random actions",
        HARMLESS,
        _of(lambda: after(node("RandomUniformLike", ["linear"], "action", low=-1.0, high=1.0))),
    ),
    Attack("random dropout", HARMLESS, _of(models.dropout)),
    Attack("an infinite state that no action uses", HARMLESS, _of(models.hidden_nan)),
    # What is said of it.
    Attack("Cyrillic letters in a name", "entry.toml", _toml("Mine", "\\u0420\\u0420\\u041e (k)")),
    Attack("a line feed in a name", "entry.toml", _toml("Mine", "Mine\\nFirst")),
    Attack(
        "a change of text direction in a description",
        "entry.toml",
        _toml("training_seed", 'description = "a\\u202eb"\ntraining_seed'),
    ),
    Attack(
        "a picture in a description",
        "entry.toml",
        _toml("training_seed", 'description = "![](//x.org/a.png)"\ntraining_seed'),
    ),
    Attack(
        "a link with a password",
        "entry.toml",
        _toml("training_seed", "links = ['https://a:b@example.org']\ntraining_seed"),
    ),
    Attack("a training seed of 5,000 digits", "entry.toml", _toml("= 0", "= 1" + 5000 * "0")),
    Attack("the training seed `true`", "entry.toml", _toml("= 0", "= true")),
    Attack("nested lists, 5,000 deep", "entry.toml", _toml("= 0", "= " + 5000 * "[" + 5000 * "]")),
    # Several together.
    Attack(
        "a network with reordered hidden units, as another training seed",
        TOGETHER,
        _pair(_HIDDEN, models.two_layers(range(7, -1, -1)), seed(1)),
    ),
    Attack(
        "a file with an added comment, under another name",
        TOGETHER,
        _pair(make(), models.make_bytes() + models.field(b"\x32", b"mine"), TOML.replace("Mine", "Yours")),
    ),
    Attack("the same training seed twice", TOGETHER, _pair(make(), models.other(), TOML)),
    Attack(
        "a name that differs in capitals and blanks only",
        TOGETHER,
        _pair(make(), models.other(), TOML.replace("Mine", "M I N E")),
    ),
    Attack(
        "another training seed with another description",
        TOGETHER,
        _pair(make(), models.other(), seed(1, TOML + 'description = "The best"\n')),
    ),
)


def verdict(attack: Attack, place: Path) -> tuple[str, str]:
    """Return what becomes of an attack, and why, its folders called by their names."""
    *sound, hostile = attack.build(place)
    reports = [*(check_submission(path, rollout_only=True) for path in sound), check_submission(hostile)]
    for report in reports:
        if report.refusal is not None:
            return report.refusal.name, report.refusal.reason
    for conflict in conflicts(reports):
        return TOGETHER, conflict.reason.replace(f"{place}{os.sep}", "")
    return _scored(reports[-1].played())


@functools.cache
def _beside() -> tuple[Entry, list[Episode]]:
    """Return a harmless entry, and all episodes where it is played without an attack."""
    entry = Entry(name="Beside", policy=OnnxPolicy(models.make_bytes()), fingerprint="beside")
    return entry, list(evaluate([entry], "standard", "test", seeds=_SEEDS, duration_s=_SHORT_S).episodes)


def _scored(entry: Entry) -> tuple[str, str]:
    """Return how an accepted policy fails when it is scored, or that it is harmless."""
    beside, without = _beside()
    together = evaluate([entry, beside], "standard", "test", seeds=_SEEDS, duration_s=_SHORT_S, keep_going=True)
    assert [e for e in together.episodes if e.entry != entry.name] == without, "others' results stand"
    if together.failed:
        return SCORED, together.failed[0]["reason"]
    for number in _SEEDS:
        alone = evaluate([entry], "standard", "test", seeds=[number], duration_s=_SHORT_S)
        if alone.episodes_of(entry.name) != [e for e in together.episodes_of(entry.name) if e.seed == number]:
            return "not found", f"the scenario of seed {number} costs another amount alone"
    return HARMLESS, "accepted; every scenario costs the same to the last bit alone and beside others"


def table(ends: Sequence[str]) -> str:
    """Return how many attacks have each verdict, and two of them; `ends` are those of :data:`ATTACKS`, in order."""
    rows = []
    for end, meaning in MEANINGS.items():
        names = [attack.name for attack, found in zip(ATTACKS, ends, strict=True) if found == end]
        rows.append((f"**{end}**: {meaning}", str(len(names)), "; ".join(names[-2:])))
    return markdown_table(("verdict", "attacks", "such as"), rows, right=(1,))


def main(argv: Sequence[str] | None = None) -> int:
    """Write the table; return 1 and leave the page alone if a verdict is not the expected one."""
    parser = argparse.ArgumentParser(prog="python -m tests.submissions.hostile", description=__doc__)
    parser.add_argument("--page", default=PAGE, help=f"file with the markers (default: {PAGE})")
    given = parser.parse_args(argv)
    ends = []
    for attack in ATTACKS:
        with tempfile.TemporaryDirectory() as place:
            end, reason = verdict(attack, Path(place))
        ends.append(end)
        if end != attack.end:
            print(f"{attack.name}: {end}, expected {attack.end}: {reason}", file=sys.stderr)
    if ends != [attack.end for attack in ATTACKS]:
        return 1
    update_between_markers(given.page, table(ends), SECTION)
    return 0


if __name__ == "__main__":
    sys.exit(main())
