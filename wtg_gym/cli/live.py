"""`wtg-gym play`: a page in the browser, served on this machine only."""

from __future__ import annotations

import argparse
from typing import Any

from wtg_gym.cli.output import note, require_extra
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.cli.suites_command import suite_name, suites_by_version
from wtg_gym.envs.settings import VERSIONS, EnvSettings
from wtg_gym.plotting.live.match import Scale, split_of
from wtg_gym.ranges import require_range
from wtg_gym.scenarios import get_suite

_PLAY = """\
Opens a page in the browser on which you hold the frequency by hand, in real time: sliders and keys set k and τ of each
WTG group, as an agent's actions do. The reference, which never acts, plays the same scenario beside you. Events are
shown as they happen. At the end your run is scored as an agent's is. The page is served on this machine only."""
_PLAY_EXAMPLES = """\
  wtg-gym play
  wtg-gym play --suite faults-v1 --seed 20003
  wtg-gym play --version v0 --speed 0.5
  wtg-gym play --port 5006 --no-browser"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym play`."""
    parser = add_command(commands, "play", _run_play, description=_PLAY, examples=_PLAY_EXAMPLES)
    parser.add_argument(
        "--suite",
        type=suite_name,
        metavar="NAME",
        help=f"suite, of {suites_by_version()} (default: standard of the version)",
    )
    parser.add_argument(
        "--version", choices=VERSIONS, help="of the benchmark (default: the suite's; without a suite v1)"
    )
    parser.add_argument("--seed", type=int, metavar="N", help="seed of the suite (default: its first test seed)")
    parser.add_argument("--duration", type=float, metavar="S", help="length of a run [s] (default: the suite's)")
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="X", help="simulated seconds per second, 0.1 … 20 (default: 1)"
    )
    server = parser.add_argument_group("server")
    server.add_argument(
        "--port", type=int, default=0, metavar="N", help="port at localhost (default: any that is free)"
    )
    server.add_argument("--no-browser", action="store_true", help="do not open a browser, only say the address")


def _run_play(arguments: argparse.Namespace) -> int:
    require_range("--speed", arguments.speed, 0.1, 20.0, "")
    settings = EnvSettings(suite=arguments.suite, version=arguments.version, duration_s=arguments.duration)
    suite = get_suite(settings.suite)
    seed = suite.test[0] if arguments.seed is None else arguments.seed
    split_of(suite, seed)
    require_extra("bokeh", "wtg-gym play")
    from wtg_gym.plotting.live.play_page import PlayPage
    from wtg_gym.plotting.live.server import make_server, serve

    def fill(document: Any) -> None:
        PlayPage(document, scale, seed, arguments.speed)

    # First, since a port that is in use need not wait for the anchors.
    server = make_server(fill, arguments.port)
    note(f"playing the anchors of {suite.name}, which make the scale of the score")
    scale = Scale.of(suite, arguments.duration)
    serve(server, opens_browser=not arguments.no_browser, say=note)
    return 0
