"""The page of play in a headless Chromium: keys, sliders, score, and no complaint on the console."""

from __future__ import annotations

import re
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.cli.calls import start

pytest.importorskip("bokeh", reason="the page is Bokeh's")
pytest.importorskip("playwright.sync_api", reason="a browser is driven by playwright")


@contextmanager
def _served(browser: Any, *command: str) -> Iterator[Any]:
    """Serve a command's page and open it twice, for a visitor must not disturb another; Ctrl-C ends it without ado."""
    process = start(*command, "--no-browser", stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    try:
        said = ""
        for said in process.stderr:
            if "the page is at" in said:
                break
        found = re.search(r"http://localhost:\d+/", said)
        assert found, said
        pages, complaints = [], []
        for _ in range(2):
            page = browser.new_page(viewport={"width": 1366, "height": 900})
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
            page.goto(found[0])
            page.wait_for_function("window.Bokeh?.documents[0]?.roots().length > 0")
            pages.append(page)
        yield pages[1]
        assert complaints == []
        for page in pages:
            page.close()
    finally:
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=60)[1]
    assert process.returncode == 0
    assert rest == "ended\n"


def _model(page: Any, name: str, attribute: str) -> Any:
    return page.evaluate("([n, a]) => Bokeh.documents[0].get_model_by_name(n)[a]", [name, attribute])


def _wait(page: Any, name: str, attribute: str, test: str) -> None:
    page.wait_for_function(
        f"([n, a]) => (({test})(Bokeh.documents[0].get_model_by_name(n)[a]))", arg=[name, attribute], timeout=60_000
    )


def test_play_is_moved_by_keys_and_sliders_and_scored_at_the_end(browser: Any) -> None:
    with _served(browser, "play", "--suite", "standard-v1", "--duration", "8", "--speed", "4") as page:
        page.keyboard.press("2")
        _wait(page, "chosen", "active", "(x) => x === 2")
        page.keyboard.press("ArrowUp")
        _wait(page, "k1", "value", "(x) => x === 0.1")
        assert [_model(page, f"k{j}", "value") for j in (0, 2, 3)] == [0, 0, 0]
        page.keyboard.press("0")
        page.keyboard.press("ArrowRight")
        _wait(page, "τ3", "value", "(x) => x === 0.25")
        page.keyboard.press(" ")
        _wait(page, "status", "text", "(x) => x.includes('running')")
        page.evaluate("Bokeh.documents[0].get_model_by_name('k0').value = -0.5")
        # All groups are chosen: one slider moves them all.
        _wait(page, "k3", "value", "(x) => x === -0.5")
        page.keyboard.press(" ")
        _wait(page, "status", "text", "(x) => x.includes('paused')")
        page.keyboard.press(" ")
        _wait(page, "verdict", "text", "(x) => x.includes('Score')")
        # The first load of this scenario is lost within the run.
        assert "MW at bus" in _model(page, "events", "text")
        assert "coordinated-tuned" in _model(page, "verdict", "text")
        page.keyboard.press("n")
        _wait(page, "status", "text", "(x) => x.includes('scenario 20001')")
        assert _model(page, "k0", "value") == 0 and _model(page, "verdict", "text") == ""
