"""Time a step of ANDES' own Gymnasium environment, `andes.rl`, on its IEEE 14-bus case, beside the yardstick.

Observations, actions and steps of 0.1 s are those of the example in its docstring; the case is the one without events,
in which random actions do not end an episode. ANDES is GPL-3: nothing in the package imports it, and this script runs
in the environment of the golden cases.

Usage:
    make .venv-golden/ready-3.11
    .venv-golden/bin/python tests/golden/time_andes_env.py --page docs/performance.md
"""

from __future__ import annotations

import argparse
import importlib.metadata
import logging
from pathlib import Path

import andes
import gymnasium as gym
from andes.rl import AndesEnv

from wtg_gym.analysis.benchmarks.environments import YARDSTICK
from wtg_gym.analysis.benchmarks.timing import Case, Stepper, machine, measure, prepare, step_single
from wtg_gym.files import markdown_table, update_between_markers

CASE = "ieee14/ieee14_full.xlsx"
SECONDS, REPEATS = 2.0, 5


def andes_env() -> Stepper:
    """Return the stepper of ANDES' environment: random actions of up to 0.01 p.u., resets included."""
    logging.getLogger("andes").setLevel(logging.ERROR)
    env = AndesEnv(
        case=andes.get_case(CASE),
        obs=[("GENROU", "omega")],
        acts=[("SynGen", "paux")],
        reward_fn=lambda observation, action, env: -float(sum((observation - 1.0) ** 2)),
        dt=0.1,
        tf=20.0,
        action_low=-0.01,
        action_high=0.01,
    )
    return step_single(env)


def main() -> None:
    """Measure, print the table, and put it between the markers `bench:andes` of a page."""
    parser = argparse.ArgumentParser(description="Time a step of ANDES' own Gymnasium environment.")
    parser.add_argument("--page", help="Markdown file with the markers 'bench:andes' to put the table between")
    arguments = parser.parse_args()
    name = f"ANDES {importlib.metadata.version('andes')} andes.rl, {CASE}"
    cases = [
        Case("andes", YARDSTICK, 1, lambda: step_single(gym.make(YARDSTICK))),
        Case("andes", name, 1, andes_env),
    ]
    rates = measure(cases, prepare(cases, lambda *_: None), SECONDS, REPEATS, lambda *_: None)
    rows = [(rate.case.name, f"{rate.per_s:,.0f}", f"{rate.per_s / rates[0].per_s:.2g}") for rate in rates]
    table = markdown_table(("case", "steps per s", f"× {YARDSTICK}"), rows, right=(1, 2))
    text = f"{machine()}; median of {REPEATS} runs of {SECONDS:g} s.\n\n{table}"
    print(text)
    if arguments.page is not None:
        update_between_markers(Path(arguments.page), text, "bench:andes")


if __name__ == "__main__":
    main()
