"""`wtg-gym play`: a page in the browser, served on this machine only."""

from __future__ import annotations

from typing import Any, Literal

from wtg_gym.cli.options import Flag, SuiteName, Whole
from wtg_gym.cli.output import note, require_extra
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.plotting.live.match import Scale, split_of
from wtg_gym.ranges import require_range
from wtg_gym.scenarios import get_suite


def play(
    *,
    suite: SuiteName | None = None,
    version: Literal["v0", "v1"] | None = None,
    seed: Whole | None = None,
    duration: float | None = None,
    speed: float = 1.0,
    port: Whole = 0,
    no_browser: Flag = False,
) -> int:
    """Open a page in the browser on which you hold the frequency by hand, in real time.

    Sliders and keys set k and τ of each WTG group, as an agent's actions do. The reference, which never acts, plays the
    same scenario beside you. Events are shown as they happen. At the end your run is scored as an agent's is. The page
    is served on this machine only.

    examples:
      wtg-gym play
      wtg-gym play --suite faults-v1 --seed 20003
      wtg-gym play --version v0 --speed 0.5
      wtg-gym play --port 5006 --no-browser

    Args:
        suite: one of those that `wtg-gym suites` lists; default: standard of the version
        version: of the benchmark; default: that of the suite, without a suite v1
        seed: seed of the suite; default: its first test seed
        duration: length of a run [s]; default: the suite's
        speed: simulated seconds per second, 0.1 … 20
        port: port at localhost; 0: any that is free
        no_browser: do not open a browser, only say the address
    """
    require_range("--speed", speed, 0.1, 20.0, "")
    settings = EnvSettings(suite=suite, version=version, duration_s=duration)  # type: ignore[arg-type]
    chosen = get_suite(settings.suite)
    first = chosen.test[0] if seed is None else seed
    split_of(chosen, first)
    require_extra("bokeh", "wtg-gym play")
    from wtg_gym.plotting.live.play_page import PlayPage
    from wtg_gym.plotting.live.server import make_server, serve

    def fill(document: Any) -> None:
        PlayPage(document, scale, first, speed)

    # First, since a port that is in use need not wait for the anchors.
    server = make_server(fill, port)
    note(f"playing the anchors of {chosen.name}, which make the scale of the score")
    scale = Scale.of(chosen, duration)
    serve(server, opens_browser=not no_browser, say=note)
    return 0
