"""Changes that the site makes to pages; GitHub shows them unchanged.

- A few files outside docs/ are pages of the site too; the README is its home.
- A link to another file of the repository leads to the repository's address; while that is unknown, it is text, as is
  one to an address that a release fills in.
- A link that `<!-- include -->` follows, to a heading of README.md, becomes that section: the README says it once.
- `<!-- include FILE.py -->` becomes the program beside the page.
"""

import posixpath
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
#: Files outside docs/, and what they are called as pages of the site.
OUTSIDE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "agents/README.md": "training.md",
}
#: Code, or a link or picture with its text, file and anchor; a link in code is left alone.
_LINK = re.compile(
    r"^```.*?^```|`[^`\n]+`|(!?)\[((?:`[^`]*`|[^\[\]`])*)\]\(([^()\s:#]*)(#[^()\s]*)?\)", flags=re.MULTILINE | re.DOTALL
)
_INCLUDED = re.compile(r"^.*\]\(\.\./README\.md#([\w-]+)\) *<!-- include -->$", flags=re.MULTILINE)
_PROGRAM = re.compile(r"^<!-- include (\w+\.py) -->$", flags=re.MULTILINE)


def section(text: str, anchor: str, title: str) -> str:
    """Return a section of a page, up to the next heading of its level; with its heading, unless that is `title`.

    A ValueError says that the heading is missing.
    """
    # A comment in code is not a heading.
    bare = re.sub(r"^```.*?^```", lambda code: " " * len(code[0]), text, flags=re.MULTILINE | re.DOTALL)
    for heading in re.finditer(r"^(##+) (.*)$", bare, flags=re.MULTILINE):
        if heading[2].lower().replace(" ", "-") == anchor:
            end = re.search(rf"^#{{1,{len(heading[1])}}} ", bare[heading.end() :], flags=re.MULTILINE)
            start = heading.end() if heading[2] == title else heading.start()
            return text[start : heading.end() + end.start() if end else len(text)]
    raise ValueError(f"README.md has no heading {anchor!r}")


def rewritten(text: str, here: str, source: str, repository: str, known: frozenset[str]) -> str:
    """Return a page's Markdown with links that hold on the site, where `here` is its path and `known` are all paths.

    Its links start from `source`, the path of its file in the repository, whose address may be unknown, "".
    """

    def replaced(match: re.Match[str]) -> str:
        mark, label, file, anchor = match[1], match[2], match[3], match[4] or ""
        if label is None or not file:
            return match[0]
        if file.endswith("_URL"):
            return label  # a release fills it in
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), file))
        target = OUTSIDE.get(path, path.removeprefix("docs/") if path.startswith("docs/") else "")
        if target in known:
            return f"{mark}[{label}]({posixpath.relpath(target, posixpath.dirname(here) or '.')}{anchor})"
        if mark or not (ROOT / path).exists():
            return match[0]  # a mistake, which the site's own check of links names
        if not repository:
            return label
        return f"[{label}]({repository}/{'tree' if (ROOT / path).is_dir() else 'blob'}/main/{path}{anchor})"

    return _LINK.sub(replaced, text)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages from outside docs/."""
    from mkdocs.structure.files import File  # the tests of the rest need no MkDocs

    for path, name in OUTSIDE.items():
        files.append(File.generated(config, name, abs_src_path=str(ROOT / path)))
    return files


def on_config(config: Any) -> Any:
    """Show the way to the repository, if it is known."""
    if config.extra["repository"]:
        config.extra["social"] = [{"icon": "fontawesome/brands/github", "link": config.extra["repository"]}]
    return config


def on_page_markdown(text: str, page: Any, config: Any, files: Any) -> str:
    """Put sections of the README where they are asked for, and mend links."""
    here = page.file.src_uri
    source = next((path for path, name in OUTSIDE.items() if name == here), f"docs/{here}")
    known = frozenset(file.src_uri for file in files if file.inclusion.is_included())
    repository = (config.extra["repository"] or "").rstrip("/")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    beside = ROOT / posixpath.dirname(source)
    text = _PROGRAM.sub(lambda name: f"```python\n{(beside / name[1]).read_text(encoding='utf-8')}```", text)
    # Every second part is the anchor of a section.
    parts = _INCLUDED.split(text)
    parts[0::2] = [rewritten(part, here, source, repository, known) for part in parts[0::2]]
    for place, anchor in enumerate(parts[1::2]):
        included = section(readme, anchor, text.partition("\n")[0].removeprefix("# "))
        parts[2 * place + 1] = rewritten(included, here, "README.md", repository, known)
    if here == "index.md" and repository:
        # Above the first heading, that of the installation.
        parts[0] = parts[0].replace("\n## ", f"\n[Source code]({repository}){{ .md-button }}\n\n## ", 1)
    if here == "leaderboard.md":
        page.meta["hide"] = ["navigation", "toc"]  # the table has the whole width
    elif page.parent is None:
        page.meta["hide"] = ["navigation"]  # the only page of its section
    return "".join(parts)
