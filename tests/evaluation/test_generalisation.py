"""Facts about the gap between public and fresh scenarios: it shows memorising and allows for luck."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from baselines import tip_speed_feedback
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, Results, evaluate, load_entries
from wtg_gym.evaluation.generalisation import excess_gap, generalisation_gaps, left_out, score_gap
from wtg_gym.evaluation.statistics import Groups
from wtg_gym.policies.play import started_lanes
from wtg_gym.scenarios import draw_seeds
from wtg_gym.tasks import V0

PUBLIC = range(20_000, 20_040)
DRAW = draw_seeds("standard", "a" * 40, b"a secret for these tests", 40)
SHORT = {"duration_s": 20.0}


class Memoriser:
    """Plays a good feedback in the scenarios it knows by their first observation, and nothing anywhere else."""

    def __init__(self) -> None:
        feedback = tip_speed_feedback.ENTRY
        self._policy: Any = feedback.policy
        with started_lanes(feedback, EnvSettings(suite="standard", **SHORT), PUBLIC) as (lanes, _):
            self._known = {row.tobytes() for row in lanes.observations}

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> Any:
        if state is None:
            state = np.array([[row.tobytes() in self._known] for row in np.asarray(observation)])
        actions, _ = self._policy.predict(observation)
        return np.where(state, actions, 0.0), state


@pytest.fixture(scope="module")
def both() -> tuple[Results, Results]:
    feedback = tip_speed_feedback.ENTRY
    modes: dict[str, Any] = {"action_mode": feedback.action_mode, "observation_mode": feedback.observation_mode}
    entries = [
        *load_entries("baselines", task=V0),
        Entry(name="memoriser", policy=Memoriser(), fingerprint="memoriser", **modes),
        Entry(name="honest", policy=feedback.policy, fingerprint="honest", **modes),
    ]
    public = evaluate(entries, "standard", "test", seeds=PUBLIC, **SHORT)
    return public, evaluate(entries, "standard", "fresh", draw=DRAW, **SHORT)


def test_memoriser_is_marked_and_the_same_policy_without_memory_is_not(both: tuple[Results, Results]) -> None:
    gaps = {gap.name: gap for gap in generalisation_gaps(*both)}
    memoriser, honest = gaps["memoriser"], gaps["honest"]
    assert memoriser.public.value == honest.public.value > 105.0
    assert memoriser.fresh.value == 100.0
    assert memoriser.excess is not None and honest.excess is not None
    assert memoriser.is_suspect and memoriser.excess.low > 5.0
    # A control does exactly what it does.
    assert not honest.is_suspect and abs(honest.excess.value) < 1e-9
    assert [gap.name for gap in gaps.values() if gap.is_suspect] == ["memoriser"]


def test_other_policies_of_a_name_are_left_out_and_few_scenarios_give_no_excess(both: tuple[Results, Results]) -> None:
    public, fresh = both
    seeds = fresh.seeds[:10]
    few = dataclasses.replace(fresh, seeds=seeds, episodes=tuple(e for e in fresh.episodes if e.seed in seeds))
    gaps = generalisation_gaps(public, few)
    assert len(gaps) == len(generalisation_gaps(*both)) and all(gap.excess is None for gap in gaps)
    changed = tuple({**entry, "sha256": "0" * 64} if entry["name"] == "honest" else entry for entry in fresh.entries)
    other = dataclasses.replace(fresh, entries=changed)
    assert left_out(public, fresh) == []
    assert left_out(public, other) == ["honest"]
    assert "honest" not in {gap.name for gap in generalisation_gaps(public, other)}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"suite": "gust"}, "another suite:"),
        ({"source_hash": "0" * 64}, "another source hash"),
        ({"settings": {}}, "another settings"),
    ],
)
def test_results_that_cannot_be_compared_are_refused(
    both: tuple[Results, Results], change: dict[str, Any], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        generalisation_gaps(both[0], dataclasses.replace(both[1], **change))


def test_gap_interval_agrees_with_a_bootstrap_written_out() -> None:
    rng = np.random.default_rng(8)
    sides = []
    for n in (120, 90):
        mppt = -rng.uniform(0.5, 2.0, n)
        sides.append((0.2 * rng.normal(size=(1, n)) - 0.1 * mppt, mppt, {"": np.arange(n)}))
    (a, m, _), (b, k, _) = sides

    i, j = (rng.integers(0, n, (20_000, n)) for n in (120, 90))
    resampled = 100.0 * (a[0, i].mean(axis=1) / -m[i].mean(axis=1) - b[0, j].mean(axis=1) / -k[j].mean(axis=1))
    low, high = np.percentile(resampled, [2.5, 97.5])
    interval = score_gap(*sides)
    assert interval.value == pytest.approx(100.0 * (a.mean() / -m.mean() - b.mean() / -k.mean()))
    assert interval.low == pytest.approx(low, abs=0.06 * (high - low))
    assert interval.high == pytest.approx(high, abs=0.06 * (high - low))


def _two_sets(rng: np.random.Generator, fitted: float) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, Groups]]:
    """Gains of two seeds and of two controls on lucky public scenarios and on fresh ones; `fitted` on the public."""
    sides = []
    mppt, groups = np.full(100, -1.0), {str(i): np.arange(i, 100, 3) for i in range(3)}
    for luck, extra in ((0.5, fitted), (0.0, 0.0)):
        shared = rng.normal(size=100) + luck
        controls = np.stack([shared + 0.1 * rng.normal(size=100), rng.normal(size=100)])
        sides.append((0.8 * shared + 0.1 * rng.normal(size=(2, 100)) + extra, controls, mppt, groups))
    return sides


def test_excess_is_what_the_controls_do_not_share() -> None:
    rng = np.random.default_rng(9)
    honest = [excess_gap(*_two_sets(rng, 0.0)) for _ in range(200)]
    assert 0.89 <= np.mean([interval.low <= 0.0 <= interval.high for interval in honest]) <= 0.99
    # The luck of half a standard deviation, 40 points here, is none of theirs.
    assert abs(np.mean([interval.value for interval in honest])) < 1.0
    fitted = [excess_gap(*_two_sets(rng, 0.1)) for _ in range(50)]
    assert np.mean([interval.value for interval in fitted]) == pytest.approx(10.0, abs=1.0)
    assert all(interval.low > 0.0 for interval in fitted)
