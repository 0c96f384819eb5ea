"""Facts about frozen environments: their observations, rewards and ends stay; those of v0 are of version 0.1.0."""

import json
from pathlib import Path

import pytest

from tests.envs.frozen import cases
from wtg_gym.evaluation.circumstances import versions
from wtg_gym.scenarios import FROZEN_HASHES, SUITES

RECORDED = {
    path.stem.removeprefix("frozen_"): json.loads(path.read_text(encoding="utf-8"))
    for path in sorted(Path(__file__).parent.glob("frozen_v*.json"))
}
CASES = {version: cases(version) for version in RECORDED}


def test_a_version_is_frozen_in_its_suites_and_its_answers_alike():
    assert "v0" in RECORDED
    assert {SUITES[name].task.version for name in FROZEN_HASHES} == set(RECORDED)
    assert set(FROZEN_HASHES) == {name for name, suite in SUITES.items() if suite.task.version in RECORDED}


@pytest.mark.parametrize("version", RECORDED)
def test_every_case_is_recorded(version):
    assert list(CASES[version]) == list(RECORDED[version]["cases"])


@pytest.mark.parametrize(("version", "name"), [(version, name) for version in CASES for name in CASES[version]])
def test_answers_are_those_of_the_first_version(version, name):
    recorded, answers = RECORDED[version]["cases"][name], CASES[version][name]()
    assert answers["n_ends"] == recorded["n_ends"]
    assert answers["sums"] == pytest.approx(recorded["sums"], rel=1e-6, abs=1e-3)
    # Equilibria come from LAPACK, whose last bits depend on the processor.
    ours, theirs = versions(), RECORDED[version]["versions"]
    if all(theirs[key] == ours.get(key) for key in ("processor", "numpy", "scipy", "numba")):
        assert answers["sha256"] == recorded["sha256"]
