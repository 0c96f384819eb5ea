"""The searches for headroom: scenarios, files, and the same result after an interruption."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cma")

import foresight
import linear as linear_command
import simple_policies
from evolution import N_KNOTS, POPULATION, _Strategy, search_with_foresight
from rollouts import Rollouts, course, linear_feedback

from tests.interruption import interrupted
from wtg_gym.envs.observation import N_LOCAL
from wtg_gym.evaluation import Entry, OnnxPolicy, evaluate, load_entries
from wtg_gym.evaluation.oracle import OracleCosts
from wtg_gym.evaluation.score import pinned
from wtg_gym.scenarios import get_suite

SEEDS = [10_000, 10_001, 10_002]


@pytest.fixture(scope="module")
def rollouts() -> Rollouts:
    return Rollouts("standard", "validation", SEEDS, POPULATION, duration_s=12.0)


def test_reference_costs_what_the_evaluator_says(rollouts: Rollouts) -> None:
    results = evaluate([], "standard", "validation", seeds=SEEDS, duration_s=12.0)
    costs = [episode.metrics["cost"] for episode in results.episodes_of("coordinated-piecewise")]
    assert rollouts.reference().sum(axis=-1) == pytest.approx(costs, rel=1e-12)


def test_reference_is_played_once_a_scenario(rollouts: Rollouts, monkeypatch: pytest.MonkeyPatch) -> None:
    lanes: list[int] = []
    real = Rollouts.play

    def counting(self: Rollouts, candidates: Any) -> Any:
        lanes.append(self.lanes.n_lanes)
        return real(self, candidates)

    monkeypatch.setattr(Rollouts, "play", counting)
    rollouts.reference()
    assert lanes == [len(SEEDS)]


def test_no_gain_and_no_course_is_the_reference(rollouts: Rollouts) -> None:
    gains = np.zeros((POPULATION, rollouts.n_action, N_LOCAL + 1))
    knots = np.zeros((len(SEEDS), POPULATION, N_KNOTS, 2, rollouts.n_action))
    reference = np.repeat(rollouts.reference()[:, None], POPULATION, axis=1)
    assert (rollouts.play(linear_feedback(gains)) == reference).all()
    assert (rollouts.play(course(knots, rollouts.n_steps)) == reference).all()


def test_candidates_do_not_disturb_each_other(rollouts: Rollouts) -> None:
    gains = np.random.default_rng(0).normal(0.0, 0.3, (POPULATION, rollouts.n_action, N_LOCAL + 1))
    together = rollouts.play(linear_feedback(gains))
    alone = rollouts.with_candidates(1).play(linear_feedback(gains[5:6]))
    assert together[:, 5] == pytest.approx(alone[:, 0], rel=1e-9)
    assert np.unique(together.sum(axis=-1)).size == together[..., 0].size


def test_knots_are_met_and_joined_by_straight_lines() -> None:
    values = np.arange(4.0).reshape(1, 1, 4, 1, 1) ** 2
    act = course(values, 7)
    assert [float(act(step, np.empty(0)).item()) for step in range(7)] == [0.0, 0.5, 1.0, 2.5, 4.0, 6.5, 9.0]


def test_failed_episodes_cost_what_the_leaderboard_counts(rollouts: Rollouts) -> None:
    terms = rollouts.reference()
    terms[1, -1] = 3.0
    assert rollouts.pinned(terms).tolist() == [terms[0].sum(), 50.0 * (12.0 + 1.0), terms[2].sum()]


def test_a_search_does_not_depend_on_those_beside_it_nor_on_numpys_generator() -> None:
    def costs(seeds: list[int]) -> list[float]:
        np.random.seed(len(seeds))
        rollouts = Rollouts("standard", "validation", seeds, POPULATION, duration_s=3.0)
        return search_with_foresight(rollouts, seeds, None, 3, lambda _done, _cost: None).tolist()

    together = costs(SEEDS)
    assert costs(SEEDS[1:]) == pytest.approx(together[1:], rel=1e-9)
    assert costs(SEEDS) == together


def test_a_search_draws_from_its_own_generator_to_the_end() -> None:
    # Past the generation at which the covariance becomes a full one.
    def ends(other: int) -> list[float]:
        search, beside = _Strategy(np.zeros(6), 0.3, 0, 1), _Strategy(np.zeros(6), 0.3, 0, other)
        for _ in range(60):
            np.random.seed(other)
            for each in (beside, search):
                asked = each.ask()
                each.tell(asked, ((asked - np.arange(6.0)) ** 2).sum(axis=1))
        return search.mean.tolist()

    assert ends(2) == ends(3)
    assert ends(2) == pytest.approx(range(6), abs=0.01)


def test_exported_feedback_acts_like_the_searched_one(rollouts: Rollouts, tmp_path: Path) -> None:
    gains = np.random.default_rng(1).normal(0.0, 0.8, (2, N_LOCAL + 1))
    path = tmp_path / "policy.onnx"
    path.write_bytes(linear_command.linear_policy(gains, 2))
    entry = Entry(name="linear", policy=OnnxPolicy(path))
    results = evaluate([entry], "standard", "validation", seeds=SEEDS, duration_s=12.0)
    costs = [pinned(episode, 50.0) for episode in results.episodes_of("linear")]
    alone = rollouts.with_candidates(1)
    assert alone.pinned(alone.play(linear_feedback(gains)))[:, 0] == pytest.approx(costs, rel=1e-5)
    assert costs != pytest.approx(alone.pinned(alone.reference()), rel=1e-2)


# --- the commands ----------------------------------------------------------------------------------------------------

_QUICK = ("--suite", "paper", "--generations", "2", "--action-mode", "k")


@pytest.fixture(scope="module")
def linear(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("linear")
    files = ("--output", str(folder / "entry"), "--gains", str(folder / "gains.json"))
    assert linear_command.main([*_QUICK, "--scenarios", "2", *files, "--name", "mine"]) == 0
    return folder


def _foresight(folder: Path, *more: str, parts: str = "parts") -> Path:
    given = [*_QUICK, "--chunk", "1", "--output", str(folder), "--parts", str(folder / parts), *more]
    assert foresight.main(given) == 0
    return folder / "paper-test.csv"


def test_linear_writes_an_entry_and_its_gains(linear: Path) -> None:
    (entry,) = load_entries(linear / "entry")
    assert sorted(path.name for path in (linear / "entry").iterdir()) == ["entry.toml", "policy.onnx"]
    assert (entry.name, entry.action_mode, entry.training_seed, entry.kind) == ("mine", "k", 0, "learned")
    assert "tuned by CMA-ES on 2 training scenarios of paper" in entry.description
    data = json.loads((linear / "gains.json").read_text(encoding="utf-8"))
    assert np.array(data["gains"]).shape == (1, N_LOCAL + 1)
    assert (data["training"]["scenarios"], data["validation"]["scenarios"]) == (2, 2)
    assert data["validation"]["policy"] == pytest.approx(sum(data["validation"]["terms"].values()))
    # The suite's cases are the same in every split.
    assert data["training"]["policy"] == pytest.approx(data["validation"]["policy"], rel=1e-5)
    assert data["training"]["reference"] == pytest.approx(data["validation"]["reference"], rel=1e-12)


def test_foresight_writes_the_least_of_all_it_knows(linear: Path, tmp_path: Path) -> None:
    entries = [str(linear / "entry"), "deloaded-5"]
    _foresight(tmp_path, "--gains", str(linear / "gains.json"), "--entries", *entries)
    costs = OracleCosts.read(tmp_path / "paper-test.json")
    assert costs.seeds == (0, 1) and set(costs.found) == {"course", "course_and_feedback", "entries"}
    results = evaluate([entry for spec in entries for entry in load_entries(spec)], "paper", "test")
    known = {name: [pinned(e, 50.0) for e in results.episodes_of(name)] for name in ("mine", "deloaded-5")}
    assert costs.found["entries"] == tuple(map(min, known["mine"], known["deloaded-5"]))
    assert costs.reference == tuple(pinned(e, 50.0) for e in results.episodes_of("coordinated-piecewise"))
    assert costs.oracle == tuple(map(min, costs.reference, *costs.found.values()))
    assert costs.suite_hash == results.suite_hash and costs.settings == results.settings
    assert [entry["name"] for entry in costs.entries] == ["mine", "deloaded-5"]
    assert (costs.search["generations"], costs.search["population"], costs.search["knots"]) == (2, POPULATION, N_KNOTS)


def test_finished_chunks_are_not_searched_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[list[int]] = []
    real = foresight.search_with_foresight

    def counting(rollouts: Any, seeds: Any, *others: Any) -> Any:
        searched.append(list(seeds))
        return real(rollouts, seeds, *others)

    monkeypatch.setattr(foresight, "search_with_foresight", counting)
    _foresight(tmp_path, "--scenarios", "1")
    table = _foresight(tmp_path)
    assert searched == [[0], [1]]
    whole = table.read_bytes()
    assert _foresight(tmp_path).read_bytes() == whole and len(searched) == 2
    # Another search is another result; a damaged part is none at all.
    _foresight(tmp_path, "--seed", "1")
    assert len(searched) == 4
    parts = sorted((tmp_path / "parts").glob("*.json"))
    assert len(parts) == 4
    for part, damaged in zip(parts, (b"", b"{", b'{"costs": [1.0], "sha256": ""}', b'{"costs": "x"}'), strict=True):
        part.write_bytes(damaged)
    assert _foresight(tmp_path).read_bytes() == whole and len(searched) == 6


def test_interrupted_search_goes_on_to_the_same_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stopped = tmp_path / "stopped"
    stop = interrupted(foresight.search_with_foresight, when=lambda *_: any((stopped / "parts").glob("*.json")))
    monkeypatch.setattr(foresight, "search_with_foresight", stop)
    given = [*_QUICK, "--chunk", "1", "--output", str(stopped), "--parts", str(stopped / "parts")]
    assert foresight.main(given) == 130
    assert "goes on from the searches that are finished" in capsys.readouterr().err
    assert len(list((stopped / "parts").glob("*.json"))) == 1 and not (stopped / "paper-test.csv").exists()
    monkeypatch.undo()
    undisturbed = _foresight(tmp_path / "undisturbed")
    assert _foresight(stopped).read_bytes() == undisturbed.read_bytes()
    assert undisturbed.with_suffix(".json").read_bytes() == (stopped / "paper-test.json").read_bytes()


def _error_of(capsys: pytest.CaptureFixture[str], command: str, *arguments: str) -> str:
    main = {"linear": linear_command.main, "foresight": foresight.main}[command]
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1
    return said.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("linear", "--scenarios", "0"), "--scenarios = 0 is outside the allowed range 1 … 10000"),
        (("linear", "--generations", "0"), "--generations = 0 is outside the allowed range 1 … 100000"),
        (("linear", "--name", ""), "an entry's name must be 1 … 60 printable characters"),
        (("linear", "--suite", "storm"), "unknown suite 'storm'"),
        (("foresight", "--chunk", "0"), "--chunk = 0 is outside the allowed range 1 … 1000"),
        (("linear", "--seed", "-1"), "--seed = -1 is outside the allowed range 0 … 4294967295"),
        (("foresight", "--split", "train"), "invalid choice: 'train'"),
        (("foresight", "--entries", "turbo"), "unknown entry 'turbo'"),
        (("foresight", "--entries", "mppt", "mppt"), "given more than once: ['mppt']"),
        (("foresight", "--gains", "missing.json"), "cannot read the gains missing.json"),
        (("foresight", "--threads", "0"), "the number of threads must be 1 or more, got 0"),
        (("foresight", "--output", "file.txt"), "file.txt is not a folder"),
    ],
)
def test_bad_input_is_one_line_before_anything_runs(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    said: str,
) -> None:
    (tmp_path / "file.txt").write_text("not a folder", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    output = () if "--output" in arguments else ("--output", "out")
    assert said in _error_of(capsys, *arguments, *output)
    assert [path.name for path in tmp_path.iterdir()] == ["file.txt"]


@pytest.mark.parametrize(
    "content",
    [
        "[]",
        '{"action_mode": "k", "gains": "many"}',
        '{"action_mode": "tau", "gains": [[0, 0, 0, 0, 0, 0, 0, 0, 0]]}',
        '{"action_mode": "k", "gains": [[0, 0]]}',
        '{"action_mode": "k", "gains": [[0, 0, 0, 0, 0, 0, 0, 0, 1e999]]}',
    ],
)
def test_gains_that_do_not_fit_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path, content: str) -> None:
    path = tmp_path / "gains.json"
    path.write_text(content, encoding="utf-8")
    said = _error_of(capsys, "foresight", *_QUICK, "--gains", str(path), "--output", str(tmp_path / "out"))
    assert str(path) in said


def test_simple_policies_contain_the_reference_and_are_played_as_their_words_say(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = reference, policies = simple_policies.simple_policies("standard", "validation", 1, n_threads=1)
    costs = {(policy.family, policy.description): policy.cost for policy in policies}
    # Quartiles of what hardly changes are alike when they are rounded.
    assert len(policies) == 77 + 288 + 8 * 2 * 3 * 2
    assert costs["constant", "k +0, tau +0"] == reference
    assert policies == sorted(policies, key=lambda policy: policy.cost)

    class Constant:
        def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
            return np.tile([0.5, -1.0], (len(observation), 2)), state

    seeds = get_suite("standard").seeds("validation")[:1]
    results = evaluate([Entry(name="constant", policy=Constant())], "standard", "validation", seeds=seeds)
    (played,) = results.episodes_of("constant")
    assert costs["constant", "k +0.5, tau -1"] == pytest.approx(played.metrics["cost"], rel=1e-12)

    monkeypatch.setattr(simple_policies, "simple_policies", lambda *_: found)
    assert simple_policies.main([]) == 0
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("constant", "bang-bang", "relay", "sign(", "proportional"))


def test_too_many_scenarios_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert simple_policies.main(["--scenarios", "101"]) == 2
    assert "outside the allowed range 1 … 100" in capsys.readouterr().err
