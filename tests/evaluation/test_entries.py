"""Facts about entries, where they are found, and the conventional strategies among them."""

import dataclasses
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import baselines
from baselines.distilled_law import DistilledLaw, Gains
from baselines.fast_droop import FastDroop
from baselines.tip_speed_feedback import TipSpeedFeedback
from tests.changes import write
from wtg_gym.evaluation import Entry, load_entries
from wtg_gym.files import to_json
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.tracking_law import LAWS, REFERENCE_LAW, TrackingLaw, get_law
from wtg_gym.policies.entry import check_entries
from wtg_gym.tasks import V0, V1
from wtg_gym.tasks.measured_observation import MeasuredObservation
from wtg_gym.tasks.observation import of_groups

POLICIES = Path(__file__).resolve().parents[2] / "agents" / "policies"
MODULE = """
from wtg_gym.evaluation import Entry

class Still:
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return observation[:, :4] * 0.0, state

ENTRY = Entry(name={name!r}, policy=Still())
policy = Still()
number = 3

def build():
    return Entry(name="built", policy=Still(), fingerprint="1")
"""
#: Attributes of the module, and what the entry of each is called.
ATTRIBUTES = {"ENTRY": "early", "policy": "policy", "Still": "Still", "build": "built"}
UNKNOWN = [
    ("no-such-thing", "coordinated-piecewise"),
    ("no_such_package:ENTRY", "no module 'no_such_package'"),
    ("no-such-file.toml", "cannot read the law file"),
    ("my_entries:nothing", "has no 'nothing'"),
    ("my_entries.early:number", "an Entry, an object with predict"),
    ("my_entries.early", "unknown entry 'my_entries.early'"),
]
WRONG = [
    ({"name": "a", "policy": object()}, "predict"),
    ({"name": "a", "strategy": "mpp"}, "known laws: mppt"),
    ({"name": "a", "action_mode": "both"}, "k, tau, k\\+tau"),
    ({"name": "a", "observation_mode": "all"}, "local, privileged"),
    ({"name": "a", "training_seed": -1}, "training_seed"),
    ({"name": "a", "source": None}, "source"),
    ({"name": "a", "environment": "GFMWTG-14bus-v9"}, "GFMWTG-14bus-v0, GFMWTG-14bus-v1"),
]


@pytest.fixture
def package(tmp_path, monkeypatch):
    folder = tmp_path / "my_entries"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "early.py").write_text(MODULE.format(name="early"))
    monkeypatch.syspath_prepend(tmp_path)
    yield "my_entries"
    for name in [name for name in sys.modules if name.split(".")[0] == "my_entries"]:
        del sys.modules[name]


def test_names_of_the_table_stand_for_baselines_and_for_all_seeds_of_a_policy():
    def found(name: str) -> list[tuple[str, int | None]]:
        return [(entry.name, entry.training_seed) for entry in load_entries(name)]

    assert found("tip-speed-feedback") == [("tip-speed-feedback", None)]
    assert found("linear-feedback") == [("linear-feedback", 0)]
    assert found("PPO (k)") == [("PPO (k)", seed) for seed in range(5)]
    assert found("ppo-k-3") == [("PPO (k)", 3)]
    of_v1 = {"DAgger LSTM": 5, "evolved LSTM": 5, "gradient MLP, exact state": 1, "gradient LSTM": 2, "PPO": 3}
    assert found("policies") == [(name, seed) for name, n_seeds in of_v1.items() for seed in range(n_seeds)]
    of_v0 = {entry.name for entry in load_entries("policies", task=V0)}
    assert of_v0 >= {"linear-feedback", "PPO (k, tau)", "PPO (tau)", "SAC (k, tau)"}


def test_law_and_folder_of_ones_own_are_entries(tmp_path, monkeypatch):
    law_file = write(tmp_path / "mine.toml", "k_min = 1.0\nk_nominal = 0.8\nk_max = 0.6\ntau_s = 0.5\n")
    (entry,) = load_entries(law_file)
    law = TrackingLaw(name="mine", k_min=1.0, k_nominal=0.8, k_max=0.6, damping_time_constant_s=0.5)
    assert (entry.name, entry.law) == ("mine", law)
    shutil.copytree(POLICIES / "ppo-k-2", tmp_path / "ppo-k-3")
    monkeypatch.chdir(tmp_path)
    assert [entry.training_seed for entry in load_entries("ppo-k-3")] == [2]
    with pytest.raises(ValueError, match="did you mean 'ppo-k-3'"):
        load_entries("ppo_k3")


@pytest.mark.parametrize(("attribute", "name"), ATTRIBUTES.items())
def test_attribute_may_be_entry_policy_or_callable(package, attribute, name):
    (entry,) = load_entries(f"{package}.early:{attribute}")
    assert (entry.name, entry.kind) == (name, "learned")
    assert hasattr(entry.policy, "predict")


@pytest.mark.parametrize(("spec", "text"), UNKNOWN)
def test_unknown_entry_names_what_is_allowed(package, spec, text):
    with pytest.raises(ValueError, match=text):
        load_entries(spec)


def test_learner_whose_normalisation_would_be_left_out_is_refused():
    def learner(normalization):
        return SimpleNamespace(predict=lambda *_: None, get_vec_normalize_env=lambda: normalization)

    for harmless in (None, SimpleNamespace(norm_obs=False)):
        Entry(name="a", strategy="mppt", policy=learner(harmless))
    with pytest.raises(ValueError, match="VecNormalize"):
        Entry(name="a", strategy="mppt", policy=learner(SimpleNamespace(norm_obs=True)))


@pytest.mark.parametrize(("arguments", "text"), WRONG)
def test_wrong_entry_says_what_is_allowed(arguments, text):
    with pytest.raises(ValueError, match=text):
        Entry(**arguments)


def test_a_training_seed_of_numpy_is_written_as_any_other():
    one, other = (Entry(name="a", training_seed=seed) for seed in (np.int64(3), 3))
    assert to_json(one.to_dict()) == to_json(other.to_dict())


def test_identity_of_a_law_follows_its_numbers_and_that_of_a_policy_needs_a_fingerprint(package):
    law = LAWS["mppt"]
    other = dataclasses.replace(law, k_max=law.k_max * (1.0 + 1e-15))
    assert Entry(name="another name", strategy=law).identity == Entry(name="mppt", strategy="mppt").identity
    assert Entry(name="mppt", strategy=other).identity != Entry(name="mppt", strategy=law).identity
    (unknown,), (known,) = load_entries(f"{package}.early:policy"), load_entries(f"{package}.early:build")
    assert unknown.identity is None
    assert known.identity not in (None, Entry(name="law").identity)


def test_baselines_are_those_of_the_version_with_every_built_in_strategy_and_module():
    laws = ["mppt", "deloaded-5", "deloaded-10", "coordinated-linear", "coordinated-piecewise"]
    of_v0, of_v1 = (load_entries("baselines", task=version) for version in (V0, V1))
    assert [entry.name for entry in of_v0] == [*laws, "coordinated-undamped", "tip-speed-feedback"]
    assert [e.name for e in of_v1] == [*laws, "coordinated-tuned", "coordinated-free", "fast-droop", "distilled-law"]
    assert {entry.name: entry.law for entry in of_v0[:-1]} == LAWS
    assert [entry.kind for entry in of_v0] == ["law"] * len(LAWS) + ["feedback"]
    environments = {name: load_entries(name)[0].environment for name in ("tip-speed-feedback", "fast-droop", "mppt")}
    assert environments == {"tip-speed-feedback": V0.env_id, "fast-droop": V1.env_id, "mppt": None}
    named = {name for order in baselines.ORDER.values() for name in order if isinstance(name, str)}
    assert named == {path.stem for path in Path(baselines.__file__).parent.glob("[a-z]*.py")}


def test_trained_policy_modulates_the_law_that_its_file_names(tmp_path):
    shutil.copytree(POLICIES / "ppo-k-2", tmp_path / "mine")
    (own,) = load_entries(tmp_path / "mine")
    assert (own.strategy, own.environment) == (REFERENCE_LAW, V0.env_id)
    file = tmp_path / "mine" / "entry.toml"
    write(file, file.read_text().replace('environment = "GFMWTG-14bus-v0"\n', 'strategy = "deloaded-5"\n'))
    (entry,) = load_entries(tmp_path / "mine")
    assert entry.law == get_law("deloaded-5") and entry.environment == V1.env_id


def test_name_of_an_anchor_of_any_version_is_reserved():
    for name in {*V0.anchors, *V1.anchors}:
        check_entries([Entry(name=name, strategy=name)])
        with pytest.raises(ValueError, match=f"the name '{name}' is reserved"):
            check_entries([Entry(name=name, strategy="deloaded-5")])


def test_feedback_rests_where_the_turbine_captures_what_is_asked():
    policy = TipSpeedFeedback(gain=1.0)
    best, limit = tracking_point(0.0).tip_speed_ratio, tracking_point(0.1).tip_speed_ratio
    for deviation_hz, deloading in ((-0.4, 0.0), (0.0, 0.05), (0.4, 0.1), (-0.2, 0.025), (-1.0, 0.0)):
        observation = np.zeros((1, 18))
        for group in (0, 9):
            ratio = tracking_point(deloading).tip_speed_ratio
            observation[0, group] = deviation_hz / 0.5
            observation[0, group + 2] = (ratio - best) / (limit - best)
        action, _ = policy.predict(observation)
        assert np.abs(action).max() < 1e-3
        # A rotor that is too fast gives more power.
        observation[0, [2, 11]] += 0.1
        assert policy.predict(observation)[0] == pytest.approx(np.full((1, 2), 0.1), abs=1e-3)


def test_fast_droop_is_one_gain_of_each_groups_own_measured_frequency():
    observation = np.random.default_rng(0).normal(size=(1, 28))
    deviations_hz = np.array([-0.3, 0.1, 0.0, 2.0])
    observation[0, ::7] = deviations_hz / 0.5
    action, _ = FastDroop().predict(observation)
    assert action == pytest.approx(np.array([[1.0, -0.4, 0.0, -1.0]]))


def test_the_distilled_law_adds_its_terms_and_filters_them():
    observation = np.random.default_rng(0).normal(size=(1, 28))
    observation[0, ::7] = deviations_hz = np.array([-0.3, 0.1, 0.0, -0.2])
    observation[0, ::7] /= 0.5
    speeds_pu, winds_m_s = np.array([0.97, 0.77, 0.67, 0.57]), np.array([8.0, 10.0, 12.0, 7.0])
    observation[0, 3::7], observation[0, 5::7] = (speeds_pu - 1.0) / 0.25, (winds_m_s - 10.0) / 5.0
    policy = DistilledLaw(Gains(offset=0.1, frequency=1.0, filtered_frequency=-0.5, speed=-0.4, wind=0.05))
    actions, state = policy.predict(observation, episode_start=np.array([True]))
    parts = np.array([np.full(4, -0.1), speeds_pu - 1.0, winds_m_s - 10.0])
    assert deviations_hz.mean() == pytest.approx(-0.1) and np.allclose(state[0].T, parts)
    weights = np.array([-0.5, -0.4, 0.05])
    assert actions[0] == pytest.approx(0.1 - 0.1 + weights @ parts)
    observation[0, ::7], observation[0, 3::7], observation[0, 5::7] = 0.0, 0.0, 0.0
    actions, state = policy.predict(observation, state, np.array([False]))
    parts *= np.exp(-0.5 / np.array([[15.0], [15.0], [40.0]]))
    assert np.allclose(state[0].T, parts) and actions[0] == pytest.approx(0.1 + weights @ parts)
    assert policy.predict(observation, state, np.array([True]))[1] == pytest.approx(np.zeros((1, 4, 3)))
    several = DistilledLaw(np.array([policy.gains, np.zeros(5)])[:, np.newaxis, np.newaxis])
    seen = of_groups(np.repeat(observation[np.newaxis], 2, axis=0), MeasuredObservation, "k")
    one = policy.act(of_groups(observation, MeasuredObservation, "k"))[0]
    assert several.act(seen)[0] == pytest.approx(np.array([one, np.zeros((1, 4))]))
