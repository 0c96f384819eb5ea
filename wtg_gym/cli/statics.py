"""`analyse statics`: equilibria, power-frequency characteristics and critical frequencies of any law at any wind."""

from __future__ import annotations

import argparse
import contextlib
import csv
import dataclasses
import io
from typing import Any

import numpy as np

from wtg_gym.cli import output
from wtg_gym.cli.laws import add_law_option, chosen_laws
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.scenario import WIND_SPEED_RANGE
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.ranges import require_range
from wtg_gym.reproduce import steady_states
from wtg_gym.reproduce.power_frequency import critical_frequency_pu, named_points

_DESCRIPTION = f"""\
Steady states of one WTG on a grid of constant frequency: where a law has an equilibrium, whether it is stable, how
power and rotor speed depend on the frequency, and the critical frequency below which there is no equilibrium and the
rotor stalls. The pitch protection holds power and rotor speed at their limits, as in the simulator; --fine-pitch
leaves it out, as the paper does. Points named by the paper are at fine pitch: A at the set-point, B at ω_min or where
the equilibrium is lost, C at ω_max, M where the rotor passes the maximum power point.

strategies: {", ".join(STRATEGIES)}"""

_EXAMPLES = """\
  wtg-gym analyse statics                                          every strategy at 8 and 11.4 m/s
  wtg-gym analyse statics --law deloaded-5 my_law.toml --wind 6 8 10 --json
  wtg-gym analyse statics --law mppt --wind 8 --frequency 0.995 1.005 --points 201 --csv characteristic.csv
  wtg-gym analyse statics --law deloaded-10 --plot characteristic.svg"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym analyse statics`."""
    parser = add_command(commands, "statics", run, description=_DESCRIPTION, examples=_EXAMPLES)
    add_law_option(parser, "all")
    parser.add_argument(
        "--wind",
        type=float,
        nargs="+",
        default=[8.0, 11.4],
        metavar="V",
        help="wind speeds, 3 … 25 m/s (default: 8 11.4)",
    )
    parser.add_argument(
        "--frequency",
        type=float,
        nargs=2,
        default=[0.988, 1.012],
        metavar=("LOW", "HIGH"),
        help="range of the characteristic [p.u.] (default: 0.988 1.012)",
    )
    parser.add_argument("--points", type=int, default=97, metavar="N", help="its frequencies, 2 … 100000 (default: 97)")
    parser.add_argument("--fine-pitch", action="store_true", help="hold the blades at 0°: no pitch protection")
    out = parser.add_argument_group("output")
    out.add_argument(
        "--plot", metavar="FILE", help=f"characteristics of one law as a figure: {', '.join(output.PLOT_SUFFIXES)}"
    )
    out.add_argument("--csv", metavar="FILE", help="every equilibrium over frequency, units in the header: .csv")
    out.add_argument("--json", action="store_true", help="print everything as JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym analyse statics`."""
    plot = output.check_plot_file(arguments.plot)
    table = None if arguments.csv is None else output.check_output_file("--csv", arguments.csv, (".csv",))
    laws = chosen_laws(arguments)
    if plot is not None and len(laws) != 1:
        raise ValueError(f"--plot draws one law, {len(laws)} are given: add --law NAME")
    winds = [require_range("--wind", wind, *WIND_SPEED_RANGE, "m/s") for wind in arguments.wind]
    low, high = (
        require_range("--frequency", value, *steady_states.FREQUENCY_RANGE, "p.u.") for value in arguments.frequency
    )
    if not low < high:
        raise ValueError(f"--frequency {low:g} {high:g}: the first value must be the lower one")
    if not 2 <= arguments.points <= 100_000:
        raise ValueError(f"--points = {arguments.points} is outside the allowed range 2 … 100000")
    frequencies = [float(value) for value in np.linspace(low, high, arguments.points)]
    found = [_statics(law, wind, frequencies, arguments.fine_pitch) for law in laws for wind in winds]
    if table is not None:
        output.write_and_say(table, _csv(found))
    if plot is not None:
        from wtg_gym.plotting import figure_bytes
        from wtg_gym.reproduce.characteristics import plot_characteristic

        output.write_and_say(plot, figure_bytes(plot_characteristic(laws[0], winds), plot.suffix.lower()))
    if arguments.json:
        output.print_json({"laws": [law.to_dict() for law in laws], "statics": found})
    else:
        _print(found)
    return 0


def _statics(law: TrackingLaw, wind: float, frequencies: list[float], fine_pitch: bool) -> dict[str, Any]:
    control = GridFormingParameters()
    nominal = control.frequency_setpoint_pu
    # No equilibrium at any frequency is an answer here, no error.
    critical, somewhere, points = None, False, {}
    with contextlib.suppress(ValueError):
        critical, somewhere = critical_frequency_pu(law, wind, fine_pitch=fine_pitch), True
    with contextlib.suppress(ValueError):
        points = named_points(law, wind)
    corners = {
        "frequency_min": control.frequency_min_pu,
        "frequency_setpoint": nominal,
        "frequency_max": control.frequency_max_pu,
    }
    return {
        "law": law.name,
        "wind_m_s": wind,
        "fine_pitch": fine_pitch,
        "available_power_pu": float(available_power_pu(wind)),
        "has_equilibrium_from_setpoint_on": somewhere,
        "has_equilibrium_at_setpoint": steady_states.power_margin_pu(nominal, law, wind, fine_pitch=fine_pitch) >= 0.0,
        "critical_frequency_pu": critical,
        "critical_frequency_hz": None if critical is None else modified_ieee14().frequency_hz * critical,
        "stable_equilibrium_at": {
            name: _point(steady_states.stable_equilibrium(frequency, law, wind, fine_pitch=fine_pitch))
            for name, frequency in corners.items()
        },
        "named_points": {name: _point(point) for name, point in points.items()},
        "characteristic": [
            {
                "frequency_pu": frequency,
                "equilibria": [
                    _point(point) for point in steady_states.equilibria(frequency, law, wind, fine_pitch=fine_pitch)
                ],
            }
            for frequency in frequencies
        ],
    }


def _point(point: steady_states.OperatingPoint | None) -> dict[str, Any] | None:
    return None if point is None else dataclasses.asdict(point)


def _print(found: list[dict[str, Any]]) -> None:
    rows = [
        (
            entry["law"],
            f"{entry['wind_m_s']:g}",
            f"{entry['available_power_pu']:.4f}",
            *(_short(point) for point in entry["stable_equilibrium_at"].values()),
            _critical(entry),
        )
        for entry in found
    ]
    control = GridFormingParameters()
    corners = control.frequency_min_pu, control.frequency_setpoint_pu, control.frequency_max_pu
    heads = (f"p, ω_m at ω = {frequency:g}" for frequency in corners)
    output.print_table(("law", "wind [m/s]", "available", *heads, "no equilibrium below"), rows)
    output.say("", "powers and speeds in p.u.; – : no stable equilibrium; * : held by the pitch protection")


def _short(point: dict[str, Any] | None) -> str:
    if point is None:
        return "–"
    return f"{point['power_pu']:.4f}, {point['rotor_speed_pu']:.4f}{'*' if point['pitch_deg'] > 0.0 else ''}"


def _critical(entry: dict[str, Any]) -> str:
    if not entry["has_equilibrium_from_setpoint_on"]:
        return "none from ω_st on"
    if entry["critical_frequency_pu"] is None:
        return "never"
    return f"{entry['critical_frequency_pu']:.5f} p.u., {entry['critical_frequency_hz']:.3f} Hz"


def _csv(found: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    names = [field.name for field in dataclasses.fields(steady_states.OperatingPoint)]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["law", "wind_m_s", *names])
    for entry in found:
        for point in (point for row in entry["characteristic"] for point in row["equilibria"]):
            values = [f"{v:.9g}" if isinstance(v, float) else str(v).lower() for v in (point[n] for n in names)]
            writer.writerow([entry["law"], f"{entry['wind_m_s']:g}", *values])
    return text.getvalue()
