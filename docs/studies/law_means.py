"""Mean gains of the control variates over the distribution of every suite of v1, which scores are adjusted by.

    python docs/studies/law_means.py [SUITE …] [--fresh N]

plays the laws of `Task.variates` and the one that scores 100 on the last 24,000 training scenarios of each suite
(default: all drawn suites of v1), one process per processor, and writes wtg_gym/evaluation/law_means.json. Means of
suites that are not named stay, where their laws are the same. With `--fresh` it plays the N scenarios before those, and
prints how many standard errors their means are away from the stored ones.
"""

import argparse
import itertools
import json
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import evaluate
from wtg_gym.evaluation.adjusted import LAW_MEANS, settings_hash
from wtg_gym.evaluation.evaluator import shared_settings
from wtg_gym.evaluation.score import gains
from wtg_gym.evaluation.summary import pinned_costs
from wtg_gym.files import to_json, write_atomically
from wtg_gym.scenarios import SUITES, get_suite
from wtg_gym.tasks import V1

N_SCENARIOS, _AT_ONCE = 24_000, 600  # of a suite, and of a process at a time


def gains_of(name, seeds):
    """Return the gains of the variates over the law that scores 100, (n_scenarios, n_laws)."""
    suite = get_suite(name)
    results = evaluate(suite.task.hundred, name, "train", seeds=seeds, n_threads=1)
    costs = {law: pinned_costs(runs, None)[0] for law, runs in results.runs.items()}
    offsets = np.array([suite.task.cost_offsets[suite.stratum(seed)] for seed in seeds])
    return gains(np.array([costs[law] for law in suite.task.variates]), costs[suite.task.hundred], offsets).T


def law_means(name, n_fresh=0):
    """Return what :data:`LAW_MEANS` holds of a suite, or the same of the scenarios before."""
    suite = get_suite(name)
    # The first ones are what entries train on.
    seeds = suite.train[-N_SCENARIOS - n_fresh : -N_SCENARIOS if n_fresh else None]
    parts = [list(seeds[first : first + _AT_ONCE]) for first in range(0, len(seeds), _AT_ONCE)]
    with ProcessPoolExecutor() as pool:
        x = np.concatenate(list(pool.map(gains_of, itertools.repeat(name), parts)))
    of = np.array([suite.stratum(seed) for seed in seeds])
    by_stratum = {stratum: x[of == stratum] for stratum in suite.strata}
    return {
        "suite_hash": suite.hash,
        "settings": settings_hash(shared_settings(EnvSettings(suite=name))),
        "laws": list(suite.task.variates),
        "strata": {
            name: {"n": len(x), "mean": x.mean(axis=0).tolist(), "covariance": np.atleast_2d(np.cov(x.T)).tolist()}
            for name, x in by_stratum.items()
        },
    }


if __name__ == "__main__":
    suites = [name for name, suite in SUITES.items() if suite.task is V1 and suite.strata]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("suites", nargs="*", default=suites, metavar="SUITE")
    parser.add_argument("--fresh", type=int, default=0, metavar="N", help="compare N other scenarios, write nothing")
    arguments = parser.parse_args()
    for name in arguments.suites:
        means = law_means(name, arguments.fresh)
        stored = json.loads(LAW_MEANS.read_text(encoding="utf-8"))
        if not arguments.fresh:
            kept = {suite: values for suite, values in stored.items() if values["laws"] == list(V1.variates)}
            write_atomically(LAW_MEANS, to_json({**kept, name: means}))
        for stratum, values in means["strata"].items():
            known, variances = stored[name]["strata"][stratum], np.diag(values["covariance"])
            errors = np.sqrt(variances / values["n"])
            away = np.subtract(values["mean"], known["mean"]) / np.hypot(errors, np.sqrt(variances / known["n"]))
            for law, mean, error, z in zip(means["laws"], values["mean"], errors, away, strict=True):
                compared = f", {z:+.1f} standard errors away" if arguments.fresh else ""
                print(f"{name} {stratum}: {values['n']} scenarios, {law} {mean:.4f} ± {error:.4f}{compared}")
