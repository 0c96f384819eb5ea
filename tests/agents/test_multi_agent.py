"""Facts about training one policy that every WTG group plays by itself."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.export import export, largest_difference
from agents.export import main as export_command
from agents.folders import folders
from agents.multi_agent import ALGORITHMS, AgentVecEnv, CentralCriticPolicy, SharedPolicy, training_env
from agents.onnx_graph import PolicyNetwork, to_onnx
from agents.runs import Run, RunSettings
from agents.train import main as train_command
from agents.train import start
from agents.vec_env import GainVecEnv
from tests.agents.small import CONFIGS, V0, config_file, stopped_after
from wtg_gym.evaluation import Entry, OnnxPolicy, evaluate, load_entries
from wtg_gym.policies.gate import check_submission
from wtg_gym.policies.load import POLICY_FILE
from wtg_gym.policies.sb3_archive import load_archive

SHORT: dict[str, Any] = {"version": "v0", "duration_s": 5.0, "strategy": "mppt"}
NO_DELAY = '{"delay_s": [0, 0]}'


def options(folder: Path, algorithm: str, *others: str) -> list[str]:
    """Return the options of a small run that validates after every 256 of its 768 steps."""
    given = [*V0, "--algo", algorithm, "--config", config_file(folder, "ppo")]
    return [*given, "--interval", "256", "--validation-episodes", "2", *others]


@pytest.fixture(scope="module", params=ALGORITHMS)
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, short_validations: None) -> Path:
    """A finished run that tests read only."""
    folder = tmp_path_factory.mktemp("runs")
    assert train_command([*options(folder, request.param), "--output", str(folder / "whole")]) == 0
    return folder / "whole"


def weights(folder: Path) -> dict[str, torch.Tensor]:
    (path,) = folders(folder / "checkpoints")
    found: dict[str, torch.Tensor] = PPO.load(path / "model.zip").policy.state_dict()
    return found


@pytest.mark.parametrize("central_critic", [False, True])
def test_lanes_are_the_groups_of_the_episodes(central_critic: bool) -> None:
    arguments = {**SHORT, "observation_mode": "privileged" if central_critic else "local", "groups": 3}
    episodes, groups = (
        GainVecEnv(2, **arguments),
        AgentVecEnv(GainVecEnv(2, **arguments), central_critic=central_critic),
    )
    for env in (episodes, groups):
        env.seed(3)
    seen, split = episodes.reset(), groups.reset()
    names = groups.get_attr("observation_names")[0]
    # What a group measures, its last actions, and its size.
    assert (groups.num_envs, groups.n_wtg, groups.n_actor) == (6, 3, 11)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(60):
        for lane in range(6):
            episode, group = divmod(lane, 3)
            own = [index for index, name in enumerate(names) if name.startswith(f"wtg{group}.")]
            expected = [*seen[episode, own], 1.0, *(seen[episode] if central_critic else [])]
            assert split[lane].tolist() == expected and groups.observation_space.contains(split[lane])
        actions = rng.uniform(-1.0, 1.0, (6, 2)).astype(np.float32)
        seen, gains, dones, infos = episodes.step(actions.reshape(2, 6))
        split, each, ended, own_infos = groups.step(actions)
        assert each.tolist() == np.repeat(gains, 3).tolist() and ended.tolist() == np.repeat(dones, 3).tolist()
        for lane in np.flatnonzero(ended):
            episode, group = divmod(int(lane), 3)
            ends += 1
            last, own_last = (
                info.pop("terminal_observation") for info in (dict(infos[episode]), dict(own_infos[lane]))
            )
            assert own_last[:10].tolist() == last[10 * group : 10 * group + 10].tolist()
            assert own_last[11:].tolist() == (last.tolist() if central_critic else [])
            assert own_infos[lane]["metrics"] == infos[episode]["metrics"]
            assert own_infos[lane]["TimeLimit.truncated"] == infos[episode]["TimeLimit.truncated"]
    assert ends >= 6
    copy = pickle.loads(pickle.dumps(groups))
    one, two = (env.step(np.zeros((6, 2), dtype=np.float32)) for env in (groups, copy))
    assert all(a.tolist() == b.tolist() for a, b in zip(one[:3], two[:3], strict=True))


def test_interrupted_run_goes_on_to_the_same_weights(whole: Path, tmp_path: Path) -> None:
    stopped = stopped_after(256, whole, tmp_path / "stopped")
    assert train_command(["--resume", str(stopped)]) == 0
    ours, theirs = weights(stopped), weights(whole)
    assert ours.keys() == theirs.keys() and all(torch.equal(ours[key], theirs[key]) for key in ours)


def test_export_plays_as_the_learner_and_passes_the_gate(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = Run.read(whole).settings.algo
    command = [str(whole), "--output", str(tmp_path / "entry"), "--name", name, "--authors", "A. Author"]
    assert export_command(command) == 0
    assert "its actions agree to" in capsys.readouterr().err
    report = check_submission(tmp_path / "entry")
    assert report.accepted, [check for check in report.checks if check.verdict != "passed"]
    # The run's own folder is an entry too, of the same file, and no pickle has to be trusted.
    (best,) = folders(whole / "best")
    assert (best / POLICY_FILE).read_bytes() == (tmp_path / "entry" / POLICY_FILE).read_bytes()
    (entry,) = load_entries(best)
    results = evaluate([entry], "standard", "validation", seeds=[10_000, 10_001], duration_s=6.0)
    run = Run.read(whole)
    row = next(row for row in run.curve if row["timesteps"] == int(best.name))
    assert results.scores[entry.name].value == pytest.approx(row["score"], abs=1e-3)


def test_every_group_acts_by_what_it_sees_itself_and_in_any_number() -> None:
    torch.manual_seed(0)
    layers = [torch.nn.Linear(10, 8), torch.nn.Tanh(), torch.nn.Linear(8, 2)]
    rng = np.random.default_rng(0)
    for n in (1, 2, 5):
        sizes = rng.uniform(0.5, 2.0, n).astype(np.float32)
        content = to_onnx(PolicyNetwork(10, None, None, layers, sizes=sizes))
        observations = rng.normal(size=(3, 9 * n)).astype(np.float32)
        with torch.no_grad():
            measured = torch.from_numpy(observations.reshape(-1, 9))
            own = torch.cat([measured, torch.from_numpy(np.tile(sizes, 3))[:, None]], dim=1)
            expected = torch.nn.Sequential(*layers)(own).clamp(-1.0, 1.0).reshape(3, 2 * n)
        assert played(content, observations) == pytest.approx(expected.numpy(), abs=1e-6)


def played(content: bytes, observations: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(content)
    (actions,) = session.run(None, {"observation": observations})
    return actions


def test_group_sees_its_turbines_as_a_multiple_of_their_mean() -> None:
    arguments: dict[str, Any] = {"suite": "standard-v1", "strategy": "coordinated-tuned", "duration_s": 5.0}
    groups = AgentVecEnv(GainVecEnv(2, **arguments), central_critic=False)
    turbines = np.array([20.0, 14.0, 10.0, 8.0])
    assert groups.reset()[:, -1].tolist() == pytest.approx(np.tile(turbines / turbines.mean(), 2).tolist())
    groups.close()


def test_value_function_sees_the_grid_and_the_policy_its_own_group_alone() -> None:
    raw = CONFIGS["ppo"]
    settings = RunSettings(algo="mappo", hyperparameters=raw, suite="standard", timesteps=64, n_envs=8, interval=64)
    model = start(Run.new(settings))
    policy = model.policy
    assert isinstance(policy, CentralCriticPolicy) and isinstance(policy, ActorCriticPolicy) and policy.n_actor == 11
    observations = torch.rand(1, *policy.observation_space.shape, requires_grad=True)
    for value, seen in ((policy.get_distribution(observations).distribution.mean, 11), (None, observations.shape[1])):
        value = policy.predict_values(observations) if value is None else value
        (slope,) = torch.autograd.grad(value.sum(), observations)
        assert (slope[0, :seen] != 0.0).any() and not slope[0, seen:].any()
    (slope,) = torch.autograd.grad(policy.predict_values(observations).sum(), observations)
    assert (slope[0, 11:] != 0.0).all()
    model.get_env().close()


def test_run_with_other_groups_is_validated_with_them_and_is_an_entry_of_its_suite(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = ["--groups", "3", "--n-envs", "12", "--timesteps", "96"]
    single = [*V0, "--algo", "ppo", "--config", config_file(tmp_path, "ppo"), "--validation-episodes", "2"]
    assert train_command([*options(tmp_path, "ippo", *changed), "--output", str(tmp_path / "many")]) == 0
    assert train_command([*single, *changed, "--output", str(tmp_path / "one")]) == 0
    many, one = (Run.read(tmp_path / name) for name in ("many", "one"))
    assert many.settings.plant_arguments == one.settings.plant_arguments == {"groups": 3}
    # The actor of many agents does not know how many they are.
    assert export(tmp_path / "many", tmp_path / "entry") <= 1e-6
    assert OnnxPolicy(tmp_path / "entry" / POLICY_FILE).widths[:2] == (20, 4)
    capsys.readouterr()
    assert export_command([str(tmp_path / "one"), "--output", str(tmp_path / "other")]) == 2
    assert "acts for 3 WTG groups, suite 'standard' has 2" in capsys.readouterr().err


def test_run_with_other_sensors_is_validated_with_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = tmp_path / "v1.yml"
    config.write_text(Path(config_file(tmp_path, "ppo")).read_text().replace("v0", "v1"))
    suite = ["--suite", "standard-v1", "--config", str(config), "--timesteps", "128", "--validation-episodes", "2"]
    asked: list[dict[str, Any]] = []

    def listen(*arguments: Any, **keywords: Any) -> Any:
        asked.append(keywords)
        return evaluate(*arguments, **keywords, duration_s=6.0)

    monkeypatch.setattr("agents.runs.evaluate", listen)
    given = [*suite, "--sensors", NO_DELAY, "--output", str(tmp_path / "run")]
    assert train_command(["--algo", "ippo", *given]) == 0
    assert asked and all(keywords["sensors"] == {"delay_s": [0, 0]} for keywords in asked)
    settings = Run.read(tmp_path / "run").settings
    assert training_env(settings).venv.vector_env.settings.sensor_distribution().delay_s == (0.0, 0.0)


def test_policy_of_two_groups_plays_in_a_grid_with_three(whole: Path) -> None:
    settings = Run.read(whole).settings
    (best,) = folders(whole / "best")
    policy, _ = load_archive(best / "learner", "PPO")
    two, three = (SharedPolicy(policy, np.ones(n, dtype=np.float32)) for n in (2, 3))
    assert largest_difference(two, OnnxPolicy(best / POLICY_FILE), settings) <= 1e-6
    entry = Entry(name="shared", policy=three)
    results = evaluate([entry], "standard", "validation", seeds=[10_000], duration_s=6.0, groups=3)
    assert len(results.episodes_of("shared")) == 1


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--output", "new"], "--algo is needed: ppo, sac, td3, tqc, recurrent_ppo, ippo, mappo"),
        (["--algo", "qmix", "--output", "new"], "invalid choice"),
        (["--algo", "ippo"], "--output FOLDER is needed"),
        (
            [*V0, "--algo", "ippo", "--n-envs", "7", "--output", "new"],
            "--n-envs must be a whole multiple of the 2 WTG groups, got 7",
        ),
        (["--algo", "mappo", "--observation-mode", "privileged", "--output", "new"], "leave out --observation-mode"),
        (["--algo", "ippo", "--groups", "0", "--output", "new"], "group"),
        ([*V0, "--algo", "ippo", "--sensors", "exact", "--output", "new"], "sensors are part of version v1 and later"),
        (["--algo", "ippo", "--suite", "standard-v1", "--sensors", "{}x", "--output", "new"], "sensors must be"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(
    arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert train_command(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert text in error, error
    assert not (tmp_path / "new").exists()
