"""What the site makes of pages: links that hold there, and sections of the README. `make site` checks the whole."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
KNOWN = frozenset({"index.md", "start.md", "usage.md", "howto/law.md", "training.md", "leaderboard.md", "images/a.png"})


@pytest.fixture(scope="module")
def hooks() -> Any:
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "docs/site/hooks.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("source", "here", "link", "there"),
    [
        ("docs/usage.md", "usage.md", "[a](howto/law.md#see-it-run)", "[a](howto/law.md#see-it-run)"),
        ("docs/howto/law.md", "howto/law.md", "[a](../usage.md)", "[a](../usage.md)"),
        ("docs/howto/law.md", "howto/law.md", "[`a`](../../agents/README.md)", "[`a`](../training.md)"),
        ("docs/usage.md", "usage.md", "[a](../README.md#train)", "[a](start.md#train)"),
        ("docs/howto/law.md", "howto/law.md", "[a](../../README.md#leaderboard)", "[a](../leaderboard.md)"),
        ("docs/usage.md", "usage.md", "[a](../README.md#no-section)", "[a](index.md)"),
        ("agents/README.md", "training.md", "[a](../docs/usage.md#suites)", "[a](usage.md#suites)"),
        ("README.md", "start.md", "![a](docs/images/a.png)", "![a](images/a.png)"),
        (
            "docs/usage.md",
            "usage.md",
            "[a](#suites) [b](https://example.org/)",
            "[a](#suites) [b](https://example.org/)",
        ),
        ("docs/usage.md", "usage.md", "`[a](../LICENSE)`", "`[a](../LICENSE)`"),
        ("docs/usage.md", "usage.md", "[a](no/such/file.md)", "[a](no/such/file.md)"),
    ],
)
def test_links_lead_to_pages_of_the_site(hooks: Any, source: str, here: str, link: str, there: str) -> None:
    assert hooks.rewritten(link, here, source, "https://host/repo", KNOWN) == there


def test_links_to_other_files_lead_to_the_repository_or_are_text(hooks: Any) -> None:
    links = "[`law`](../LICENSE), [tests](../tests) and [x](../README.md)"
    known = "[`law`](https://host/repo/blob/main/LICENSE), [tests](https://host/repo/tree/main/tests) and [x](index.md)"
    assert hooks.rewritten(links, "usage.md", "docs/usage.md", "https://host/repo", KNOWN) == known
    assert hooks.rewritten(links, "usage.md", "docs/usage.md", "", KNOWN) == "`law`, tests and [x](index.md)"


class _Page:
    def __init__(self, path: str) -> None:
        self.src_uri, self.file, self.parent, self.meta = path, self, None, {}


class _Config:
    def __init__(self) -> None:
        self.extra = {"repository": ""}


@pytest.mark.parametrize("made", [True, False])
def test_the_leaderboard_is_shown_where_it_was_made(hooks: Any, made: bool) -> None:
    files = [_Page("leaderboard.html")] if made else []
    text = hooks.on_page_markdown("# Leaderboard\n", _Page("leaderboard.md"), _Config(), files)
    # A page of the site is the folder `leaderboard/`.
    assert ('<iframe class="leaderboard" src="../leaderboard.html"' in text) is made


def test_sections_of_the_readme_end_where_the_next_begins(hooks: Any) -> None:
    text = "# T\n\n## One\n\n```\n# a\n```\n\n### Deep\n\nb\n\n## Two words\n\nc\n"
    assert hooks.section(text, "one", "") == "## One\n\n```\n# a\n```\n\n### Deep\n\nb\n\n"
    assert hooks.section(text, "two-words", "Two words") == "\n\nc\n"
    with pytest.raises(ValueError, match="no heading 'three'"):
        hooks.section(text, "three", "")
