"""The tables of docs/environment.md and docs/parameters.md, and of docs/benchmark.md's laws, from their code."""

import dataclasses
import inspect
import math
import re
from collections import Counter
from typing import get_type_hints

from output import DOCS

from wtg_gym.envs import EnvSettings, GFMWTGEnv
from wtg_gym.evaluation import load_entries
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics import machine_parameters, parameters
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters
from wtg_gym.physics.parameters import SOURCES, ProtectionParameters, SheddingStage, WtgGroup
from wtg_gym.tasks import TASKS, V1
from wtg_gym.tasks.cost import COST_TERMS, CostWeights
from wtg_gym.tasks.measured_observation import MeasuredObservation
from wtg_gym.tasks.observation import GridObservation, Info, LocalInfo, MachineObservation, WtgObservation

#: The newest version first.
ENVS = {task.version: GFMWTGEnv(version=task.version) for task in reversed(TASKS.values())}


def plain(text):
    """Return a docstring's text with names of objects as code."""
    return re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", text)


def declared(record):
    """Return name, unit and meaning of a record's fields."""
    return [(name, *hint.__metadata__) for name, hint in get_type_hints(record, include_extras=True).items()]


def listed(rows):
    """Return names and their meanings as a list, which holds whole sentences better than a table."""
    return "\n".join(f"- {name}: {meaning}" for name, meaning in rows)


def overview():
    """Return the versions side by side."""
    columns = [("", "Action space", "Observation space", "Groups of turbines", "Step, episode")]
    for env in ENVS.values():
        settings, names = env.settings, (env.settings.env_id, env.action_space, env.observation_space)
        groups = [f"{group.n_turbines:g} at bus {group.bus}" for group in settings.resolved_plant.groups]
        time = f"{settings.step_s} s, {round(settings.episode_duration_s() / settings.step_s)} steps"
        columns.append((*(f"`{name}`" for name in names), ", ".join(groups), time))
    rows = list(zip(*columns, strict=True))
    return markdown_table(rows[0], rows[1:])


def observations():
    """Return the observation of a group in both versions, with v1's meaning of a number if it has one."""
    last = [(f"last_action_{name}", "-", f"last action on {sign}") for name, sign in (("k", "k"), ("tau", "τ"))]
    exact, measured = ([*declared(record), *last] for record in (WtgObservation, MeasuredObservation))
    meanings = {row[0]: row for row in (*exact[:-2], *measured)}
    places = [[name for name, *_ in rows] for rows in (measured, exact)]
    rows = [
        (*(str(names.index(name)) if name in names else "" for names in places), *meanings[name])
        for name in sorted(meanings, key=places[1].index)
    ]
    table = markdown_table(("v1", "v0", "observation", "counted in", "what it is"), rows, right=(0, 1))
    return (
        "Indices of the first group's numbers; the other groups follow (`observation_names` lists all). In v1 they are "
        "measurements with noise and bias, 0.1 … 0.3 s late. In v0 they are exact; RoCoF is that of the last step.\n\n"
        f"{table}"
    )


def privileged():
    """Return what `observation_mode="privileged"` adds."""
    rows = [("machine", *row) for row in declared(MachineObservation)]
    rows += [("grid", *row) for row in declared(GridObservation)]
    table = markdown_table(("of", "observation", "counted in", "what it is"), rows)
    exact = ", ".join(f"`{name}`" for name, *_ in (*declared(WtgObservation), ("mean_duty",)))
    return (
        'With `observation_mode="privileged"` these follow, machine by machine; in v1 the exact values of each group '
        f"come first: {exact}.\n\n{table}"
    )


def weights():
    """Return the weights of the cost."""

    def value(settings, name):
        counts = settings.task.failure_costs_whole_episode or name not in ("unserved", "failure")
        return f"{getattr(settings.cost_weights(), name):g}" if counts else "–"

    rows = [(f"`{name}`", *(value(env.settings, name) for env in ENVS.values())) for name in CostWeights._fields]
    table = markdown_table(("weight [1/s]", *ENVS), rows, right=range(1, 1 + len(ENVS)))
    return (
        f"{table}\n\n`cap` limits the sum, in v1 without frequency and load not served "
        "([terms](benchmark.md#the-cost), [score and reward](benchmark.md#score-and-reward))."
    )


def info():
    """Return the keys of `info`, whose names end in their units; one for all terms of the cost."""
    rows = [(f"`{key}`", meaning) for key, _, meaning in (*declared(Info), *declared(LocalInfo))]
    terms = f"{', '.join(COST_TERMS)} (in v1 `cost_failure` includes load not served)"
    rows += [
        ("`cost_…`", f"[cost of this step](benchmark.md#the-cost): {terms}"),
        ("`scenario_seed`", "its seed, else −1"),
        ("`reserve_margin`", "[reserve margin](benchmark.md#strata); in drawn suites of v1"),
        ("`termination_reason`", "why the episode was terminated, else empty"),
    ]
    return "### `info`\n\n" + listed(rows)


def arguments():
    """Return the arguments with their defaults, from the docstring of EnvSettings."""
    text = (inspect.getdoc(EnvSettings) or "").partition("Args:\n")[2].partition("\n\n")[0]
    entries = re.findall(r"^    (\w+): (.*?)(?=^    \w|\Z)", text, flags=re.MULTILINE | re.DOTALL)
    meanings = {name: plain(" ".join(text.split())) for name, text in entries}
    rows = []
    for field in dataclasses.fields(EnvSettings):
        default = "" if field.default is None else f"={field.default!r}".replace("'", '"')
        rows.append((f"`{field.name}{default}`", meanings[field.name]))
    return listed(rows)


def environment_page():
    """Return the environment's docstring, a chapter for each of Gymnasium's headings, with the tables in it.

    Chapters that other pages cover are left out.
    """
    tables = {
        "Observation Space": [observations(), privileged()],
        "Rewards": [weights(), info()],
        "Arguments": [arguments()],
    }
    parts = [overview()]
    for chapter in re.split(r"^## ", inspect.getdoc(GFMWTGEnv) or "", flags=re.MULTILINE)[1:]:
        title, _, text = chapter.partition("\n")
        if title in ("Description", "Rendering", "Vectorized environment", "Version History"):
            continue
        prose = [] if title == "Observation Space" else [plain(text.strip())]
        parts += [f"## {title}", *prose, *tables.get(title, [])]
    return "\n\n".join(parts)


def class_list(title, fields, values):
    """Return the list of a class: the source of most of its parameters in its title, another one behind its parameter.

    A unit follows the values unless the name ends with it.
    """
    usual = Counter(field.metadata["source"] for field in fields).most_common(1)[0][0]
    lines = [f"**{title}** ({usual})\n"]
    for field in fields:
        meta = field.metadata
        ending = "_" + meta["unit"].lower().replace(".", "").replace("/", "_").replace("³", "3")
        unit = "" if meta["unit"] == "-" or field.name.endswith(ending) else f" {meta['unit']}"
        source = "" if meta["source"] == usual else f" ({meta['source']})"
        numbers = [f"{value:g}" for value in values(field)]
        shown = numbers[0] if len(set(numbers)) == 1 else "/".join(numbers)
        # The names of a machine's reactances and times per axis are those of every textbook.
        meaning = "" if re.match("[xt]_[dq]", field.name) else f", {meta['doc']}"
        lines.append(f"- `{field.name}`: {shown}{unit}{meaning}{source}")
    return "\n".join(lines)


def parameters_page():
    """Return a list for each class of parameters, one for the machines, and the sources.

    Controls that only a grid's file uses are in the API.
    """
    parts = []
    for module in (parameters, machine_parameters):
        for name, cls in vars(module).items():
            if not dataclasses.is_dataclass(cls) or getattr(cls, "__module__", "") != module.__name__:
                continue
            # Inherited parameters are listed with their own class.
            declared = [field for field in dataclasses.fields(cls) if field.name in cls.__annotations__]
            plain_fields = [field for field in declared if isinstance(field.default, float)]
            # On the environment's page, below, or on the model's page.
            elsewhere = cls in (WtgGroup, SynchronousMachineParameters, SheddingStage, ProtectionParameters)
            unused = hasattr(cls, "MODEL") and cls.MODEL not in ("SEXS", "TGOV1")
            if plain_fields and not elsewhere and not unused:
                parts.append(class_list(name, plain_fields, lambda field: [field.default]))
    machines = {}
    for machine in get_grid("ieee14").case.machines:
        # What is 0 is left out.
        numbers = {key: n for key, n in vars(machine).items() if type(n) in (int, float) and n != 0 and key != "bus"}
        machines.setdefault(tuple(numbers.items()), []).append(str(machine.bus))
    fields = [field for field in dataclasses.fields(SynchronousMachineParameters) if field.name in numbers]
    title = f"Synchronous machines at buses {'/'.join(' and '.join(buses) for buses in machines.values())}"
    parts.append(class_list(title, fields, lambda field: [dict(machine)[field.name] for machine in machines]))
    lists = "\n\n".join(parts)
    sources = "\n".join(f"- **{key}**: {text}" for key, text in SOURCES.items() if f"({key})" in lists)
    return f"{lists}\n\n## Sources\n\n{sources}"


def laws():
    """Return the control laws of v1: k at the corners of g(ω), τ, and what they are."""
    rows = []
    for entry in load_entries("baselines", V1):
        numbers = [f"{getattr(entry.law, key):.3f}" for key in ("k_min", "k_nominal", "k_max")]
        tau = entry.law.damping_time_constant_s
        rows.append((f"`{entry.name}`", *numbers, "∞" if math.isinf(tau) else f"{tau:g}", entry.description))
    return markdown_table(("law", "k_min [p.u.]", "k_nominal", "k_max", "τ [s]", "what it is"), rows, right=range(1, 5))


if __name__ == "__main__":
    update_between_markers(DOCS / "environment.md", environment_page(), "environment")
    update_between_markers(DOCS / "parameters.md", parameters_page(), "parameters")
    update_between_markers(DOCS / "benchmark.md", laws(), "laws")
