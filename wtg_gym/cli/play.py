"""`wtg-gym play`: a page in the browser, served on this machine only."""

import webbrowser
from typing import Annotated

from cyclopts import Parameter, validators

from wtg_gym.cli import options, output


def play(
    *,
    suite: options.SuiteName = options.DEFAULT_SUITE,
    seed: options.Whole | None = None,
    duration: float | None = None,
    speed: Annotated[float, Parameter(validator=validators.Number(gte=0.1, lte=20.0))] = 1.0,
    port: Annotated[options.Whole, Parameter(validator=validators.Number(gte=0, lte=65535))] = 0,
    no_browser: options.Flag = False,
) -> int:
    """Open a page in the browser on which you hold the frequency by hand, in real time.

    Two sliders set k and τ of all WTG groups, as an agent's actions do. The reference plays the same scenario with zero
    actions. Events are shown as they happen. At the end your cost, in v1 your score too, is compared with those of both
    reference laws. The page is served on this machine only.

    examples:
      wtg-gym play
      wtg-gym play --suite faults-v1 --seed 10003
      wtg-gym play --suite standard --speed 0.5 --port 5006 --no-browser

    Args:
        suite: one of those that `wtg-gym suites` lists
        seed: seed of the suite; default: its first validation seed
        duration: length of a run [s]; default: the suite's
        speed: simulated seconds per second, 0.1 … 20
        port: port at localhost; 0: any that is free
        no_browser: do not open a browser, only print the address
    """
    from wtg_gym.plotting.live import Match, PlayPage
    from wtg_gym.scenarios import get_suite

    chosen = get_suite(suite)
    # Refuses a duration or a seed that is out of range.
    match = Match(chosen, chosen.validation[0] if seed is None else seed, duration)
    output.require_extra("bokeh", "wtg-gym play")
    from bokeh.server.server import Server

    server = Server({"/": lambda document: PlayPage(document, match, speed)}, port=port, address="localhost")
    url = f"http://localhost:{server.port}/"
    server.start()
    output.note(f"open {url} (Ctrl-C ends it)")
    if not no_browser and not webbrowser.open(url):
        output.note("there is no browser here: open that address in a browser on this machine")
    try:
        server.io_loop.start()
    except KeyboardInterrupt:
        output.note("ended")
    finally:
        server.stop()
    return 0
