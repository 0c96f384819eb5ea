"""Facts about training with RLlib. Those that need Ray are skipped where it is not installed: `make test-rllib`."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.export import export
from agents.folders import folders
from agents.rllib.__main__ import main
from agents.rllib.runner_envs import CLIP, RunnerEnvs, measure_scales
from agents.runs import Run, RunSettings
from tests.interruption import end
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.evaluation import load_entries

ROOT = Path(__file__).resolve().parents[2]
SMALL = ["--suite", "standard", "--num-env-runners", "1", "--envs-per-runner", "4"]
SMALL += ["--timesteps", "6000", "--interval", "1200", "--validation-episodes", "2"]


def test_lanes_start_spread_none_is_over_and_the_reward_is_the_gain_over_the_reference() -> None:
    env = RunnerEnvs(8, version="v0", duration_s=4.0, n_threads=1)
    env.reset(seed=3)
    assert sorted(env.env.lanes.n_steps().tolist()) == [0, 5, 10, 15, 20, 25, 30, 35]
    assert not np.any(env.env.lanes.ended())
    for _ in range(45):
        _, rewards, *_ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        assert rewards.tolist() == [0.0] * 8
    env.close()


def test_runners_play_different_scenarios() -> None:
    # RLlib gives neighbouring runners neighbouring seeds; the native environment gives neighbouring lanes those.
    played, shared = [], []
    for seed in (1, 2):
        env, native = (kind(16, duration_s=2.0, n_threads=1) for kind in (RunnerEnvs, GFMWTGVectorEnv))
        env.reset(seed=seed)
        native.reset(seed=seed)
        played.append(set(env.unwrapped.lanes.scenario_seeds.tolist()))
        shared.append(set(native.lanes.scenario_seeds.tolist()))
        env.close()
        native.close()
    assert len(shared[0] & shared[1]) == 15 and not played[0] & played[1]


def test_scales_are_reproducible_and_runners_show_scaled_observations() -> None:
    one, two = (measure_scales({"duration_s": 3.0}, noise=0.3, gamma=0.9, seed=1) for _ in range(2))
    assert one == two and one.reward > 0.0 and min(one.std) > 0.0
    plain, scaled = (RunnerEnvs(4, duration_s=2.0, n_threads=1, scales=scales) for scales in (None, one))
    seen, shown = (env.reset(seed=0)[0] for env in (plain, scaled))
    expected = np.clip((seen - one.mean) / one.std, -CLIP, CLIP)
    assert shown == pytest.approx(expected, abs=1e-6) and scaled.observation_space.contains(shown)
    for env in (plain, scaled):
        env.close()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--output", "new", "--num-env-runners", "0"], "num_env_runners must be 1 or more, got 0"),
        (["--resume", "other", "--num-learners", "1"], "leave out --num-learners"),
        (["--resume", "other"], "a run of ppo"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(
    arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = RunSettings(algo="ppo", hyperparameters={}, suite="standard", timesteps=1, n_envs=1, interval=1)
    Run.new(settings).write(tmp_path / "other")
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and text in error
    assert not (tmp_path / "new").exists()


def test_missing_ray_is_one_line_that_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    assert main(["--output", str(tmp_path / "new")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "ray is needed" in error and ".[rllib]" in error
    assert not (tmp_path / "new" / "run.json").exists()


def needs_ray() -> None:
    pytest.importorskip("ray", reason="Ray is not installed here; make test-rllib runs this in an environment with it")


def test_killed_run_goes_on_from_its_checkpoint_and_its_export_plays_without_ray(tmp_path: Path) -> None:
    needs_ray()
    folder, program = tmp_path / "run", [sys.executable, "-m", "agents.rllib"]
    process = subprocess.Popen([*program, *SMALL, "--output", str(folder)], cwd=ROOT)
    end(process, signal.SIGKILL, lambda: any(int(path.name) > 0 for path in folders(folder / "checkpoints")))
    assert process.returncode == -signal.SIGKILL
    rows = Run.read(folder).curve
    reached = int(folders(folder / "checkpoints")[-1].name)
    subprocess.run([*program, "--resume", str(folder)], cwd=ROOT, check=True)

    run = Run.read(folder)
    steps = [row["timesteps"] for row in run.curve]
    assert run.finished and len(run.resumptions) == 1
    assert steps[0] == 0 and 0 < reached < steps[-1] and steps[-1] >= 6000
    assert steps == sorted(set(steps)) and len(steps) >= 5
    # Validated again where the kill came between checkpoint and row; otherwise kept.
    assert [row for row in run.curve if row["timesteps"] < reached] == [r for r in rows if r["timesteps"] < reached]

    entry = tmp_path / "entry"
    code = f"""import sys; sys.modules.update(ray=None, stable_baselines3=None, sb3_contrib=None)
from pathlib import Path; from agents.export import export
export(Path({str(folder)!r}), Path({str(entry)!r}), name='mine')"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
    (loaded,) = load_entries(entry)
    assert (loaded.name, loaded.kind, loaded.training_seed) == ("mine", "learned", 0)


def test_learner_of_its_own_and_an_other_action_mode(tmp_path: Path) -> None:
    needs_ray()
    arguments = [*SMALL, "--timesteps", "1200", "--num-learners", "1", "--action-mode", "k"]
    assert main([*arguments, "--output", str(tmp_path / "run")]) == 0
    run = Run.read(tmp_path / "run")
    assert run.finished and run.settings.hyperparameters["num_learners"] == 1
    export(tmp_path / "run", tmp_path / "entry")
    assert len(load_entries(tmp_path / "entry")) == 1


def test_cluster_that_does_not_answer_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    needs_ray()
    assert main([*SMALL, "--address", "auto", "--output", str(tmp_path / "run")]) == 2
    assert "error: Could not find any running Ray instance" in capfd.readouterr().err
