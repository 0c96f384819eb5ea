"""How the API reference reads the sources.

- A docstring names other objects as Sphinx does, :class:`Name`; on the site these are links.
- The comment `#:` above a constant or a field is its description, as is a comment behind a field.
- A name that several modules offer is described once, on the page of the package that holds it; the others link there.
"""

import itertools
import re
from typing import Any

import griffe

#: A comment behind code, which is not for a program such as mypy or ruff.
_BEHIND = re.compile(r"\s# (?!type:|noqa)(.+)$")
_ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):`(~?)([\w.]+)`")


def _reference(path: str, shown: str) -> str:
    """Return a link to an object, which is code where the site does not have the object."""
    return f'<autoref identifier="{path}" optional><code>{shown}</code></autoref>'


class Docstrings(griffe.Extension):
    """Prepares what mkdocstrings shows."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Turn roles in an object's docstring into links."""
        if obj.docstring is None:
            return

        def link(match: re.Match[str]) -> str:
            tilde, name = match.groups()
            try:
                path = obj.resolve(name)
            except griffe.NameResolutionError:
                path = name
            return _reference(path, name.rpartition(".")[2] if tilde else name)

        obj.docstring.value = _ROLE.sub(link, obj.docstring.value)

    def on_attribute(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Take the comment above a constant or a field, or behind a field, as its docstring."""
        if attr.docstring is not None or attr.lineno is None:
            return
        lines = [line.strip() for line in attr.lines_collection[attr.filepath]]
        above = list(itertools.takewhile(lambda line: line.startswith("#:"), reversed(lines[: attr.lineno - 1])))
        behind = _BEHIND.search(lines[(attr.endlineno or attr.lineno) - 1])
        if above:
            text = " ".join(line.removeprefix("#:").strip() for line in reversed(above))
        elif behind and isinstance(attr.parent, griffe.Class):
            text = behind[1]
        else:
            return
        attr.docstring = griffe.Docstring(text, parent=attr)

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Leave each name to the package that holds it, where that offers it too."""
        offered = {name: set(room.exports or ()) for name, room in pkg.modules.items()}
        for module in (pkg, *pkg.modules.values()):
            elsewhere = []
            for name in map(str, module.exports or ()):
                held = module.members.get(name)
                if not isinstance(held, griffe.Alias):
                    continue
                room = held.canonical_path.removeprefix(f"{pkg.name}.").partition(".")[0]
                if room != module.name and name in offered.get(room, ()):
                    elsewhere.append(_reference(f"{pkg.name}.{room}.{name}", f"{room}.{name}"))
                    del module.members[name]
            if elsewhere and module.docstring is not None:
                module.docstring.value += f"\n\nDescribed on other pages: {', '.join(elsewhere)}."
