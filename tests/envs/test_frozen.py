"""Facts about `GFMWTG-14bus-v0`, which is frozen: its observations, rewards and ends are those of version 0.1.0."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.envs.frozen import cases
from wtg_gym.evaluation.circumstances import versions

RECORDED: dict[str, Any] = json.loads((Path(__file__).parent / "frozen_v0.json").read_text(encoding="utf-8"))
CASES = cases()
#: Equilibria come from LAPACK, whose last bits depend on the processor.
SAME_MACHINE = all(RECORDED["versions"][key] == versions().get(key) for key in ("processor", "numpy", "scipy", "numba"))


def test_every_case_is_recorded() -> None:
    assert list(CASES) == list(RECORDED["cases"])


@pytest.mark.parametrize("name", CASES)
def test_answers_are_those_of_the_first_version(name: str) -> None:
    recorded, answers = RECORDED["cases"][name], CASES[name]()
    assert answers["n_ends"] == recorded["n_ends"]
    assert answers["sums"] == pytest.approx(recorded["sums"], rel=1e-6, abs=1e-3)
    if SAME_MACHINE:
        assert answers["sha256"] == recorded["sha256"]
