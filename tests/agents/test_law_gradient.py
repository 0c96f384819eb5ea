"""The paper's law tuned by gradients: of the loss, towards less of it, and the command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from law_gradient import LawLoss, held, main, scores, tune

from wtg_gym.evaluation import evaluate
from wtg_gym.physics.tracking_law import TrackingLaw, get_law
from wtg_gym.scenarios import get_suite

pytest.importorskip("cma", reason="agents.research needs the packages of agents")
Floats = npt.NDArray[np.float64]
SEEDS = [1_000_000, 1_000_001, 1_000_002]


@pytest.mark.parametrize("n_laws", [1, 2])
def test_the_gradient_is_that_of_other_laws_with_their_own_starts(n_laws: int) -> None:
    loss = LawLoss("standard", 3, 1)
    points = np.array([[1.0, 0.68, 0.55, -0.3], [1.05, 0.66, 0.5, 0.1]])[:n_laws]
    own, gradient = loss(points, SEEDS)
    assert gradient.shape == points.shape
    scenarios = loss.tape.lanes.scenarios(SEEDS)
    for place in np.ndindex(points.shape):
        step = np.zeros_like(points)
        step[place] = 1e-5
        ends = [loss._loss(loss.laws(points + sign * step), scenarios) for sign in (1.0, -1.0)]
        assert gradient[place] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3, abs=1e-5), place
    assert own == pytest.approx(np.mean(ends), rel=1e-4)


def test_tuning_is_repeatable_and_finds_a_better_law_than_the_papers() -> None:
    runs = [tune("standard", per_group=True, n_batches=4, n_scenarios=16, seed=1, n_threads=1) for _ in range(2)]
    assert runs[0].laws == runs[1].laws and runs[0].losses == runs[1].losses
    first, second = runs[0].laws
    assert first != second
    paper = get_law("coordinated-piecewise")
    before, after = scores("standard", [(paper, paper), runs[0].laws], 20, 1)
    assert before[0] == pytest.approx(100.0) and after[0] > 100.3 and after[1] < before[1]


def test_scores_are_those_of_the_evaluator() -> None:
    seeds = get_suite("standard").validation[:3]
    results = evaluate(["deloaded-5"], "standard", "validation", seeds=seeds)
    (summary,) = (own for own in results.summaries if own.name == "deloaded-5")
    law = get_law("deloaded-5")
    ((score, cost),) = scores("standard", [(law, law)], 3, 1)
    assert score == pytest.approx(summary.score.value) and cost == pytest.approx(summary.mean_cost)


def test_points_are_held_within_the_ranges_of_laws() -> None:
    low, high = held(np.array([[-1.0, -1.0, -1.0, -99.0]])), held(np.full((1, 4), 1e9))
    for (k_min, k_nominal, k_max, tau), least in ((low[0], 0.1), (high[0], 1e5)):
        law = TrackingLaw(
            name="held", k_min=k_min, k_nominal=k_nominal, k_max=k_max, damping_time_constant_s=float(np.exp(tau))
        )
        assert law.damping_time_constant_s == pytest.approx(least)


def test_the_command_prints_tables_and_writes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- law:start -->\n<!-- law:end -->\n")
    arguments = ["--batches", "1", "--scenarios", "2", "--validation", "2", "--threads", "1"]
    assert main([*arguments, "--page", str(page)]) == 0
    text = page.read_text()
    assert "| the paper's | 1.024 | 0.672 | 0.549 | 0.800 | 100.0 |" in text
    assert "| one for each group |" in text and "| law.tau_s |" in text
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--batches", "0"), "--batches = 0"),
        (("--seed", "-1"), "--seed = -1"),
        (("--page", "missing.md"), "missing.md"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1 and reason in said.err
