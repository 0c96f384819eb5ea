"""`wtg-gym bench`: environment steps per second, as ratios to Gymnasium's own environments in the same run."""

from __future__ import annotations

import argparse
import importlib.util
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import wtg_gym
from wtg_gym.cli.output import Progress, check_page, print_json, print_table, update_page
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.files import markdown_table
from wtg_gym.physics.scenario import require_range
from wtg_gym.scenarios import get_suite

#: The yardstick: physics of a few lines, in pure Python.
_YARDSTICK = "Pendulum-v1"
_N_ACTIONS = 256

_DESCRIPTION = f"""\
Measures environment steps per second in one process, episodes' resets included, actions drawn beforehand: this
environment single and batched, Gymnasium's own ones, and Stable-Baselines3's vector environments where installed.
Every case runs several times, in turns so that a busy spell of the machine strikes all alike; the median counts, and
its ratio to {_YARDSTICK} of the same run travels between machines."""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym bench`."""
    parser = add_command(
        commands,
        "bench",
        run,
        summary="environment steps per second, and their ratio to Gymnasium's own environments",
        description=_DESCRIPTION,
        examples="  wtg-gym bench\n  wtg-gym bench --seconds 0.5 --repeats 3 --json\n  wtg-gym bench --page README.md",
    )
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="per case and repeat (default: 2)")
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="the median of these counts (default: 5)")
    parser.add_argument("--page", metavar="FILE", help="Markdown file with markers 'bench' to put the table between")
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, on stdout")


@dataclass(frozen=True)
class _Case:
    """Something to step: what it is called, how many environments it steps at once, how it is made."""

    name: str
    n_envs: int
    make: Callable[[], Callable[[float], float]]


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym bench`."""
    seconds = require_range("--seconds", arguments.seconds, 0.01, 600.0, "s")
    if not 1 <= arguments.repeats <= 1000:
        raise ValueError(f"--repeats = {arguments.repeats} is outside the allowed range 1 … 1000")
    page = check_page("--page", arguments.page, "bench")
    cases = list(_cases())
    rates: dict[str, list[float]] = {case.name: [] for case in cases}
    with Progress("runs") as progress:
        steppers = {}
        for case in cases:
            progress.update(f"preparing {case.name}", 0, len(cases))
            steppers[case.name] = case.make()
            steppers[case.name](0.01)
        total = arguments.repeats * len(cases)
        for repeat in range(arguments.repeats):
            for done, case in enumerate(cases):
                progress.update(case.name, repeat * len(cases) + done, total)
                rates[case.name].append(steppers[case.name](seconds))
    medians = {name: statistics.median(found) for name, found in rates.items()}
    rows = [(case, medians[case.name], medians[case.name] / medians[_YARDSTICK]) for case in cases]
    if page is not None:
        update_page(page, {"bench": _page(rows, arguments)})
    if arguments.json:
        print_json(
            {
                "machine": _machine(),
                "versions": _versions(),
                "seconds": seconds,
                "repeats": arguments.repeats,
                "cases": [
                    {"name": c.name, "n_envs": c.n_envs, "steps_per_s": median, "ratio": ratio, "all": rates[c.name]}
                    for c, median, ratio in rows
                ],
            }
        )
        return 0
    print(_machine(), end="\n\n")
    header = ("case", "environments", "steps per s", f"× {_YARDSTICK}")
    print_table(header, [(c.name, str(c.n_envs), f"{median:.0f}", f"{ratio:.2f}") for c, median, ratio in rows])
    return 0


def _cases() -> Iterator[_Case]:
    ours = wtg_gym.ENV_ID
    for name in (_YARDSTICK, "CartPole-v1", ours):
        yield _Case(name, 1, lambda name=name: _single(gym.make(name)))  # type: ignore[misc]
    for n in (64, 1024):
        yield _Case(f"{ours}, vector of {n}", n, lambda n=n: _vector(_staggered(n)))  # type: ignore[misc]
    yield _Case(
        "CartPole-v1, vector of 1024",
        1024,
        lambda: _vector(gym.make_vec("CartPole-v1", num_envs=1024, vectorization_mode="vector_entry_point")),
    )
    if importlib.util.find_spec("stable_baselines3") is not None:
        yield from _sb3_cases()


def _sb3_cases() -> Iterator[_Case]:
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

    from wtg_gym.sb3 import SB3VecEnv

    n_cpu = os.cpu_count() or 1
    for n in (64, 1024):
        yield _Case(f"SB3 adapter of {n}", n, lambda n=n: _sb3(SB3VecEnv(n)))  # type: ignore[misc]
    yield _Case("SB3 DummyVecEnv of 8", 8, lambda: _sb3(DummyVecEnv([_make_single] * 8)))
    yield _Case(
        f"SB3 SubprocVecEnv of {n_cpu}", n_cpu, lambda: _sb3(SubprocVecEnv([_make_single] * n_cpu, "forkserver"))
    )


def _make_single() -> Any:
    import wtg_gym

    return gym.make(wtg_gym.ENV_ID)


def _single(env: Any) -> Callable[[float], float]:
    actions = [env.action_space.sample() for _ in range(_N_ACTIONS)]
    env.reset(seed=0)

    def measure(seconds: float) -> float:
        n, begin = 0, time.perf_counter()
        while (passed := time.perf_counter() - begin) < seconds:
            for action in actions:
                _, _, terminated, truncated, _ = env.step(action)
                if terminated or truncated:
                    env.reset()
            n += len(actions)
        return n / passed

    return measure


def _staggered(n_envs: int) -> Any:
    """Return a batch whose first episodes are of all lengths, so that resets come evenly from then on."""
    envs = gym.make_vec(wtg_gym.ENV_ID, num_envs=n_envs)
    suite = get_suite("standard")
    lengths = np.random.default_rng(0).integers(1, round(suite.duration_s), n_envs)
    scenarios = [suite.scenario(suite.validation[i % 100], duration_s=float(s)) for i, s in enumerate(lengths)]
    envs.reset(seed=0)
    envs.reset(options={"scenarios": scenarios})
    return envs


def _vector(envs: Any) -> Callable[[float], float]:
    actions = [envs.action_space.sample() for _ in range(8)]
    if envs.spec is None or envs.spec.id != wtg_gym.ENV_ID:
        envs.reset(seed=0)
    return _repeat(lambda i: envs.step(actions[i % 8]), envs.num_envs)


def _sb3(envs: Any) -> Callable[[float], float]:
    actions = [np.stack([envs.action_space.sample() for _ in range(envs.num_envs)]) for _ in range(8)]
    envs.reset()
    return _repeat(lambda i: envs.step(actions[i % 8]), envs.num_envs)


def _repeat(step: Callable[[int], Any], n_envs: int) -> Callable[[float], float]:
    def measure(seconds: float) -> float:
        n, begin = 0, time.perf_counter()
        while (passed := time.perf_counter() - begin) < seconds:
            step(n)
            n += 1
        return n * n_envs / passed

    return measure


def _machine() -> str:
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return f"{model}, {os.cpu_count()} processors, Python {platform.python_version()}"


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {name: version(name) for name in ("gymnasium", "numba", "numpy")}


def _page(rows: list[tuple[_Case, float, float]], arguments: argparse.Namespace) -> str:
    table = markdown_table(
        ("case", "environments", "steps per second", f"× {_YARDSTICK}"),
        [(case.name, str(case.n_envs), f"{median:,.0f}", f"{ratio:.2f}") for case, median, ratio in rows],
        right=(1, 2, 3),
    )
    return f"{_machine()}; median of {arguments.repeats} runs of {arguments.seconds:g} s.\n\n{table}"
