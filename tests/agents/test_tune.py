"""Facts about the search for hyperparameters."""

from __future__ import annotations

from pathlib import Path

import optuna
import pytest
from optuna.trial import FixedTrial, TrialState

from agents import tune
from agents.hyperparameters import ALGORITHMS, CONFIG_FOLDER, parse, read_config
from agents.runs import Run, RunSettings
from agents.train import OnScore
from agents.train import main as train
from agents.tune import main, space
from tests.agents.small import ENV_ID, V0, config_file

LENGTH = ["--timesteps", "512", "--n-envs", "2", "--interval", "256", "--validation-episodes", "2"]


def options(folder: Path) -> list[str]:
    config = config_file(folder, "ppo", learning_rate="lin_0.001", n_envs=4)
    return [*V0, "--algo", "ppo", "--config", config, *LENGTH, "--output", str(folder / "study")]


def study(folder: Path) -> optuna.Study:
    return optuna.load_study(study_name="study", storage=f"sqlite:///{folder / 'study' / 'study.sqlite3'}")


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_search_space_gives_hyperparameters_that_the_algorithm_takes(algo: str) -> None:
    raw = read_config(CONFIG_FOLDER / f"{algo}.yml", ENV_ID)
    for seed in range(3):
        trial = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed)).ask()
        parse(algo, {**raw, **space(algo, trial, 64)})
        assert space(algo, FixedTrial(trial.params), 64) == space(algo, trial, 64)


def test_study_goes_on_and_repeats_what_was_interrupted(tmp_path: Path) -> None:
    assert main([*options(tmp_path), "--trials", "1"]) == 0
    interrupted = study(tmp_path).ask()
    space("ppo", interrupted, 2)
    assert main([*options(tmp_path), "--trials", "2"]) == 0
    trials = study(tmp_path).trials
    assert [trial.state for trial in trials] == [TrialState.COMPLETE, TrialState.FAIL, TrialState.COMPLETE]
    assert trials[2].params == trials[1].params
    # Intervals, not timesteps.
    assert min(trials[0].intermediate_values) == 0 and 2 <= max(trials[0].intermediate_values) <= 600 * 2 // 256 + 1
    best = tmp_path / "study" / "best.yml"
    assert "# is the largest of 2 trials on the scenarios that chose it" in best.read_text()
    found = read_config(best, ENV_ID)
    assert found["learning_rate"] == f"lin_{study(tmp_path).best_trial.params['learning_rate']}"
    assert (found["n_envs"], found["n_timesteps"]) == (2, 512)
    assert train([*V0, "--algo", "ppo", "--config", str(best), *LENGTH, "--output", str(tmp_path / "run")]) == 0


def test_trials_of_unequal_rollouts_are_compared() -> None:
    hyperparameters = read_config(CONFIG_FOLDER / "ppo.yml", ENV_ID)
    settings = RunSettings(
        algo="ppo", hyperparameters=hyperparameters, suite="standard", timesteps=1000, n_envs=2, interval=50
    )
    study = optuna.create_study(direction="maximize", pruner=tune._pruner(settings))

    def play(length: int, score: float, monkeypatch: pytest.MonkeyPatch) -> TrialState:
        """Validate after every interval, at the end of a rollout of this length."""

        def train(run: Run, on_score: OnScore) -> None:
            for timesteps in range(0, 1001, length):
                if timesteps // 50 > (timesteps - length) // 50:
                    on_score(timesteps, score)
            run.curve.append({"score": score})

        monkeypatch.setattr(tune, "train", train)
        study.optimize(lambda trial: tune._objective(trial, settings), n_trials=1)
        return study.trials[-1].state

    with pytest.MonkeyPatch.context() as patch:
        states = [play(length, 100.0, patch) for length in (7, 11, 13, 17, 19)]
        assert states == [TrialState.COMPLETE] * 5
        assert play(23, 90.0, patch) == TrialState.PRUNED
    # Not before a quarter of the run.
    assert max(study.trials[-1].intermediate_values) == 1000 // 4 // 50


def test_folder_of_another_study_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*options(tmp_path), "--trials", "1"]) == 0
    assert main([*options(tmp_path), "--trials", "1", "--seed", "1"]) == 2
    assert "holds a study with other settings" in capsys.readouterr().err
    assert main([*options(tmp_path), "--trials", "0"]) == 2
    assert "--trials must be 1 or more" in capsys.readouterr().err
