"""`python -m agents.tune`: searches hyperparameters with Optuna; the objective is the validation score."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import optuna
import yaml
from optuna.trial import Trial, TrialState

from agents.command import Parser, given_options, note, options_named, run_command
from agents.hyperparameters import ALGORITHMS
from agents.runs import Run, RunSettings
from agents.train import add_sb3_options, sb3_settings, train
from wtg_gym.files import to_json, write_atomically
from wtg_gym.scenarios import get_suite

STUDY_FILE, BEST_FILE = "study.sqlite3", "best.yml"
#: So many trials run to their end before any is compared with the others' median, and so many others must have been
#: validated after as many intervals.
_TRIALS_BEFORE_PRUNING, _TRIALS_IN_MEDIAN = 5, 3

_DESCRIPTION = """\
Searches hyperparameters: every trial is a short training run, judged by the benchmark's score on validation scenarios
and stopped early where it falls behind the median of the others. Every finished trial is kept in study.sqlite3: the
same command goes on after an interruption, with the interrupted trial first. best.yml is a file for --config; the score
in it is the best of all trials on the scenarios that chose it, and thus optimistic. One process per folder."""
_EXAMPLES = """\
examples:
  python -m agents.tune --algo ppo --timesteps 1000000 --trials 50 --output runs/tune-ppo
  python -m agents.train --algo ppo --config runs/tune-ppo/best.yml --output runs/ppo-tuned"""

Values = dict[str, Any]


def space(algo: str, trial: Trial, n_envs: int) -> Values:
    """Return the values that a trial tries in place of those of the configuration file."""
    values: Values = {
        "learning_rate": trial.suggest_float("learning_rate", 5e-5, 3e-3, log=True),
        "gamma": trial.suggest_categorical("gamma", (0.98, 0.99, 0.995, 0.998)),
    }
    n = int(trial.suggest_categorical("width", (32, 64, 128)))
    if algo in ("ppo", "recurrent_ppo"):
        n_steps = int(trial.suggest_categorical("n_steps", (128, 304, 600)))
        log_std = trial.suggest_float("log_std_init", -3.5, -1.0)
        nets = {
            "ppo": f"activation_fn=nn.Tanh, net_arch=dict(pi=[{n}, {n}], vf=[{n}, {n}])",
            "recurrent_ppo": f"lstm_hidden_size={n}, net_arch=dict(pi=[{n}], vf=[{n}])",
        }
        return {
            **values,
            "n_steps": n_steps,
            "batch_size": n_steps * n_envs // int(trial.suggest_categorical("n_minibatches", (2, 4, 8))),
            "n_epochs": trial.suggest_int("n_epochs", 3, 10),
            "gae_lambda": trial.suggest_categorical("gae_lambda", (0.95, 0.98, 0.99, 1.0)),
            "clip_range": trial.suggest_categorical("clip_range", (0.1, 0.2, 0.3)),
            "ent_coef": trial.suggest_float("ent_coef", 1e-6, 1e-2, log=True),
            "policy_kwargs": f"dict(log_std_init={log_std:.3f}, {nets[algo]})",
        }
    values |= {
        "batch_size": trial.suggest_categorical("batch_size", (128, 256, 512)),
        "gradient_steps": max(1, round(n_envs * trial.suggest_categorical("updates_per_step", (0.125, 0.25, 0.5)))),
        "n_steps": trial.suggest_categorical("n_steps", (1, 10, 30, 60)),
        "tau": trial.suggest_categorical("tau", (0.002, 0.005, 0.01, 0.02)),
        "policy_kwargs": f"dict(net_arch=dict(pi=[{n}, {n}], qf=[{2 * n}, {2 * n}]))",
    }
    if algo == "td3":
        return {**values, "noise_std": trial.suggest_float("noise_std", 0.02, 0.3, log=True)}
    return {**values, "ent_coef": trial.suggest_categorical("ent_coef", ("auto_0.01", "auto_0.05", "auto_0.2"))}


def search(settings: RunSettings, n_trials: int, folder: Path) -> optuna.Study:
    """Bring a study to a number of trials, the ones before an interruption included.

    Returns:
        the study; best.yml has its best hyperparameters.

    Raises:
        ValueError: the folder holds a study with other settings.
    """
    folder.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        study_name="study",
        storage=f"sqlite:///{(folder / STUDY_FILE).absolute()}",
        direction="maximize",
        sampler=optuna.samplers.TPESampler(seed=settings.seed),
        pruner=_pruner(settings),
        load_if_exists=True,
    )
    text = to_json(dataclasses.asdict(settings))
    if study.user_attrs.setdefault("settings", text) != text:
        raise ValueError(f"{folder} holds a study with other settings:\n{study.user_attrs['settings']}")
    study.set_user_attr("settings", text)
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)
        study.enqueue_trial(trial.params)
    left = n_trials - len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED)))

    def after_trial(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        value = f"score {trial.value:.1f}" if trial.value is not None else ""
        note(f"trial {trial.number}: {trial.state.name.lower()} {value}")
        _write_best(study, settings, folder)

    # A learner that diverges raises a ValueError: that trial has failed, the others go on.
    study.optimize(
        lambda trial: _objective(trial, settings), n_trials=max(0, left), catch=(ValueError,), callbacks=[after_trial]
    )
    return study


def _pruner(settings: RunSettings) -> optuna.pruners.BasePruner:
    # Its steps are the intervals that are over: rollouts are of unequal length, and timesteps would rarely be the same.
    return optuna.pruners.MedianPruner(
        _TRIALS_BEFORE_PRUNING,
        n_warmup_steps=settings.timesteps // 4 // settings.interval,
        n_min_trials=_TRIALS_IN_MEDIAN,
    )


def _hyperparameters(trial: Trial, settings: RunSettings) -> Values:
    """Return the hyperparameters of a trial: a schedule of the file remains one, the lengths are the trial's."""
    values = dict(settings.hyperparameters)
    for key, value in space(settings.algo, trial, settings.n_envs).items():
        falls = str(values.get(key)).startswith("lin_")
        values[key] = f"lin_{value}" if falls else value
    return {**values, "n_envs": settings.n_envs, "n_timesteps": settings.timesteps}


def _objective(trial: Trial, settings: RunSettings) -> float:
    """Train once and return the last validation score."""
    hyperparameters = _hyperparameters(trial, settings)
    run = Run.new(dataclasses.replace(settings, hyperparameters=hyperparameters))
    reported = set[int]()

    def report(timesteps: int, score: float) -> None:
        n_intervals = timesteps // settings.interval
        if n_intervals in reported:
            # The last validation of all, within an interval that already has one: there is nothing left to prune.
            return
        reported.add(n_intervals)
        trial.report(score, n_intervals)
        if trial.should_prune():
            raise optuna.TrialPruned

    train(run, on_score=report)
    trial.set_user_attr("hyperparameters", hyperparameters)
    return run.curve[-1]["score"]


def _write_best(study: optuna.Study, settings: RunSettings, folder: Path) -> None:
    complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    if complete:
        best = study.best_trial
        head = (
            f"# {settings.algo}: trial {best.number} of the study here. Its validation score, {best.value:.2f},\n"
            f"# is the largest of {len(complete)} trials on the scenarios that chose it, and thus optimistic.\n"
        )
        content = yaml.safe_dump(
            {get_suite(settings.suite).benchmark.env_id: best.user_attrs["hyperparameters"]}, sort_keys=True
        )
        write_atomically(folder / BEST_FILE, head + content)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.tune", description=_DESCRIPTION, epilog=_EXAMPLES)
    add_sb3_options(parser, tuple(ALGORITHMS))
    parser.add_argument("--trials", type=int, default=30, metavar="N", help="trials in all (default: 30)")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="folder of the study")

    def work() -> None:
        given = given_options(parser.parse_args(argv))
        if given["trials"] < 1:
            raise ValueError(f"--trials must be 1 or more, got {given['trials']}")
        folder = Path(given["output"])
        with options_named(given):
            settings = sb3_settings(given)
        study = search(settings, given["trials"], folder)
        n_complete = len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)))
        note(f"{n_complete} of {len(study.trials)} trials complete; wrote {folder / BEST_FILE}")

    return run_command(work, "the same command goes on")


if __name__ == "__main__":
    sys.exit(main())
