"""Facts about the evaluation: independent of how it is cut up, interruptible, strict with policies; its measures."""

import dataclasses
import re
import signal
import sys
import threading
import time

import gymnasium as gym
import numpy as np
import pytest

import wtg_gym
from tests.envs import rollouts
from tests.interruption import interrupted
from wtg_gym import Entry, GroupTrip, Plant, Results, TrackingLaw, evaluate, get_law, get_suite, load_entries, simulate
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import PolicyError
from wtg_gym.evaluation.evaluator import Progress, departures, recompute
from wtg_gym.evaluation.metrics import quasi_steady_deviation
from wtg_gym.evaluation.partial import PartialStore
from wtg_gym.evaluation.recording import recorded
from wtg_gym.physics.parameters import TurbineParameters

SHORT = {"seeds": (20_002, 20_000, 20_005), "duration_s": 10.0}
#: What a part was stored with, beside what is asked for.
OTHER_PARTS = [
    *({"entry": {key: value}} for key, value in (("name", "other"), ("training_seed", 2), ("fingerprint", "another"))),
    *({"rows": {key: value}} for key, value in (("entry", "other"), ("training_seed", 2), ("seed", 20_001))),
    *({"context": ["gust", "test"]}, {"seeds": [20_001, 20_000]}, {"seeds": [20_000]}, {}),
]
DT = 0.1


class Answering:
    """A policy that answers whatever a function of the observation and the step says."""

    def __init__(self, answer) -> None:
        self.answer, self.step = answer, -1

    def predict(self, observation, state=None, *_, **__):
        self.step += 1
        return self.answer(observation, self.step)


def linear(gain: float) -> Answering:
    """Return a policy with a fixed multiple of the frequency deviation on every action."""
    return Answering(lambda observation, step: (np.repeat(-gain * observation[:, :1], 4, axis=1), None))


class Counting:
    """A policy with a recurrent state; it notes what it was given."""

    def __init__(self) -> None:
        self.states, self.starts = [], []

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        assert deterministic
        self.states.append(state)
        self.starts.append(episode_start)
        count = np.zeros(len(observation)) if state is None else state[0] + 1.0
        return np.repeat(0.01 * count[:, np.newaxis], 4, axis=1), (count,)


@pytest.mark.parametrize("policy", [None, linear(2.0)], ids=["law", "policy"])
def test_episode_equals_the_single_environment(policy):
    results = evaluate([Entry(name="mine", strategy="deloaded-5", policy=policy)], "standard", "test", **SHORT)
    env = gym.make("GFMWTG-14bus-v0", strategy="deloaded-5", duration_s=10.0, disable_env_checker=True).unwrapped
    for episode in results.episodes_of("mine"):
        scenario = get_suite("standard").scenario(episode.seed, n_turbines=[10.0, 10.0], duration_s=10.0)
        observation, info = env.reset(options={"scenario": scenario})
        terms = {key: 0.0 for key in info if key.startswith("cost_")}
        frequency, over = [info["frequency_hz"]], False
        while not over:
            action = np.zeros(4) if policy is None else policy.predict(observation[np.newaxis])[0][0]
            observation, _, terminated, truncated, info = env.step(action.astype(np.float32))
            over = terminated or truncated
            frequency.append(info["frequency_hz"])
            terms = {key: value + info[key] for key, value in terms.items()}
        assert {k: episode.metrics[k] for k in terms} == pytest.approx(terms, rel=1e-12 if policy is None else 1e-6)
        assert episode.failure == info["termination_reason"]
        assert episode.metrics["survived_s"] == pytest.approx(info["time_s"])
        assert episode.metrics["nadir_hz"] <= min(frequency) and episode.metrics["zenith_hz"] >= max(frequency)


def test_recurrent_state_is_passed_on_and_starts_anew_in_every_batch():
    policy = Counting()
    results = evaluate([Entry(name="counting", policy=policy)], "standard", "test", batch=2, **SHORT)
    firsts = [i for i, state in enumerate(policy.states) if state is None]
    assert firsts == [0, 100]
    assert [int(state[0][0]) for state in policy.states[1:100]] == list(range(99))
    assert [start.shape for start in policy.starts] == [(2,)] * 100 + [(1,)] * 100
    assert [set(start.tolist()) for start in policy.starts] == [{i in firsts} for i in range(200)]
    whole = evaluate([Entry(name="counting", policy=Counting())], "standard", "test", **SHORT)
    assert whole.episodes == results.episodes


def test_failed_episode_is_kept_and_its_env_ignores_actions():
    last = [None]

    def drain(observation, step: int):
        actions = np.tile([1.0, 0.0], (len(observation), 2))
        if last[0] is not None:
            actions[(observation == last[0]).all(axis=1)] = np.nan
        last[0] = observation
        return actions, None

    entry = Entry(name="drain", strategy="mppt", policy=Answering(drain), action_mode="k+tau")
    results = evaluate([entry], "low-wind", "test", seeds=range(20_000, 20_008), duration_s=60.0)
    episodes = results.episodes_of("drain")
    failed = [episode for episode in episodes if episode.failed]
    assert failed and len(failed) < len(episodes), "the test needs environments that end at different times"
    for episode in failed:
        assert episode.failure == "stall"
        assert episode.metrics["survived_s"] < 60.0 and episode.metrics["cost_failure"] > 0.0
        assert episode.metrics["quasi_steady_deviation_hz"] is None


BAD = {
    "nan": (lambda o, s: (np.full((3, 4), np.nan if s == 7 else 0.0), None), r"step 7: .*\(3, 4\) must be finite"),
    "shape": (lambda o, s: (np.zeros((3, 2)), None), r"shape \(3, 4\) .*got shape \(3, 2\)"),
    "text": (lambda o, s: ("up", None), "numbers"),
    "numbers-as-text": (lambda o, s: (np.zeros((3, 4)).astype(str), None), "an array of numbers, got one of <U32"),
    "raises": (lambda o, s: 1 / 0, r"step 0: predict\(\) raised ZeroDivisionError: .* zero \(test_evaluator\.py:\d+\)"),
    "exit": (lambda o, s: sys.exit(3), r"step 0: predict\(\) raised SystemExit: 3"),
    "no-state": (lambda o, s: np.zeros((3, 4)), r"\(actions, state\)"),
}
OF_TWO_KINDS = [Entry(name="a", policy=linear(1.0), training_seed=seed, learned=seed == 0) for seed in (0, 1)]
WRONG = [
    ([], "standard", {"split": "tests", "seeds": None}, "unknown split"),
    ([], "standard", {"split": "train", "seeds": None}, "too many"),
    ([], "standard", {"seeds": []}, "seeds must be a list of whole numbers, one or more, got .*20000 … 20199"),
    ([], "standard", {"batch": 0}, "1 … 10000"),
    ([], "standard", {"strategy": "mppt"}, "set by the entry"),
    ([], "standard", {"partial": __file__}, "partial must be a folder"),
    ([], "standard-v1", {"plant": {"turbine": TurbineParameters()}}, "in plant, give numbers and texts"),
    ([3], "standard", {}, "list of Entry"),
    ([Entry(name="a"), Entry(name="a", training_seed=1)], "standard", {}, "all have a training seed"),
    (OF_TWO_KINDS, "standard", {}, "entries named 'a' share a row and must agree on kind, got"),
]


@pytest.mark.parametrize("case", BAD)
def test_bad_policy_is_named_with_step_and_shape(case):
    answer, text = BAD[case]
    with pytest.raises(PolicyError, match=f"'{case}', .*{text}"):
        evaluate([Entry(name=case, policy=Answering(answer))], "standard", "test", **SHORT)


def test_law_without_an_equilibrium_is_left_out_and_that_of_an_anchor_is_an_error(monkeypatch):
    greedy = TrackingLaw(name="greedy", k_min=3.0, k_nominal=3.0, k_max=3.0)
    law, fine = Entry(name="greedy", strategy=greedy), Entry(name="fine", strategy="deloaded-5")
    results = evaluate([law, fine], "standard", "test", keep_going=True, **SHORT)
    others = evaluate([fine], "standard", "test", **SHORT)
    assert results == dataclasses.replace(others, failed=results.failed)
    (failed,) = results.failed
    text = r"entry 'greedy': .* has no equilibrium at a wind of .* with k = 3 p\.u\."
    assert failed["name"] == "greedy" and re.match(text, failed["reason"])
    with pytest.raises(PolicyError, match=text):
        evaluate([law, fine], "standard", "test", **SHORT)
    monkeypatch.setattr("wtg_gym.evaluation.evaluator.play_batch", lambda e, *_: PolicyError(f"entry {e.name!r}"))
    with pytest.raises(PolicyError, match="entry 'mppt'"):
        evaluate([], "standard", "test", keep_going=True, **SHORT)


def test_entry_that_fails_is_left_out_with_its_row_and_the_others_stand(tmp_path):
    def fails_at(step: int):
        return Answering(lambda o, s: (np.full((len(o), 4), np.nan if s == step else 0.5), None))

    def raises(observation, step: int):
        raise RuntimeError("no\nidea \x1b[2J")

    first, second = Entry(name="first", policy=linear(1.0)), Entry(name="second", policy=linear(0.5))
    never = Answering(raises)
    seeds = [Entry(name="nan", policy=p, training_seed=i) for i, p in enumerate((fails_at(-1), fails_at(7), never))]
    entries = [first, *seeds, Entry(name="raises", policy=Answering(raises)), second]
    results = evaluate(entries, "standard", "test", keep_going=True, batch=2, partial=tmp_path / "parts", **SHORT)
    others = evaluate([first, second], "standard", "test", **SHORT)
    assert results == dataclasses.replace(others, failed=results.failed)
    assert [entry["training_seed"] for entry in results.failed] == [0, 1, 2, None]
    assert never.step == -1, "a seed of a row that has failed already is not played"
    reasons = [entry["reason"] for entry in results.failed]
    assert reasons[0] == reasons[1] == reasons[2] and "entry 'nan (training seed 1)', step 7" in reasons[1]
    assert "raised RuntimeError: no idea \\x1b[2J (test_evaluator.py:" in reasons[3]
    by_name = (results.scores, results.pinned_costs)
    for look_up in (results.episodes_of, *(each.__getitem__ for each in by_name)):
        with pytest.raises(KeyError, match=r"unknown entry 'nan': entry 'nan .training seed 1.', step 7.*; choose one"):
            look_up("nan")
    read = Results.read(results.write(tmp_path / "a")[0])
    assert read == results and read.to_dict()["summary"] == others.to_dict()["summary"]


@pytest.mark.parametrize(("entries", "suite", "arguments", "text"), WRONG)
def test_wrong_argument_is_refused(entries, suite, arguments, text):
    with pytest.raises(ValueError, match=text):
        evaluate(entries, suite, **{"split": "test", "seeds": [20_000], "duration_s": 2.0, **arguments})


def killer(after: int) -> Progress:
    return interrupted(lambda *_: None, when=lambda _, done, __: done >= after)


def test_killed_run_goes_on_and_keeps_its_parts_until_the_results_are_written(results, entries, tmp_path, monkeypatch):
    partial = tmp_path / "partial"
    arguments = {"batch": 2, "partial": partial, **SHORT}
    with pytest.raises(KeyboardInterrupt):
        evaluate(entries, "standard", "test", on_progress=killer(5), **arguments)
    assert len(list(partial.iterdir())) == 3
    played: list[str] = []
    play = wtg_gym.evaluation.evaluator.play_batch
    monkeypatch.setattr("wtg_gym.evaluation.evaluator.play_batch", lambda e, *r: played.append(e.name) or play(e, *r))
    again = evaluate(entries, "standard", "test", **arguments)
    assert played == ["deloaded-10", "coordinated-piecewise", "coordinated-piecewise"]
    more = evaluate([*entries, Entry(name="deloaded-5", strategy="deloaded-5")], "standard", "test", **arguments)
    assert played[3:] == ["deloaded-5"] * 2 and len(list(partial.iterdir())) == 8
    (partial / "of another run").touch()
    for one, other in zip(again.write(tmp_path / "a"), results.write(tmp_path / "b"), strict=True):
        assert one.read_bytes() == other.read_bytes()
    (tmp_path / "c" / "standard-test.json").mkdir(parents=True)
    with pytest.raises(IsADirectoryError):
        more.write(tmp_path / "c")
    assert len(list(partial.iterdir())) == 3
    more.write(tmp_path / "d")
    assert [path.name for path in partial.iterdir()] == ["of another run"]


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs signals to a thread")
def test_interrupted_evaluation_ends_its_threads_and_their_policies(monkeypatch):
    step, main, steps = EnvBatch.step, threading.get_ident(), []

    def interrupting(batch: EnvBatch, *arguments) -> None:
        if threading.get_ident() != main:
            steps.append(arguments)
            if len(steps) == 3:
                signal.pthread_kill(main, signal.SIGINT)
                # Between two answers, while the main thread closes the policy for the first time.
                time.sleep(0.5)
            time.sleep(0.02)
        step(batch, *arguments)

    monkeypatch.setattr(EnvBatch, "step", interrupting)
    with pytest.raises(KeyboardInterrupt):
        evaluate("linear-feedback", "standard", seeds=[10_000], duration_s=100.0)
    assert 3 <= len(steps) < 1000, "the episodes were not played to their end"
    n_steps = len(steps)
    time.sleep(0.1)
    assert len(steps) == n_steps, "no thread plays on"


def test_damaged_and_exchanged_parts_are_played_again(results, entries, tmp_path, caplog):
    with pytest.raises(KeyboardInterrupt):
        evaluate(entries, "standard", "test", on_progress=killer(9), batch=2, partial=tmp_path, **SHORT)
    cut, edited, first, second, *_ = tmp_path.iterdir()
    cut.write_text("{")
    edited.write_text(edited.read_text().replace("standard/20000", "standard/20001").replace("20005", "20006"))
    content = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(content)
    assert evaluate(entries, "standard", "test", batch=2, n_threads=1, partial=tmp_path, **SHORT) == results
    assert [record.getMessage().count("is played again") for record in caplog.records] == [1] * 4


@pytest.mark.parametrize("change", OTHER_PARTS, ids=str)
def test_a_part_is_used_for_exactly_what_it_was_stored_for(results, tmp_path, change):
    asked = {"name": "linear", "policy": linear(0.2), "fingerprint": "a policy", "training_seed": 1}
    seeds = [20_000, 20_001]
    row = dataclasses.replace(results.episodes[0], entry="linear", training_seed=1)
    rows = [dataclasses.replace(row, seed=seed) for seed in seeds]
    PartialStore(tmp_path, ["standard", "test"]).save(Entry(**asked), seeds, rows)
    (wanted,) = tmp_path.iterdir()
    wanted.unlink()
    other_entry = Entry(**{**asked, **change.get("entry", {})})
    other_rows = [dataclasses.replace(row, **change.get("rows", {})) for row in rows]
    store = PartialStore(tmp_path, change.get("context", ["standard", "test"]))
    store.save(other_entry, change.get("seeds", seeds), other_rows)
    (stored,) = tmp_path.iterdir()
    stored.rename(wanted)
    loaded = PartialStore(tmp_path, ["standard", "test"]).load(Entry(**asked), seeds)
    assert loaded == (None if change else rows)


def test_parts_of_other_settings_are_not_used_and_an_unknown_policy_has_none(tmp_path):
    unknown = Entry(name="unknown", policy=linear(0.2))
    evaluate([unknown], "standard", "test", partial=tmp_path, **SHORT)
    stored = set(tmp_path.iterdir())
    assert len(stored) == 2  # of the anchors
    other = evaluate([], "standard", "test", partial=tmp_path, weights={"rocof": 0.0}, **SHORT)
    assert all(episode.metrics["cost_rocof"] == 0.0 for episode in other.episodes)
    assert other.settings["weights"]["rocof"] == 0.0
    other.parts.clear()
    assert set(tmp_path.iterdir()) == stored


def test_sensors_of_an_evaluation_are_in_its_settings_and_decide_its_numbers():
    (droop,) = load_entries("fast-droop")
    arguments = {"seeds": (10_000, 10_001), "duration_s": 30.0}
    measured = evaluate([droop], "standard-v1", **arguments)
    exact = evaluate([droop], "standard-v1", sensors="exact", **arguments)
    assert exact.settings["sensors"] == "exact" != measured.settings["sensors"]
    assert exact.environment["fingerprint"] != measured.environment["fingerprint"]
    assert exact.episodes_of("fast-droop") != measured.episodes_of("fast-droop")
    assert exact.episodes_of("coordinated-tuned") == measured.episodes_of("coordinated-tuned")
    assert [recompute(results, [droop]).differences for results in (measured, exact)] == [[], []]
    assert any(text.startswith("sensors is exact") for text in departures(exact))
    assert not any(text.startswith("sensors") for text in departures(measured))


def test_metrics_agree_with_the_recorded_run():
    results = evaluate([], "paper", "test", duration_s=60.0)
    for episode in results.episodes_of("coordinated-piecewise"):
        scenario = get_suite("paper").scenario(episode.seed, duration_s=60.0)
        run = simulate(scenario, get_law("coordinated-piecewise"))
        m = episode.metrics
        assert m["nadir_hz"] == pytest.approx(run.frequency_hz.min(), abs=2e-3)
        assert m["zenith_hz"] == pytest.approx(run.frequency_hz.max(), abs=2e-3)
        assert m["largest_rocof_hz_s"] == pytest.approx(np.abs(run.rocof_hz_s()).max(), rel=1e-9)
        assert m["peak_power_pu"] == pytest.approx(run.power_pu.max(), rel=0.02)
        assert m["least_tip_speed_ratio"] == pytest.approx(run.tip_speed_ratio.min(), rel=1e-3)
        # Two groups of ten turbines of 5 MW each.
        energy = np.trapezoid(run.captured_power_pu, dx=DT, axis=0).sum() * 50.0 / 3600.0
        assert m["energy_mwh"] == pytest.approx(energy, rel=1e-4)
        assert m["survived_s"] == pytest.approx(60.0)
        assert 90.0 < m["energy_share_percent"] < 100.0


def test_worst_frequency_and_shed_energy_are_those_of_info_and_none_in_the_papers_physics(results):
    law, seeds = "coordinated-tuned", range(10_000, 10_006)
    env = gym.make("GFMWTG-14bus-v1", strategy=law, duration_s=20.0, disable_env_checker=True).unwrapped
    for episode in evaluate([], "standard-v1", "validation", seeds=seeds, duration_s=20.0).episodes_of(law):
        scenario = get_suite("standard-v1").scenario(episode.seed, duration_s=20.0)
        infos = [info for *_, info in rollouts.episode(env, options={"scenario": scenario})]
        worst = [info["worst_frequency_hz"] for info in infos]
        m = episode.metrics
        assert 45.0 < m["worst_nadir_hz"] <= min(worst) and max(worst) <= m["worst_zenith_hz"] < 55.0
        assert m["worst_nadir_hz"] < m["nadir_hz"] and m["worst_zenith_hz"] > m["zenith_hz"]
        assert m["shed_energy_mwh"] == pytest.approx(infos[-1]["shed_energy_mws"] / 3600.0)
    names = ("worst_nadir_hz", "worst_zenith_hz", "shed_energy_mwh")
    assert {episode.metrics[name] for episode in results.episodes for name in names} == {None}


def test_deloading_shows_in_the_share_of_energy():
    calm = evaluate("deloaded-10", "paper", "test", seeds=[0], duration_s=5.0)
    shares = {e.entry: e.metrics["energy_share_percent"] for e in calm.episodes}
    assert shares == pytest.approx({"mppt": 100.0, "deloaded-10": 90.0, "coordinated-piecewise": 95.0}, abs=0.01)
    errors = {e.entry: e.metrics["duty_error_percent"] for e in calm.episodes}
    assert errors == pytest.approx({"mppt": 5.0, "deloaded-10": 5.0, "coordinated-piecewise": 0.0}, abs=0.01)


def test_quasi_steady_deviation_is_the_mean_of_the_last_five_seconds():
    frequency = np.concatenate([np.full(551, 49.0), np.full(50, 49.8)])
    assert quasi_steady_deviation(frequency, DT, 50.0) == pytest.approx(-0.2)
    assert quasi_steady_deviation(np.array([50.0, 50.1, 50.2]), DT, 50.0) == pytest.approx(0.15)


def test_tripped_groups_are_counted_where_the_run_goes_on():
    results = evaluate([], "low-wind", "test", seeds=range(20_000, 20_040), on_failure="trip")
    tripped = [e for e in results.episodes_of("mppt") if e.metrics["tripped_groups"] > 0.0]
    assert tripped and all(e.failure == "" and e.metrics["survived_s"] == pytest.approx(60.0) for e in tripped)
    assert Plant().trips_groups is False


def test_the_slowest_rotor_is_one_of_a_connected_group():
    trips = [GroupTrip(time_s=2.0 if group == 3 else 1.0, group=group) for group in range(4)]
    scenario = dataclasses.replace(get_suite("standard-v1").scenario(10_000), events=trips)
    run = recorded(*load_entries("coordinated-tuned"), EnvSettings(suite="standard-v1"), [scenario])
    slowest, stored = run.rotor_speed_pu[:, 0], run.stored_mj[:, 0, 3]
    assert np.array_equal(np.isnan(slowest), run.time_s > 2.0)
    last = (run.time_s > 1.0) & (run.time_s <= 2.0)
    assert np.ptp(slowest[last] ** 2 / stored[last]) < 1e-12
