"""How the API reference reads the sources.

- A docstring names other objects as Sphinx does, :class:`Name`; on the site these are links.
- The comment `#:` above a constant is its description; that behind a field, or the `#:` above it, is the field's.
- A name that several modules offer is described once, on the page of the package that holds it; the others link there.
"""

from __future__ import annotations

import ast
import itertools
import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):`(~?)([\w.]+)`")


def _reference(path: str, shown: str) -> str:
    """Return a link to an object, which is code where the site does not have the object."""
    return f'<autoref identifier="{path}" optional><code>{shown}</code></autoref>'


def _declared(value: Any) -> str:
    """Return meaning and unit of a field that `design`, `parameter` or `required` of wtg_gym.ranges declares."""
    of_source = {"design": 0, "parameter": 1, "required": 1}
    if not isinstance(value, griffe.ExprCall) or str(value.function) not in of_source:
        return ""
    texts = [ast.literal_eval(item) for item in value.arguments if isinstance(item, str) and item[:1] in "'\""]
    return f"{texts[-1]} [{texts[-2 - of_source[str(value.function)]]}]"


def _fields(record: griffe.Class) -> str:
    """Return the section of a docstring about the fields of a dataclass or a NamedTuple, from their comments."""
    texts = []
    for name, field in record.members.items():
        if not isinstance(field, griffe.Attribute) or None in (field.annotation, field.lineno, field.endlineno):
            continue
        lines = record.lines_collection[record.filepath]
        above = itertools.takewhile(lambda line: line.startswith("#:"), map(str.strip, lines[field.lineno - 2 :: -1]))
        comments = [line.removeprefix("#:").strip() for line in reversed(list(above))]
        comments.append(lines[field.endlineno - 1].partition("  # ")[2] or _declared(field.value))
        if text := " ".join(filter(None, comments)):
            texts.append(f"\n    {name}: {text.rstrip('.')}.")
    return "\n\nArgs:" + "".join(texts) if texts else ""


class Docstrings(griffe.Extension):
    """Prepares what mkdocstrings shows."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Turn roles in an object's docstring into links, after those of a record's fields have been added."""
        if obj.docstring is None:
            return
        if isinstance(obj, griffe.Class) and "Args:" not in obj.docstring.value:
            obj.docstring.value += _fields(obj)

        def link(match: re.Match[str]) -> str:
            tilde, name = match.groups()
            try:
                path = obj.resolve(name)
            except griffe.NameResolutionError:
                path = name
            return _reference(path, name.rpartition(".")[2] if tilde else name)

        obj.docstring.value = _ROLE.sub(link, obj.docstring.value)

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Take the comment above a constant as its docstring."""
        if attr.docstring is not None or attr.lineno is None or not isinstance(attr.parent, griffe.Module):
            return
        above: list[str] = []
        for line in reversed(attr.lines_collection[attr.filepath][: attr.lineno - 1]):
            if not line.startswith("#:"):
                break
            above.insert(0, line.removeprefix("#:").strip())
        if above:
            attr.docstring = griffe.Docstring(" ".join(above), parent=attr)

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Leave each name to the package that holds it, where that offers it too."""
        rooms = {name: set(room.exports or ()) for name, room in pkg.modules.items()}
        for module in (pkg, *pkg.modules.values()):
            elsewhere = []
            for name in map(str, module.exports or ()):
                held = module.members.get(name)
                if not isinstance(held, griffe.Alias):
                    continue
                room = held.target_path.removeprefix(f"{pkg.name}.").partition(".")[0]
                # An alias of an alias says which package it was imported from, which offers it as well.
                while room in rooms and isinstance(target := pkg[room].members.get(name), griffe.Alias):
                    onward = target.target_path.removeprefix(f"{pkg.name}.").partition(".")[0]
                    if onward == room:
                        break
                    room = onward
                if room in rooms and name in rooms[room] and pkg[room] is not module:
                    elsewhere.append(_reference(f"{pkg.name}.{room}.{name}", f"{room}.{name}"))
                    del module.members[name]
            if elsewhere and module.docstring is not None:
                module.docstring.value += f"\n\nDescribed on other pages: {', '.join(elsewhere)}."
