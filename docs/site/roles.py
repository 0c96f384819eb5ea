"""Docstrings name other objects as Sphinx does, :class:`Name`; on the site these are links."""

from __future__ import annotations

import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):`(~?)([\w.]+)`")


class Roles(griffe.Extension):
    """Turns roles into links to the object, or into code if the site does not have it."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite an object's docstring."""
        if obj.docstring is None:
            return

        def link(found: re.Match[str]) -> str:
            name = found[2]
            try:
                path = obj.resolve(name)
            except griffe.NameResolutionError:
                path = name
            shown = name.rpartition(".")[2] if found[1] else name
            return f'<autoref identifier="{path}" optional><code>{shown}</code></autoref>'

        obj.docstring.value = _ROLE.sub(link, obj.docstring.value)
