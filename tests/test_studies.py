"""What docs/studies tunes and plans with: candidates play as entries do."""

from __future__ import annotations

import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cma")

from gradient_law import LawLoss
from policies import FEEDBACKS, tune_feedback, write_feedback
from rollouts import Rollouts, history_feedback, linear_feedback

from wtg_gym.evaluation import evaluate, load_entries

#: But for the one that needs ANDES, which has an environment of its own.
STUDIES = {path.stem for path in (Path(__file__).parent.parent / "docs/studies").glob("*.py")} - {"make_andes_cases"}
SUITE, SEEDS = "standard-v1", [10_000, 10_001, 10_002]
LINEAR, LINEAR_V1, HISTORY_V1 = FEEDBACKS


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_every_study_finds_what_it_imports(name: str) -> None:
    importlib.import_module(name)


@pytest.mark.parametrize("how", [LINEAR, HISTORY_V1], ids=lambda how: how.folder)
def test_a_feedback_costs_the_same_in_the_search_and_as_a_file(how: object, tmp_path: Path) -> None:
    quick = dataclasses.replace(how, n_scenarios=2, generations=1, population=4)  # type: ignore[type-var]
    gains, n_wtg = tune_feedback(quick)
    gains = np.random.default_rng(0).normal(0.0, 0.2, gains.shape)
    write_feedback(quick, gains, n_wtg, tmp_path / "entry")
    (entry,) = load_entries(tmp_path / "entry")
    own = Rollouts(quick.suite, "validation", SEEDS, 1, strategy=quick.strategy, duration_s=12.0)
    act = history_feedback(gains, own.lanes.settings.control_dt) if quick.history else linear_feedback(gains)
    played = evaluate([entry], quick.suite, "validation", seeds=SEEDS, duration_s=12.0).pinned_costs[entry.name][0]
    # The file counts in single precision.
    assert own.pinned(own.play(act))[:, 0] == pytest.approx(played, rel=1e-3)
    assert played != pytest.approx(own.pinned(own.reference()), rel=1e-2)


def test_the_gradient_of_laws_is_that_of_other_laws_with_their_own_starts() -> None:
    loss = LawLoss("standard", 2)
    points = np.array([[1.0, 0.68, 0.55, -0.3], [1.05, 0.66, 0.5, 0.1]])
    seeds = [1_000_000, 1_000_001]
    _, gradient = loss(points, seeds)
    scenarios = loss.tape.lanes.scenarios(seeds)
    for place in np.ndindex(points.shape):
        step = np.zeros_like(points)
        step[place] = 1e-5
        ends = [loss._loss(loss.laws(points + sign * step), scenarios) for sign in (1.0, -1.0)]
        assert gradient[place] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3, abs=1e-5), place
