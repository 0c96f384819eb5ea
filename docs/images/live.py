"""`python docs/images/live.py PLAY.png`: the page of `wtg-gym play`, by Chromium.

Needs the extras `leaderboard` and `browser`.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

SIZE = {"width": 1366, "height": 970}


@contextmanager
def served(*command: str) -> Iterator[str]:
    call = [sys.executable, "-m", "wtg_gym.cli", *command, "--no-browser"]
    process = subprocess.Popen(call, stderr=subprocess.PIPE, encoding="utf-8")
    assert process.stderr is not None
    try:
        found = next(filter(None, (re.search(r"http://localhost:\d+/", line) for line in process.stderr)))
        yield found[0]
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate()


def model(name: str) -> str:
    return f"Bokeh.documents[0].get_model_by_name('{name}')"


def play(page: Any) -> None:
    page.get_by_text("Start", exact=True).click()
    # By the scenario's time, whatever the clock says.
    for second, k in ((16, -0.2), (20, -0.1), (36, 0.1), (40, -0.1)):
        page.wait_for_function(f"parseFloat({model('status')}.text.slice(3)) >= {second}", timeout=120_000)
        page.evaluate(f"{model('k')}.value = {k}")
    page.wait_for_function(f"{model('verdict')}.text !== ''", timeout=120_000)


def take(browser: Any, path: str, act: Callable[[Any], None], *command: str) -> None:
    with served(*command) as url:
        page = browser.new_page(viewport=SIZE)
        page.goto(url)
        page.wait_for_function("window.Bokeh?.documents[0]?.roots().length > 0")
        act(page)
        page.wait_for_timeout(1000)
        picture = Image.open(BytesIO(page.screenshot()))
        page.close()
    picture.convert("P", palette=Image.Palette.ADAPTIVE, colors=128).save(Path(path), optimize=True)


with sync_playwright() as driver:
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next(filter(None, map(shutil.which, names)), driver.chromium.executable_path)
    sandbox = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    browser = driver.chromium.launch(executable_path=found, args=sandbox)
    take(browser, sys.argv[1], play, "play", "--suite", "standard-v1", "--speed", "5")
    browser.close()
