"""Every hostile policy gets its verdict; what the gate accepts is scored, alone and beside a harmless entry."""

import functools
import os
import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from onnx import ModelProto

from tests.submissions import models
from tests.submissions.models import M, after, folder, info
from tests.submissions.models import model as make
from wtg_gym.evaluation import Entry, OnnxPolicy, evaluate
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.policies import gate, policy_process
from wtg_gym.policies.gate import CHECKS, check_submission

#: The verdict on a policy that the gate accepts: every scenario costs the same to the last bit.
HARMLESS = "harmless"
_SEEDS, _SHORT_S = (20_000, 20_001), 5.0

Build = Callable[[], bytes | ModelProto]


#: What the code in a pickle would leave.
TRACE = Path(tempfile.gettempdir()) / f"trace-of-a-pickle-{os.getpid()}"


class Evil:
    """Would write a file when it is unpickled."""

    def __reduce__(self):
        return os.system, (f"touch {TRACE}",)


def _after(text: str, **values) -> Build:
    return lambda: after(text, **values)


_ADDRESS = {"location": "*/_ORT_MEM_ADDR_/*", "offset": "4096", "length": "320"}
#: By their verdicts; a check of the gate is its name.
ATTACKS: dict[str, dict[str, Build]] = {
    "loading": {
        "an empty file": lambda: b"",
        "code in a pickle": lambda: pickle.dumps(Evil(), protocol=0),
        "a name that is not UTF-8": lambda: models.make_bytes().replace(b"observation", b"\xffbservation"),
        "a field that claims 2⁶² bytes": lambda: b"\x3a" + models.varint(2**62) + b"x",
        "nested graphs, 50,000 deep": lambda: models.nested(50_000),
        "weights in /proc/self/environ": lambda: models.external("/proc/self/environ"),
        "weights at a memory address": lambda: models.external(**_ADDRESS),
        "a graph with a cycle": _after("a = Add(linear, b); b = Add(a, linear); action = Identity(b)"),
        "an operator that reads files": lambda: make(
            models.nodes_of("action = ai.onnx.contrib.ReadFile(observation)"), domains=[("ai.onnx.contrib", 1)]
        ),
        "actions of 10⁹ values": lambda: make(outputs=[info("action", "batch", 10**9)]),
        "more observations than there are": lambda: models.linear(35, M),
        "another version's observations and actions": models.of_v1,
    },
    "speed": {
        "actions of another shape than declared": lambda: make(
            models.nodes_of("twice = Concat<axis = 0>(observation, observation); action = MatMul(twice, weights)")
        ),
        "10¹⁰ numbers": _after("a = ConstantOfShape(n); b = ReduceMax(a); action = Add(linear, b)", n=[10**10]),
        "an endless loop": models.endless,
    },
    "rollout": {"NaN at the observations with which episodes begin, and nowhere else": models.trap},
    # What would mix scenarios, and what cannot be repeated.
    HARMLESS: {
        "products of scenarios, and their number": _after(
            "t = Transpose(linear); products = MatMul(linear, t); sum = ReduceSum<keepdims = 1>(products); "
            "shape = Shape(linear); sizes = Cast<to = 1>(shape); largest = ReduceMax<keepdims = 0>(sizes); "
            "mean = Div(sum, largest); action = Add(mean, linear)"
        ),
        "random dropout": _after("action = Dropout(linear, half, yes)", half=0.5, yes=True),
        "random numbers in a graph that not every reader sees": lambda: models.unseen(
            after("drawn = RandomNormalLike(linear); small = Mul(drawn, few); action = Add(linear, small)", few=0.1)
        ),
        "an infinite state that no action uses": lambda: models.with_state(
            "action = MatMul(observation, weights); next_state_0 = Add(state_0, infinite)", 1, infinite=[[np.inf]]
        ),
    },
}


@functools.cache
def _harmless() -> tuple[Entry, list[Episode]]:
    entry = Entry(name="Beside", policy=OnnxPolicy(models.make_bytes()), fingerprint="beside")
    return entry, list(evaluate([entry], "standard", "test", seeds=_SEEDS, duration_s=_SHORT_S).episodes)


def check_harmless(entry: Entry) -> None:
    """Check that every scenario costs the same to the last bit alone and beside others, and theirs too."""
    beside, without = _harmless()
    together = evaluate([entry, beside], "standard", "test", seeds=_SEEDS, duration_s=_SHORT_S)
    assert [e for e in together.episodes if e.entry != entry.name] == without, "others' results stand"
    for number in _SEEDS:
        alone = evaluate([entry], "standard", "test", seeds=[number], duration_s=_SHORT_S)
        assert alone.episodes_of(entry.name) == [e for e in together.episodes_of(entry.name) if e.seed == number]


@pytest.mark.parametrize(("end", "name"), [(end, name) for end, attacks in ATTACKS.items() for name in attacks])
def test_hostile_policy_is_stopped(end, name, tmp_path, monkeypatch):
    # Less takes less time to fill.
    monkeypatch.setattr(policy_process, "MEMORY_BYTES", 3 * 2**29)
    # Long enough for every other step, on a busy machine too.
    monkeypatch.setattr(policy_process, "STEP_S", 5.0)
    monkeypatch.setattr(policy_process, "LOAD_S", 20.0)
    if name == "an endless loop":
        # It is loaded in its time, and takes all that its first answer may take.
        check_speed = gate.check_speed

        def impatient(policy: OnnxPolicy) -> str:
            monkeypatch.setattr(policy_process, "LOAD_S", 2.0)
            return check_speed(policy)

        monkeypatch.setattr(gate, "check_speed", impatient)
    # That its answers repeat, which is the last check, is looked at in fewer scenarios.
    monkeypatch.setattr(gate, "_ROLLOUT_ENVS", 32 if end == HARMLESS else 8)
    report = check_submission(folder(tmp_path / "a", ATTACKS[end][name]()))
    if end == HARMLESS:
        check_harmless(report.entry)
    else:
        assert report.refusal.name == end, report.refusal
        assert report.refusal.reason.isprintable() and len(report.refusal.reason) < 1600
    assert [check.name for check in report.checks] == list(CHECKS)
    assert not TRACE.exists()
