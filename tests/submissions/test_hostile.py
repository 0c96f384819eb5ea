"""Every hostile submission gets its verdict; what the gate accepts is scored, alone and beside a harmless entry."""

from __future__ import annotations

import functools
import os
import pickle
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import AttributeProto, ModelProto

from tests.submissions import models
from tests.submissions.models import TOML, M, N, after, constant, folder, info, node, seed
from tests.submissions.models import model as make
from wtg_gym.evaluation import Entry, OnnxPolicy, evaluate
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.policies import gate, policy_process
from wtg_gym.policies.conflicts import conflicts
from wtg_gym.policies.gate import CHECKS, check_submission

#: Verdicts on a folder that the gate's own checks do not refuse: it copies another folder or contradicts it; it fails
#: in the middle of a test scenario and has no score; it is scored, and every scenario costs the same to the last bit.
TOGETHER, SCORED, HARMLESS = "together", "its own score", "harmless"
#: Each of these takes all the time that an answer may take, if it is harmful.
ENDLESS = ("an endless loop", "a slow operator")
_SEEDS, _SHORT_S = (20_000, 20_001), 5.0

#: Makes the folders of an attack in an existing one; the last of several is the hostile one.
Build = Callable[[Path], list[Path]]


@functools.cache
def beginning() -> Any:
    """What a policy observes at the beginning of the first test scenario, (n_observation,)."""
    return models.first_observation("standard", _SEEDS[0], _SHORT_S)


class Evil:
    """Would write a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.path}",)


def _with(name: str, content: bytes) -> Build:
    """A sound submission with one more file."""
    return _in_place_of(name, lambda path: path.write_bytes(content))


def _in_place_of(name: str, make_it: Callable[[Path], object]) -> Build:
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


def _beside(second: bytes | ModelProto, toml: str, first: ModelProto | None = None) -> Build:
    """A sound submission, and a second folder."""
    return lambda place: [folder(place / "first", first), folder(place / "second", second, toml)]


def _of(build: Callable[[], bytes | ModelProto]) -> Build:
    """A submission of a file."""
    return lambda place: [folder(place / "a", build())]


def _knows(build: Callable[[Any, float], ModelProto]) -> Build:
    """A submission that does something in the first test scenario, which it knows by its beginning, and only there."""
    return _of(lambda: build(beginning(), 1e-3))


def _divides(operator: str, number: int, by: int) -> Build:
    return _knows(lambda seen, near: models.divides(seen, near, operator, number, by))


def _toml(old: str, new: str) -> Build:
    """A submission whose entry.toml has something else in one place."""
    return lambda place: [folder(place / "a", toml=TOML.replace(old, new))]


def _over_lanes(operator: str, **attributes: Any) -> Build:
    """A submission that adds something over all scenarios of its batch to its actions."""
    nodes = node(operator, ["linear"], "over", **attributes), node("Add", ["over", "linear"], "action")
    return _of(lambda: after(*nodes))


def _mislabelled(name: str, kind: int, **values: Any) -> Build:
    return _of(lambda: models.mislabelled(name, kind, **values))


def _doubled() -> ModelProto:
    """Actions of another shape than declared."""
    return make(models.nodes_of("twice = Concat<axis = 0>(observation, observation); action = MatMul(twice, weights)"))


def _running_sum() -> ModelProto:
    return after("action = CumSum(linear, first)", first=0)


_INT_MIN = -(2**31)
_OTHER = models.other()
_BATCH_OF_TWO = {"inputs": [info("observation", 2, N)], "outputs": [info("action", 2, M)]}
_ADDRESS = {"location": "*/_ORT_MEM_ADDR_/*", "offset": "4096", "length": "320"}
#: By their verdicts; a check of the gate is its name.
ATTACKS: dict[str, dict[str, Build]] = {
    "folder": {
        "a module that Python would import": _with("numpy.py", b"import os"),
        "a hidden file": _with(".gitattributes", b"* filter=evil"),
        "a second policy file, in other capitals": _with("Policy.onnx", b"x"),
        "a README one byte too long": _with("README.md", bytes(65_537)),
        "a folder named policy.onnx": _in_place_of("policy.onnx", Path.mkdir),
        "a socket named policy.onnx": _in_place_of("policy.onnx", _socket),
        "a pipe named policy.onnx, to which nothing is written": _in_place_of("policy.onnx", os.mkfifo),
        "a link to a process's memory": _in_place_of("README.md", lambda path: path.symlink_to("/proc/self/mem")),
        "a link to a folder": _linked_folder,
    },
    "entry.toml": {
        "Cyrillic letters in a name": _toml("Mine", "\\u0420\\u0420\\u041e (k)"),
        "a line feed in a name": _toml("Mine", "Mine\\nFirst"),
        "a change of text direction": _toml("training_seed", 'description = "a\\u202eb"\ntraining_seed'),
        "a picture in a description": _toml("training_seed", 'description = "![](//x.org/a.png)"\ntraining_seed'),
        "a link with a password": _toml("training_seed", "links = ['https://a:b@example.org']\ntraining_seed"),
        "a training seed of 5,000 digits": _toml("= 0", "= 1" + 5000 * "0"),
        "the training seed `true`": _toml("= 0", "= true"),
        "nested lists, 5,000 deep": _toml("= 0", "= " + 5000 * "[" + 5000 * "]"),
    },
    "loading": {
        "code in a pickle that is named policy.onnx": lambda place: [
            folder(place / "a", pickle.dumps(Evil(place / "trace"), protocol=0))
        ],
        "a Constant whose value_int is declared FLOAT": _mislabelled("value_int", AttributeProto.FLOAT, f=1.0),
        "a name that is not UTF-8": _of(lambda: models.make_bytes().replace(b"observation", b"\xffbservation")),
        "weights in /proc/self/environ": _of(lambda: models.external("/proc/self/environ")),
        "weights in a file beside Python's": _of(lambda: models.external("usr/lib/os-release")),
        "weights in another file, named in a node": _of(lambda: models.external_in_constant("etc/hostname")),
        "weights at a memory address": _of(lambda: models.external(**_ADDRESS)),
        "sparse weights outside their shape": _of(models.sparse),
        "an empty file": _of(lambda: b""),
        "nested graphs, 50,000 deep": _of(lambda: models.nested(50_000)),
        "a field that claims 2⁶² bytes": _of(lambda: b"\x3a" + models.varint(2**62) + b"x"),
        "a function that calls itself": _of(models.recursive),
        "a graph with a cycle": _of(models.circle),
        "a decision tree without a leaf": _of(models.tree),
        "an operator that reads files": _of(lambda: models.own_domain("ReadFile")),
        "actions of 10⁹ values": _of(lambda: make(outputs=[info("action", "batch", 10**9)])),
        "17 states of 60,000 values": _of(models.many_states),
        "actions in double precision": _of(models.in_doubles),
        "a batch of two and no other": _of(lambda: make(**_BATCH_OF_TWO)),
    },
    "speed": {
        "a Constant whose value_ints is declared INT": _mislabelled("value_ints", AttributeProto.INT, i=0),
        "actions of another shape than declared": _of(_doubled),
        "10¹⁰ numbers": _of(lambda: models.much(10**10)),
        "5 million numbers for each scenario": _of(lambda: models.in_every_session(5_000_000)),
        "an endless loop": _of(models.endless),
        "a slow operator": _of(lambda: models.slow(200_000)),
    },
    "rollout": {"NaN at the observations with which episodes begin, and nowhere else": _of(models.trap)},
    TOGETHER: {
        "a network with reordered hidden units, as another training seed": _beside(
            models.two_layers(range(7, -1, -1)), seed(1), models.two_layers(range(8))
        ),
        "a file with an added comment, under another name": _beside(
            models.make_bytes() + models.field(b"\x32", b"mine"), TOML.replace("Mine", "Yours")
        ),
        "the same training seed twice": _beside(_OTHER, TOML),
        "a name that differs in capitals and blanks only": _beside(_OTHER, TOML.replace("Mine", "M I N E")),
        "another training seed with another description": _beside(_OTHER, seed(1) + 'description = "The best"\n'),
    },
    SCORED: {
        "NaN": _knows(models.turns_nan),
        "an endless loop": _knows(models.hangs),
        "10¹¹ numbers": _knows(models.grows),
        "the least integer divided by −1": _divides("Div", _INT_MIN, -1),
        "the remainder of the least integer and −1": _divides("Mod", _INT_MIN, -1),
        "an integer divided by zero": _divides("Div", 1, 0),
        "actions for two scenarios": _knows(models.changes_shape),
        "an index outside the weights": _knows(models.points_outside),
    },
    # What two readers take for different things, what would mix scenarios, and what cannot be repeated.
    HARMLESS: {
        "a Constant whose value_int is declared INTS": _mislabelled("value_int", AttributeProto.INTS, ints=[0]),
        "a Constant whose value_ints is declared TENSOR": _mislabelled(
            "value_ints", AttributeProto.TENSOR, t=constant("t", [0], np.int64)
        ),
        "a Constant whose value is declared INTS": _mislabelled("value", AttributeProto.INTS, ints=[0]),
        "a Constant with several values": _mislabelled("value_ints", AttributeProto.INTS, ints=[0], i=1, f=2.0),
        "a mean over the scenarios with keepdims = 2": _over_lanes("ReduceMean", axes=[0], keepdims=2),
        "a mean over the scenarios with keepdims = -1": _over_lanes("ReduceMean", axes=[0], keepdims=-1),
        "a running sum over the scenarios": _of(_running_sum),
        "products of scenarios, and their number": _of(models.mixed),
        # Tells the last scenario from the others.
        "rounding at the end of a vector, times 10⁸": _of(models.last_lane),
        # Depends on their address.
        "rounding of a sum of states, times 10⁸": _of(models.sums_of_a_state),
        "random actions": _of(lambda: after(node("RandomUniformLike", ["linear"], "action", low=-1.0, high=1.0))),
        "random dropout": _of(models.dropout),
        "an infinite state that no action uses": _of(models.hidden_nan),
    },
}


def verdict(build: Build, place: Path) -> tuple[str, str]:
    """Return what becomes of an attack, and why."""
    *sound, hostile = build(place)
    reports = [*(check_submission(path, rollout_only=True) for path in sound), check_submission(hostile)]
    for report in reports:
        if report.refusal is not None:
            return report.refusal.name, report.refusal.reason
    for conflict in conflicts(reports):
        return TOGETHER, conflict.reason
    return _scored(reports[-1].played())


@functools.cache
def _harmless() -> tuple[Entry, list[Episode]]:
    """Return a harmless entry, and all episodes where it is played without an attack."""
    entry = Entry(name="Beside", policy=OnnxPolicy(models.make_bytes()), fingerprint="beside")
    return entry, list(evaluate([entry], "standard", "test", seeds=_SEEDS, duration_s=_SHORT_S).episodes)


def _scored(entry: Entry) -> tuple[str, str]:
    """Return how an accepted policy fails when it is scored, or that it is harmless."""
    beside, without = _harmless()
    together = evaluate([entry, beside], "standard", "test", seeds=_SEEDS, duration_s=_SHORT_S, keep_going=True)
    assert [e for e in together.episodes if e.entry != entry.name] == without, "others' results stand"
    if together.failed:
        return SCORED, together.failed[0]["reason"]
    for number in _SEEDS:
        alone = evaluate([entry], "standard", "test", seeds=[number], duration_s=_SHORT_S)
        if alone.episodes_of(entry.name) != [e for e in together.episodes_of(entry.name) if e.seed == number]:
            return "not found", f"the scenario of seed {number} costs another amount alone"
    return HARMLESS, "accepted; every scenario costs the same to the last bit alone and beside others"


@pytest.mark.parametrize(("end", "name"), [(end, name) for end, attacks in ATTACKS.items() for name in attacks])
def test_hostile_submission_is_stopped(end: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Long enough for every other step, on a busy machine too.
    monkeypatch.setattr(policy_process, "STEP_S", 2.0 if name in ENDLESS else 5.0)
    monkeypatch.setattr(policy_process, "LOAD_S", 20.0)
    if name in ENDLESS and end in CHECKS:
        # It is loaded in its time, and takes all that its first answer may take.
        check_speed = gate.check_speed

        def impatient(policy: OnnxPolicy) -> str:
            monkeypatch.setattr(policy_process, "LOAD_S", 2.0)
            return check_speed(policy)

        monkeypatch.setattr(gate, "check_speed", impatient)
    if end != HARMLESS:
        # Its verdict is another one than that its answers repeat, which is looked at in all of the gate's scenarios.
        monkeypatch.setattr(gate, "_ROLLOUT_LANES", 8)
    found, reason = verdict(ATTACKS[end][name], tmp_path)
    assert found == end, reason
    assert reason and reason.isprintable() and len(reason) < 1600
    # What is in a pickle would have left it here.
    assert not (tmp_path / "trace").exists()
