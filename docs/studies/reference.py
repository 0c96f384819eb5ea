"""The tables of docs/environment.md and docs/parameters.md, from where their entries are declared."""

import dataclasses
import inspect
import re
from typing import get_type_hints

from output import folder

from wtg_gym.envs import CostWeights, EnvSettings, GFMWTGEnv
from wtg_gym.envs.observation import GridObservation, MachineObservation, MeasuredObservation, WtgObservation
from wtg_gym.envs.task_records import Info
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics import machine_parameters, parameters
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters
from wtg_gym.physics.sources import SOURCES
from wtg_gym.scenarios import SUITES
from wtg_gym.scenarios.benchmark import BENCHMARKS

NEWEST_FIRST = list(BENCHMARKS.values())[::-1]
ENVS = {version.version: GFMWTGEnv(version=version.version) for version in NEWEST_FIRST}


def plain(text):
    """Return a docstring's text with names of objects as code."""
    return re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", text)


def declared(record):
    """Return name, unit and meaning of a record's fields."""
    return [(name, *hint.__metadata__) for name, hint in get_type_hints(record, include_extras=True).items()]


def overview():
    """Return the versions side by side."""
    header = ("", "Made by", "Action space", "Observation space", "Groups of turbines", "Step, episode", "Suites")
    columns = [header]
    for version in NEWEST_FIRST:
        env, step_s = ENVS[version.version], ENVS[version.version].settings.control_dt
        groups = [f"{group.n_turbines:g} at bus {group.bus}" for group in env.settings.wtg_groups()]
        suites = [f"`{suite.name}`" for suite in SUITES.values() if suite.benchmark == version]
        made, episode = f'`gymnasium.make("wtg_gym:{version.env_id}")`', env.settings.episode_duration_s()
        spaces = f"`{env.action_space}`", f"`{env.observation_space}`"
        time = f"{step_s} s, {round(episode / step_s)} steps"
        columns.append((f"`{version.env_id}`", made, *spaces, ", ".join(groups), time, ", ".join(suites)))
    rows = list(zip(*columns, strict=True))
    return markdown_table(rows[0], rows[1:])


def observations(version):
    """Return what a group sees."""
    rows = declared(MeasuredObservation if version.sensed else WtgObservation)
    rows += [(f"last_action_{name}", "-", f"last action on {sign}") for name, sign in (("k", "k"), ("tau", "τ"))]
    n_groups = len(ENVS[version.version].settings.wtg_groups())
    header = ("entry", "observation", "counted in", "what it is")
    table = markdown_table(header, [(str(i), *row) for i, row in enumerate(rows)], right=(0,))
    return f"`{version.env_id}`: the first of {n_groups} groups; the next group's entries come after it.\n\n{table}"


def privileged():
    """Return what `observation_mode="privileged"` adds."""
    rows = [("machine", *row) for row in declared(MachineObservation)]
    rows += [("grid", *row) for row in declared(GridObservation)]
    table = markdown_table(("of", "observation", "counted in", "what it is"), rows)
    exact = ", ".join(f"`{name}`" for name, *_ in (*declared(WtgObservation), ("mean_duty",)))
    return (
        'With `observation_mode="privileged"` these follow, those of each machine together. In v1 they come after the '
        f"exact values of each group, {exact}.\n\n{table}"
    )


def weights():
    """Return the weights of the cost."""
    own = [env.settings.cost_weights() for env in ENVS.values()]
    names = [field.name for field in dataclasses.fields(CostWeights)]
    rows = [(f"`{name}`", *(f"{getattr(weights, name):g}" for weights in own)) for name in names]
    table = markdown_table(("weight [1/s]", *ENVS), rows, right=range(1, 1 + len(own)))
    return f"{table}\n\n`cap` is the largest sum; [the equations and the reasons](benchmark.md#the-cost)."


def info():
    """Return the keys of `info`."""
    rows = [(f"`{key}`", *rest) for key, *rest in declared(Info)]
    rows.append(("`scenario_seed`", "-", "−1 for a scenario without a seed"))
    rows.append(("`termination_reason`", "text", "why the episode ended before its time, else empty"))
    return "### `info`\n\n" + markdown_table(("key of `info`", "unit", "meaning"), rows)


def arguments():
    """Return the arguments with their defaults, from the docstring of EnvSettings."""
    listed = (inspect.getdoc(EnvSettings) or "").partition("Args:\n")[2].partition("\n\n")[0]
    found = re.findall(r"^    (\w+): (.*?)(?=^    \w|\Z)", listed, flags=re.MULTILINE | re.DOTALL)
    meanings = {name: plain(" ".join(text.split())) for name, text in found}
    rows = []
    for field in dataclasses.fields(EnvSettings):
        default = "none" if field.default is None else f"`{field.default!r}`".replace("'", '"')
        rows.append((f"`{field.name}`", default, meanings[field.name]))
    return markdown_table(("argument", "default", "meaning"), rows)


def environment_page():
    """Return the environment's docstring, a chapter for each of Gymnasium's headings, with the tables in it."""
    tables = {
        "Observation Space": [*(observations(version) for version in NEWEST_FIRST), privileged()],
        "Rewards": [weights(), info()],
        "Arguments": [arguments()],
    }
    parts = [overview()]
    for chapter in re.split(r"^## ", inspect.getdoc(GFMWTGEnv) or "", flags=re.MULTILINE)[1:]:
        title, _, text = chapter.partition("\n")
        parts += [f"## {title}\n\n{plain(text.strip())}", *tables.get(title, [])]
    return "\n\n".join(parts)


def shown(value, unit="-"):
    """Return a value as text, with a unit."""
    return f"{value:g} {unit}".removesuffix(" -") if isinstance(value, float) else str(value)


def parameters_page():
    """Return a table for each class of parameters, one for the machines, and the sources."""
    parts, header = [], ("source", "what it is")
    for module in (parameters, machine_parameters):
        for name, cls in vars(module).items():
            if not dataclasses.is_dataclass(cls) or getattr(cls, "__module__", "") != module.__name__:
                continue
            fields = [(field, field.metadata) for field in dataclasses.fields(cls)]
            own = [(field, meta) for field, meta in fields if field.default is not dataclasses.MISSING]
            rows = [
                (field.name, shown(field.default, meta["unit"]), meta["source"], meta["doc"]) for field, meta in own
            ]
            if rows and cls is not SynchronousMachineParameters:
                parts.append(f"### {name}\n\n{markdown_table(('parameter', 'value', *header), rows, right=(1,))}")
    machines, rows = modified_ieee14().machines, []
    for field in dataclasses.fields(SynchronousMachineParameters):
        values, meta = [getattr(machine, field.name) for machine in machines], field.metadata
        if all(isinstance(value, (int, float)) for value in values) and field.name not in ("bus", "classical"):
            rows.append((f"{field.name} [{meta['unit']}]", *map(shown, values), meta["source"], meta["doc"]))
    header = ("parameter", *(f"bus {machine.bus}" for machine in machines), *header)
    parts.append(f"### Synchronous machines\n\n{markdown_table(header, rows, right=range(1, 5))}")
    sources = "\n".join(f"- **{key}**: {text}" for key, text in SOURCES.items())
    return "\n\n".join([*parts, f"### Sources\n\n{sources}"])


if __name__ == "__main__":
    docs = folder(__doc__)
    update_between_markers(docs / "environment.md", environment_page(), "environment")
    update_between_markers(docs / "parameters.md", parameters_page(), "parameters")
