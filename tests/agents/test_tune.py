"""Facts about the search for hyperparameters."""

from __future__ import annotations

from pathlib import Path

import optuna
import pytest
from optuna.trial import FixedTrial, TrialState

from agents.hyperparameters import ALGORITHMS, CONFIG_FOLDER, parse, read_config
from agents.train import main as train
from agents.tune import SPACES, main
from tests.agents.small import config_file

LENGTH = ["--timesteps", "512", "--n-envs", "16", "--interval", "256", "--validation-episodes", "2"]


def options(folder: Path) -> list[str]:
    return ["--algo", "ppo", "--config", config_file(folder, "ppo"), *LENGTH, "--output", str(folder / "study")]


def study(folder: Path) -> optuna.Study:
    return optuna.load_study(study_name="study", storage=f"sqlite:///{folder / 'study' / 'study.sqlite3'}")


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_search_space_gives_hyperparameters_that_the_algorithm_takes(algo: str) -> None:
    raw = read_config(CONFIG_FOLDER / f"{algo}.yml")
    for seed in range(3):
        trial = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed)).ask()
        parse(algo, {**raw, **SPACES[algo](trial, 64)})
        assert SPACES[algo](FixedTrial(trial.params), 64) == SPACES[algo](trial, 64)


def test_study_goes_on_and_repeats_what_was_interrupted(tmp_path: Path) -> None:
    assert main([*options(tmp_path), "--trials", "1"]) == 0
    interrupted = study(tmp_path).ask()
    SPACES["ppo"](interrupted, 16)
    assert main([*options(tmp_path), "--trials", "2"]) == 0
    trials = study(tmp_path).trials
    assert [trial.state for trial in trials] == [TrialState.COMPLETE, TrialState.FAIL, TrialState.COMPLETE]
    assert trials[2].params == trials[1].params
    assert min(trials[0].intermediate_values) == 0 and max(trials[0].intermediate_values) >= 512
    best = tmp_path / "study" / "best.yml"
    assert read_config(best)["learning_rate"] == study(tmp_path).best_trial.params["learning_rate"]
    assert train(["--algo", "ppo", "--config", str(best), *LENGTH, "--output", str(tmp_path / "run")]) == 0


def test_folder_of_another_study_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*options(tmp_path), "--trials", "1"]) == 0
    assert main([*options(tmp_path), "--trials", "1", "--seed", "1"]) == 2
    assert "holds a study with other settings" in capsys.readouterr().err
    assert main([*options(tmp_path), "--trials", "0"]) == 2
    assert "--trials must be 1 or more" in capsys.readouterr().err
