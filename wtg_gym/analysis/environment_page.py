"""The environments in the form of Gymnasium's own pages, from their docstring, their spaces and their declarations."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from typing import get_type_hints

from wtg_gym.envs import CostWeights, EnvSettings, GFMWTGEnv
from wtg_gym.envs.observation import (
    OBSERVATION_BOUND,
    GridObservation,
    MachineObservation,
    MeasuredObservation,
    WtgObservation,
)
from wtg_gym.envs.settings import ACTION_MODES
from wtg_gym.envs.task_records import COST_TERMS, Info
from wtg_gym.files import markdown_table
from wtg_gym.scenarios import SUITES
from wtg_gym.scenarios.benchmark import BENCHMARKS, Benchmark

#: Meaning of a group's two actions.
_ACTIONS = {
    "k": "offset on k: at full action {share} of K_opt − K_pr",
    "tau": "factor on τ: 4 at full action, ¼ at the least",
}
_MEAN_DUTY = ("mean_duty", "0.05 of the available power", "duty error that is charged")


def environment_page() -> str:
    """Return the environments' description as Markdown: one chapter for each of Gymnasium's headings."""
    newest = list(BENCHMARKS.values())[::-1]
    parts = [_overview(newest)]
    for title, text in _chapters():
        parts.append(f"## {title}\n\n{text}")
        if title == "Action Space":
            parts += [_actions(version) for version in newest]
        elif title == "Observation Space":
            parts += [*(_observations(version) for version in newest), *_privileged()]
        elif title == "Rewards":
            parts += [_weights(newest), _info()]
        elif title == "Arguments":
            parts.append(_arguments())
    return "\n\n".join(parts)


def _chapters() -> Iterator[tuple[str, str]]:
    """Return the headings of the environment's docstring and what stands below each."""
    _, *chapters = re.split(r"^## ", inspect.getdoc(GFMWTGEnv) or "", flags=re.MULTILINE)
    for chapter in chapters:
        title, _, text = chapter.partition("\n")
        yield title, _plain(text.strip())


def _plain(text: str) -> str:
    """Return a docstring's text with names of objects as code."""
    return re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", text)


def _made(version: Benchmark) -> GFMWTGEnv:
    return GFMWTGEnv(version=version.version)


def _overview(versions: list[Benchmark]) -> str:
    rows: dict[str, list[str]] = {}
    for version in versions:
        env = _made(version)
        groups = ", ".join(f"{group.n_turbines:g} at bus {group.bus}" for group in env.settings.wtg_groups())
        suites = [suite.name for suite in SUITES.values() if suite.benchmark == version]
        n_steps = round(env.settings.episode_duration_s() / env.settings.control_dt)
        facts = {
            "Made by": f'`gymnasium.make("wtg_gym:{version.env_id}")`',
            "Action space": f"`{env.action_space}`",
            "Observation space": f"`{env.observation_space}`",
            "Groups of turbines": groups,
            "Step, episode": f"{env.settings.control_dt} s, {n_steps} steps",
            "Suites": ", ".join(f"`{name}`" for name in suites),
        }
        for name, value in facts.items():
            rows.setdefault(name, []).append(value)
    header = ("", *(f"`{version.env_id}`" for version in versions))
    return markdown_table(header, [(name, *values) for name, values in rows.items()])


def _entries(first: int, every: int, n_groups: int) -> str:
    return ", ".join(str(first + every * group) for group in range(n_groups))


def _actions(version: Benchmark) -> str:
    env = _made(version)
    names = [name for name, used in zip(("k", "tau"), ACTION_MODES[env.settings.action_mode], strict=True) if used]
    n_groups = len(env.settings.wtg_groups())
    share = f"{version.k_authority:.0%}".replace("%", " %")
    rows = [
        (_entries(index, len(names), n_groups), name, "-1", "1", _ACTIONS[name].format(share=share))
        for index, name in enumerate(names)
    ]
    table = markdown_table(("entries", "action", "least", "most", "what it is"), rows, right=(2, 3))
    return f"`{version.env_id}`, an entry for each of {n_groups} groups:\n\n{table}"


def _observations(version: Benchmark) -> str:
    env = _made(version)
    n_groups = len(env.settings.wtg_groups())
    rows = _observed(MeasuredObservation if version.sensed else WtgObservation)
    for name, used in zip(("k", "tau"), ACTION_MODES[env.settings.action_mode], strict=True):
        if used:
            rows.append((f"last_action_{name}", "-", f"last action on {'τ' if name == 'tau' else name}"))
    cells = [(_entries(index, len(rows), n_groups), *_bounded(row)) for index, row in enumerate(rows)]
    return f"`{version.env_id}`, an entry for each of {n_groups} groups:\n\n{_observation_table('entries', cells)}"


def _privileged() -> Iterator[str]:
    """Return what `observation_mode="privileged"` adds."""
    machines, grid = _observed(MachineObservation), _observed(GridObservation)
    exact = [*_observed(WtgObservation), _MEAN_DUTY]
    cells = [(owner, *_bounded(row)) for owner, rows in (("machine", machines), ("grid", grid)) for row in rows]
    yield 'With `observation_mode="privileged"` these follow, those of each machine together:'
    yield _observation_table("of", cells)
    yield "In v1 they come after the exact values of each group, " + ", ".join(f"`{row[0]}`" for row in exact) + "."


def _observed(record: type) -> list[tuple[str, str, str]]:
    hints = get_type_hints(record, include_extras=True)
    return [(name, *hint.__metadata__) for name, hint in hints.items()]


def _bounded(row: tuple[str, str, str]) -> tuple[str, ...]:
    name, unit, meaning = row
    return name, unit, f"{-OBSERVATION_BOUND:g}", f"{OBSERVATION_BOUND:g}", meaning


def _observation_table(first: str, cells: list[tuple[str, ...]]) -> str:
    return markdown_table((first, "observation", "counted in", "least", "most", "what it is"), cells, right=(3, 4))


def _weights(versions: list[Benchmark]) -> str:
    names = [field.name for field in dataclasses.fields(CostWeights)]
    weights = [_made(version).settings.cost_weights() for version in versions]
    rows = [
        (f"`{name}`" if name in COST_TERMS else "largest sum", *(f"{getattr(own, name):g}" for own in weights))
        for name in names
    ]
    header = ("weight [1/s]", *(version.version for version in versions))
    table = markdown_table(header, rows, right=range(1, 1 + len(versions)))
    return f"{table}\n\n[The equation of each term, and the reason for its weight](benchmark.md#the-cost)."


def _info() -> str:
    rows = [(f"`{key}`", unit, meaning) for key, unit, meaning in _observed(Info)]
    rows.append(("`scenario_seed`", "-", "seed of the scenario; −1 for one without a seed"))
    reason = "`under-speed`, `frequency limit`, …; empty while the episode runs or when its time is over"
    rows.append(("`termination_reason`", "text", reason))
    return "### `info`\n\n" + markdown_table(("key of `info`", "unit", "meaning"), rows)


def _arguments() -> str:
    """Return the arguments with their defaults, from the docstring of :class:`EnvSettings`."""
    listed = (inspect.getdoc(EnvSettings) or "").partition("Args:\n")[2].partition("\n\n")[0]
    found = re.findall(r"^    (\w+): (.*?)(?=^    \w|\Z)", listed, flags=re.MULTILINE | re.DOTALL)
    meanings = {name: _plain(" ".join(text.split())) for name, text in found}
    rows = []
    for field in dataclasses.fields(EnvSettings):
        default = "none" if field.default is None else f"`{field.default!r}`".replace("'", '"')
        rows.append((f"`{field.name}`", default, meanings[field.name]))
    return markdown_table(("argument", "default", "meaning"), rows)
