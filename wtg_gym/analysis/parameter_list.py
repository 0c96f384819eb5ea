"""Every parameter of the model with its unit and source, from the metadata of its declaration."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from wtg_gym.envs.settings import CostWeights
from wtg_gym.files import markdown_table
from wtg_gym.physics import machine_parameters, parameters
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.machine_parameters import SynchronousMachineParameters
from wtg_gym.physics.network import Branch, Bus
from wtg_gym.physics.sources import SOURCES

#: The columns of :func:`parameter_rows`.
COLUMNS = ("group", "parameter", "value", "unit", "source", "what it is")
Row = tuple[str, str, str, str, str, str]


def parameter_classes() -> tuple[type, ...]:
    """Return every class that declares parameters."""
    own = [
        cls
        for module in (parameters, machine_parameters)
        for cls in vars(module).values()
        if dataclasses.is_dataclass(cls) and isinstance(cls, type) and cls.__module__ == module.__name__
    ]
    return (*own, Bus, Branch, CostWeights)


def parameter_rows() -> list[Row]:
    """Return every parameter once, in the order of :data:`COLUMNS`; network and machines by bus."""
    return [*_class_rows(), *_machine_rows(), *_network_rows()]


def _class_rows() -> Iterator[Row]:
    for cls in parameter_classes():
        if cls in (SynchronousMachineParameters, Bus, Branch):
            continue
        for field in dataclasses.fields(cls):
            if field.default is not dataclasses.MISSING:
                yield _row(cls.__name__, field, field.default)


def _machine_rows() -> Iterator[Row]:
    for machine in modified_ieee14().machines:
        for field in dataclasses.fields(machine):
            value = getattr(machine, field.name)
            # An exciter or governor has rows of its own, classical machines are another model.
            if not dataclasses.is_dataclass(value) and field.name not in ("bus", "classical"):
                yield _row(f"machine at bus {machine.bus}", field, value)


def _network_rows() -> Iterator[Row]:
    case = modified_ieee14()
    for bus in case.buses:
        for field in dataclasses.fields(bus):
            value = getattr(bus, field.name)
            if field.name != "number" and value:
                yield _row(f"bus {bus.number}", field, value)
    for branch in case.branches:
        for field in dataclasses.fields(branch):
            value = getattr(branch, field.name)
            if field.name not in ("from_bus", "to_bus", "phase_rad") and value != field.default:
                yield _row(f"branch {branch.from_bus}–{branch.to_bus}", field, value)


def _row(group: str, field: dataclasses.Field[Any], value: object) -> Row:
    meta = field.metadata
    text = f"{value:g}" if isinstance(value, float) else ("none" if value is None else str(value))
    return group, field.name, text, meta["unit"], meta["source"], meta["doc"]


def parameters_page() -> str:
    """Return the parameters as Markdown: a table a class, one for the machines, two for the network, the sources."""
    rows = list(_class_rows())
    parts = []
    for name in dict.fromkeys(row[0] for row in rows):
        own = [
            (parameter, value if unit == "-" else f"{value} {unit}", source, doc)
            for group, parameter, value, unit, source, doc in rows
            if group == name
        ]
        sources = list(dict.fromkeys(row[2] for row in own))
        columns = {"parameter": 0, "value": 1, "source": 2, "what it is": 3}
        lines = [f"### {name}"]
        if len(sources) == 1:
            del columns["source"]
            lines.append(f"Source: {sources[0]}.")
        if name == CostWeights.__name__:
            del columns["what it is"]
            lines.append("[What each one charges, and why](benchmark.md#the-cost).")
        cells = [tuple(row[i] for i in columns.values()) for row in own]
        parts.append("\n\n".join([*lines, markdown_table(tuple(columns), cells, right=(1,))]))
    names, by_name = _pivot(list(_machine_rows()), "machine at ")
    first = {row[1]: row for row in reversed(list(_machine_rows()))}
    machines = [(_with_unit(first[name]), *values, *first[name][4:]) for name, values in by_name.items()]
    header = ("parameter", *names, "source", "what it is")
    parts.append("### Synchronous machines\n\n" + markdown_table(header, machines, right=range(1, 1 + len(names))))
    network = list(_network_rows())
    for title, prefix in (("Buses", "bus "), ("Branches", "branch ")):
        own_rows = [row for row in network if row[0].startswith(prefix)]
        names, by_name = _pivot(own_rows, prefix)
        first = {row[1]: row for row in own_rows}
        header = (prefix.strip(), *(_with_unit(first[name]) for name in by_name))
        table = markdown_table(header, list(zip(names, *by_name.values(), strict=True)), right=range(1, len(header)))
        used = ", ".join(dict.fromkeys(row[4] for row in own_rows))
        parts.append(f"### {title}\n\nSource: {used}.\n\n{table}")
    listed = "\n".join(f"- **{key}**: {text}" for key, text in SOURCES.items())
    return "\n\n".join([*parts, f"### Sources\n\n{listed}"])


def _with_unit(row: Row) -> str:
    return row[1] if row[3] == "-" else f"{row[1]} [{row[3]}]"


def _pivot(rows: list[Row], prefix: str) -> tuple[list[str], dict[str, list[str]]]:
    """Return the groups without a prefix, and each parameter's values in them; no row where all are the default."""
    groups = list(dict.fromkeys(row[0] for row in rows))
    values = {(row[0], row[1]): row[2] for row in rows}
    cells = {
        name: [values.get((group, name), "") for group in groups] for name in dict.fromkeys(row[1] for row in rows)
    }
    shown = {name: own for name, own in cells.items() if set(own) - {"", "none"}}
    return [group.removeprefix(prefix) for group in groups], shown
