"""Every parameter of the model with its unit and source, out of the metadata it is declared with."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from wtg_gym.envs.settings import CostWeights
from wtg_gym.files import markdown_table
from wtg_gym.physics import parameters
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.network import Branch, Bus
from wtg_gym.physics.parameters import SOURCES, SynchronousMachineParameters

#: What a row of :func:`parameter_rows` holds.
COLUMNS = ("group", "parameter", "value", "unit", "source", "what it is")
Row = tuple[str, str, str, str, str, str]


def parameter_classes() -> tuple[type, ...]:
    """Return every class that declares parameters."""
    own = [
        cls
        for cls in vars(parameters).values()
        if dataclasses.is_dataclass(cls) and isinstance(cls, type) and cls.__module__ == parameters.__name__
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
        table = markdown_table(COLUMNS[1:], [row[1:] for row in rows if row[0] == name], right=(1,))
        parts.append(f"### {name}\n\n{table}")
    parts.append("### Synchronous machines\n\n" + _pivot(list(_machine_rows()), "machine at "))
    network = list(_network_rows())
    for title, prefix in (("Buses", "bus "), ("Branches", "branch ")):
        own = [row for row in network if row[0].startswith(prefix)]
        parts.append(f"### {title}\n\n" + _transposed(own, prefix))
    sources = "\n".join(f"- **{key}**: {text}" for key, text in SOURCES.items())
    return "\n\n".join([*parts, f"### Sources\n\n{sources}"])


def _pivot(rows: list[Row], prefix: str) -> str:
    """A parameter a line, a machine a column."""
    groups = list(dict.fromkeys(row[0] for row in rows))
    values = {(row[0], row[1]): row[2] for row in rows}
    first = {row[1]: row for row in reversed(rows)}
    names = dict.fromkeys(row[1] for row in rows)
    header = ("parameter", *(group.removeprefix(prefix) for group in groups), *COLUMNS[3:])
    lines = [(name, *(values.get((group, name), "–") for group in groups), *first[name][3:]) for name in names]
    return markdown_table(header, lines, right=range(1, 1 + len(groups)))


def _transposed(rows: list[Row], prefix: str) -> str:
    """A bus or branch a line, a parameter a column with its unit; the source is the same for all."""
    groups = list(dict.fromkeys(row[0] for row in rows))
    names = list(dict.fromkeys(row[1] for row in rows))
    values = {(row[0], row[1]): row[2] for row in rows}
    units = {row[1]: row[3] for row in rows}
    header = (prefix.strip(), *(f"{name} [{units[name]}]" for name in names))
    lines = [(group.removeprefix(prefix), *(values.get((group, name), "–") for name in names)) for group in groups]
    sources = ", ".join(dict.fromkeys(row[4] for row in rows))
    return markdown_table(header, lines, right=range(1, 1 + len(names))) + f"\n\nSource: {sources}."
