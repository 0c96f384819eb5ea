# /// script
# requires-python = ">=3.11"
# dependencies = ["optuna==5.0.0"]
# ///
import numpy as np
import optuna

from wtg_gym import Entry, evaluate


class Droop:
    def __init__(self, gain: float) -> None:
        self.gain = gain

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.clip(-self.gain * observation[:, [0, 7, 14, 21]], -1.0, 1.0), None


def score(trial: optuna.Trial) -> float:
    droop = Entry(name="droop", policy=Droop(trial.suggest_float("gain", 0.0, 2.0)), action_mode="k")
    return evaluate(droop, "standard-v1", seeds=range(10_000, 10_010)).scores["droop"].value


study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=0))
study.optimize(score, n_trials=5)
print(f"gain {study.best_params['gain']:.2f}: score {study.best_value:.1f}")
