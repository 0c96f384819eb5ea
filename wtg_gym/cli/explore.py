"""`wtg-gym explore`: wind, events, laws and grids by widgets in the browser."""

from __future__ import annotations

import argparse
from typing import Any

from wtg_gym.cli.output import note, require_extra
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.play import add_server_options

_DESCRIPTION = """\
Opens a page in the browser on which wind, events, law and grid are changed by widgets; the run is simulated anew at
every change: frequency, rotor speeds, powers, tip-speed ratios, and the path on the power-frequency characteristic. Up
to two runs can be pinned to compare with. The scenario can be copied as JSON, which `wtg-gym simulate --scenario`
takes. The page is served on this machine only."""
_EXAMPLES = """\
  wtg-gym explore
  wtg-gym explore --port 5006 --no-browser"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym explore`."""
    parser = add_command(commands, "explore", run, description=_DESCRIPTION, examples=_EXAMPLES)
    add_server_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym explore`."""
    require_extra("bokeh", "wtg-gym explore")
    from wtg_gym.plotting.live.experiment import PLANTS, default_experiment
    from wtg_gym.plotting.live.explore_page import ExplorePage
    from wtg_gym.plotting.live.server import make_server, serve

    def fill(document: Any) -> None:
        ExplorePage(document)

    server = make_server(fill, arguments.port)
    # Compiles now, not while the first visitor waits.
    for plant in PLANTS:
        default_experiment(plant).run()
    serve(server, opens_browser=not arguments.no_browser, say=note)
    return 0
