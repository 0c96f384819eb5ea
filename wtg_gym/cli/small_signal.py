"""`wtg-gym analyse margins` and `analyse modes`: small-signal stability of one machine and of the whole system."""

from __future__ import annotations

import argparse
import dataclasses
import math
from typing import Any

import numpy as np

from wtg_gym.cli.laws import add_law_option, chosen_laws
from wtg_gym.cli.output import PLOT_SUFFIXES, check_plot_file, plain_json, print_json, print_table, say, write_and_say
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.envs.settings import MACHINE_MODELS
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.modes import Mode, Side, linearise, modes, synchronising_coefficients
from wtg_gym.physics.parameters import default_groups
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.reproduce.loops import (
    PAPER_SYNCHRONISING_COEFFICIENT,
    SingleMachine,
    ideal_source_loop,
    single_machine,
)
from wtg_gym.reproduce.tables import mode_cells

_SIDES: tuple[Side, ...] = ("under", "over")

_MARGINS = """\
Phase margin, crossover and gain margin of the paper's open-loop transfer functions: one WTG on an infinite bus with
the synchronising coefficient K_p. g(ω) may have two slopes, so that a law has a margin for frequencies under and one
for frequencies over the set-point. The pitch angle counts as constant, also where the pitch protection holds the
rotor (marked *). An unstable loop has no margin."""

_MODES = """\
Eigenvalues of the whole 14-bus system, linearised numerically from the simulator's own right-hand side around its
equilibrium: frequency, damping ratio, time constant, and the states that take part most (participation factors).
States are named by the bus of the synchronous machine (bus1, …) and by WTG group (wtg1, wtg2, …).

exit codes: 0 stable, 1 an eigenvalue has a positive real part, 2 bad input"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym analyse margins` and `wtg-gym analyse modes`."""
    parser = add_command(
        commands,
        "margins",
        run_margins,
        description=_MARGINS,
        examples="  wtg-gym analyse margins --wind 8 11.4\n  wtg-gym analyse margins --law my_law.toml --kp 2.0 --json",
    )
    add_law_option(parser, "all")
    parser.add_argument(
        "--wind", type=float, nargs="+", default=[11.4], metavar="V", help="wind speeds, 3 … 25 m/s (default: 11.4)"
    )
    parser.add_argument(
        "--kp",
        type=float,
        default=PAPER_SYNCHRONISING_COEFFICIENT,
        metavar="K",
        help="synchronising coefficient, 0.01 … 100 p.u./rad (default: 1.45, which gives the paper's margins)",
    )
    parser.add_argument("--plot", metavar="FILE", help=f"Bode plot, for one wind: {', '.join(PLOT_SUFFIXES)}")
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else, on stdout")
    _add_modes(commands)


def _add_modes(commands: Commands) -> None:
    parser = add_command(
        commands,
        "modes",
        run_modes,
        description=_MODES,
        examples=(
            "  wtg-gym analyse modes\n  wtg-gym analyse modes --law mppt deloaded-10 --wind 9 7 --plot modes.svg\n"
            "  wtg-gym analyse modes --law my_law.toml --side over --machine-model classical --json"
        ),
    )
    add_law_option(parser, REFERENCE_STRATEGY)
    parser.add_argument(
        "--wind",
        type=float,
        nargs="+",
        default=[11.4, 8.0],
        metavar="V",
        help="wind speed of each WTG group, 3 … 25 m/s; as many groups as values (default: 11.4 8)",
    )
    parser.add_argument("--side", choices=_SIDES, default="under", help="slope of g(ω) at ω_st (default: under)")
    parser.add_argument("--machine-model", choices=MACHINE_MODELS, default="genrou", help="(default: genrou)")
    parser.add_argument("--load-level", type=float, default=1.0, metavar="X", help="factor on every load (default: 1)")
    out = parser.add_argument_group("output")
    out.add_argument("--plot", metavar="FILE", help=f"eigenvalues as a figure: {', '.join(PLOT_SUFFIXES)}")
    out.add_argument(
        "--json", action="store_true", help="print modes and matrices as JSON, and nothing else, on stdout"
    )


def run_margins(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym analyse margins`."""
    plot = check_plot_file(arguments.plot)
    if plot is not None and len(arguments.wind) != 1:
        raise ValueError(f"--plot draws one wind speed, {len(arguments.wind)} are given")
    loops: list[tuple[str, SingleMachine]] = [("–", ideal_source_loop(arguments.kp))]
    for law in chosen_laws(arguments):
        for wind in arguments.wind:
            both = [single_machine(law, wind, arguments.kp, side=side) for side in _SIDES]
            if math.isclose(both[0].frequency_slope, both[1].frequency_slope, rel_tol=1e-9, abs_tol=1e-12):
                loops.append(("–", both[0]))
            else:
                loops += zip(_SIDES, both, strict=True)
    if plot is not None:
        from wtg_gym.plotting import figure_bytes
        from wtg_gym.reproduce.paper_figures import plot_bode

        named = {loop.law + (f", {side}-frequency" if side != "–" else ""): loop for side, loop in loops}
        write_and_say(plot, figure_bytes(plot_bode(named), plot.suffix.lower()))
    if arguments.json:
        print_json({"synchronising_coefficient": arguments.kp, "loops": [_loop(side, loop) for side, loop in loops]})
        return 0
    header = ("law", "wind [m/s]", "slope", "phase margin [°]", "crossover [rad/s]", "gain margin [dB]", "closed loop")
    print_table(header, [_cells(side, loop) for side, loop in loops], left=(0, 2, 6))
    if any(loop.pitch_deg > 0.0 for _, loop in loops):
        say("", "* held by the pitch protection, whose angle counts as constant here; `analyse modes` includes it")
    return 0


def _cells(side: str, loop: SingleMachine) -> tuple[str, ...]:
    found = loop.margins()
    gain = "∞" if math.isinf(found.gain_margin_db) else f"{found.gain_margin_db:.1f}"
    return (
        loop.law,
        "–" if math.isnan(loop.wind_m_s) else f"{loop.wind_m_s:g}{'*' if loop.pitch_deg > 0.0 else ''}",
        side,
        f"{found.phase_margin_deg:.1f}" if found.stable else "–",
        f"{found.crossover_rad_s:.2f}",
        gain if found.stable else "–",
        "stable" if found.stable else "unstable",
    )


def _loop(side: str, loop: SingleMachine) -> Any:
    data = dataclasses.asdict(loop) | {"side": None if side == "–" else side} | dataclasses.asdict(loop.margins())
    return plain_json(data | {"closed_loop_poles": loop.closed_loop_poles()})


def run_modes(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym analyse modes`; return 1 if an equilibrium is unstable."""
    plot = check_plot_file(arguments.plot)
    settings = PlantSettings(
        case=modified_ieee14(classical=arguments.machine_model == "classical"),
        groups=default_groups(len(arguments.wind)),
    )
    scenario = Scenario(
        name="modes",
        wind_speed=np.array(arguments.wind)[:, None],
        load_level=arguments.load_level,
    )
    laws = chosen_laws(arguments)
    models = {law.name: linearise(scenario, law, settings, side=arguments.side).renamed(settings) for law in laws}
    found = {name: modes(model) for name, model in models.items()}
    if plot is not None:
        from wtg_gym.plotting import figure_bytes
        from wtg_gym.reproduce.eigenvalue_plane import plot_modes

        write_and_say(plot, figure_bytes(plot_modes(found), plot.suffix.lower()))
    if arguments.json:
        described = [
            {
                "law": law.name,
                "synchronising_coefficients": synchronising_coefficients(scenario, law, settings),
                "state_names": models[law.name].state_names,
                "states_left_out": models[law.name].left_out,
                "matrix": models[law.name].matrix,
                "modes": [_mode(mode) for mode in found[law.name]],
            }
            for law in laws
        ]
        chosen = {name: getattr(arguments, name) for name in ("side", "machine_model")}
        print_json({"wind_m_s": arguments.wind, **chosen, "laws": plain_json(described)})
    else:
        header = ("eigenvalue [1/s]", "frequency [Hz]", "damping ratio", "time constant [s]", "takes part")
        for number, (name, table) in enumerate(found.items()):
            say(*[""] * bool(number), name)
            print_table(header, [mode_cells(mode) for mode in table], left=(0, 4))
    return int(any(mode.eigenvalue.real > 0.0 for table in found.values() for mode in table))


def _mode(mode: Mode) -> dict[str, Any]:
    data = dataclasses.asdict(mode)
    value = data.pop("eigenvalue")
    return {"real_1_s": value.real, "imaginary_rad_s": value.imag, **data}
