"""One page, served on this machine only, until the server is stopped."""

from __future__ import annotations

import errno
import os
import sys
import webbrowser
from collections.abc import Callable
from typing import Any


def make_server(fill: Callable[[Any], None], port: int) -> Any:
    """Return a server at localhost that lets `fill` fill each document; a ValueError if the port cannot be had."""
    from bokeh.application import Application
    from bokeh.application.handlers.function import FunctionHandler
    from bokeh.server.server import Server

    if not 0 <= port <= 65535:
        raise ValueError(f"--port must be 0 … 65535, got {port}")
    try:
        return Server({"/": Application(FunctionHandler(fill))}, port=port, address="localhost")
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ValueError(f"--port {port} is in use; give another one, or 0 for any that is free") from error
        if error.errno == errno.EACCES:
            raise ValueError(f"--port {port} is for administrators only; give one from 1024 on") from error
        raise


def serve(server: Any, *, opens_browser: bool, say: Callable[[str], None]) -> None:
    """Serve until Ctrl-C; `say` tells where."""
    url = f"http://localhost:{server.port}/"
    server.start()
    say(f"the page is at {url}; Ctrl-C ends it")
    if opens_browser and not open_browser(url):
        say("there is no display or browser here: open that address in a browser on this machine")
    try:
        server.io_loop.start()
    except KeyboardInterrupt:
        say("ended")
    finally:
        server.stop()


def open_browser(url: str) -> bool:
    """Open an address in the user's browser; return whether there is a display and a browser for it."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        # A browser for terminals would take this one over.
        return False
    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False
