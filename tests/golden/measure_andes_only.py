"""Measure what the models of ANDES that have no counterpart here change in the load increase.

ANDES runs the events of the golden case `grid-forming` with other models, and says how far they take the frequency.
ANDES has drive trains (WTDTA1) only behind grid-following converters and in constant wind power, so that theirs is put
into our own kernel: between its steps two masses of the NREL 5 MW turbine, and for comparison one, go on by
themselves, and the kernel sees the generator's speed.

Usage:
    make .venv-golden/ready-3.11
    .venv-golden/bin/python -m tests.golden.measure_andes_only --page docs/validation.md
"""

from __future__ import annotations

import argparse
import dataclasses
import logging
from pathlib import Path

import andes
import numpy as np

from tests.golden.make_andes_cases import (
    CASES,
    FORMING_UNITS,
    IMPEDANCES,
    STEPS_UP,
    Case,
    Floats,
    build_system,
    machine_keys,
    network_of,
    simulate,
)
from wtg_gym.analysis.case_file import read_parameters
from wtg_gym.analysis.load_models import run_with_loads
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.aerodynamics import power_coefficient
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, group_laws
from wtg_gym.scenarios import get_suite

GOLDEN = Path(__file__).parent
STEPS_PER_SECOND, ROWS_PER_SECOND, HERTZ = 96, 48, 50.0
#: ANDES' own data of grid-forming converters; with 0.55 p.u. of reactance its voltage controllers are unstable.
REACTANCE_PU, PLL_DAMPING = 0.2, 0.11
VOLTAGE_GAINS = {"KPi": 0.5, "KIi": 20.0, "KPv": 3.0, "KIv": 10.0}
POWER_GAINS = {"KPplim": 5.0, "KIplim": 30.0, "KPqlim": 0.1, "KIqlim": 1.5}
#: Shares of constant power, current and impedance.
LOADS = {
    "constant impedance": IMPEDANCES,
    "constant current": (0.0, 1.0, 0.0),
    "constant power": (1.0, 0.0, 0.0),
}
#: NREL 5 MW turbine, seen from the slow shaft: inertia of rotor and generator [kg m²], stiffness [N m/rad] and damping
#: [N m s/rad] of the shaft. Source: NREL/TP-500-38060; inertia of the rotor as FAST gives it.
ROTOR_INERTIA, GENERATOR_INERTIA, STIFFNESS, DAMPING = 38_759_228.0, 534.116 * 97.0**2, 867.637e6, 6.215e6


@dataclasses.dataclass(frozen=True)
class Answer:
    """Frequency of the centre of inertia: lowest and last [Hz], and its fall in the first 0.5 s of the first event."""

    nadir_hz: float
    final_hz: float
    fall_mhz: float

    def cells(self) -> tuple[str, str, str]:
        """Return the numbers as a table has them."""
        return f"{self.nadir_hz:.4f}", f"{self.final_hz:.4f}", f"{-self.fall_mhz:.1f}" if self.fall_mhz else "–"


def answer(times: Floats, hertz: Floats) -> Answer:
    """Return what is reported of a run."""
    first = STEPS_UP[0].time_s
    fall = hertz[np.argmin(np.abs(times - first - 0.5))] - HERTZ
    return Answer(float(hertz.min()), float(hertz[-1]), 1e3 * float(fall))


def in_andes(case: Case) -> Answer:
    """Run a case in ANDES."""
    network = network_of(case)
    static = build_system(case, network, ())
    voltage = dict(zip(static.Bus.idx.v, static.Bus.v.v.tolist(), strict=True))
    rows = np.setdiff1d(np.arange(60 * ROWS_PER_SECOND) / ROWS_PER_SECOND, [e.time_s for e in STEPS_UP])
    trace = simulate(case, network, STEPS_UP, voltage, STEPS_PER_SECOND, rows)
    momentum = {str(m.bus): m.two_h_s * m.rating_mva for m in network.machines}
    momentum |= {key: two_h * 50.0 for key, (_, two_h, _) in case.units.items()}
    weights = np.array([momentum[key] for key in machine_keys(network)])
    return answer(rows, HERTZ * (trace.w @ weights) / weights.sum())


def loads_here(model: str) -> Answer:
    """Run the golden case `genrou` with loads of a kind in our kernel."""
    case = read_parameters(GOLDEN / "genrou" / "params.json")
    scenario = Scenario(
        name="golden", wind_speed=np.zeros((0, 1)), events=case.events["a"], duration_s=60.0, load_noise_bus=1
    )
    run = run_with_loads(
        model, scenario, REFERENCE_STRATEGY, PlantSettings(case=case.network, groups=()), simulation_dt=0.0025
    )
    return Answer(run.nadir_hz, run.final_hz, 0.0)


def drive_train(masses: int, step_s: float = 0.0025) -> tuple[Answer, Floats, Floats]:
    """Run the paper's load increase with a drive train of one or two masses in our kernel.

    Returns:
        the answer, the smallest generator speeds of the groups [p.u.], and the largest twist of the shafts [degrees].
    """
    turbine = TurbineParameters(conserves_energy=True)
    settings = PlantSettings(turbine=turbine, control_dt=step_s, simulation_dt=step_s)
    simulator = Simulator(settings, duration_s=60.0)
    scenario = get_suite("paper").scenario(0, duration_s=60.0)
    simulator.plant.constants["turbine"]["rotor.inv_two_h"] = 0.0
    simulator.start(0, scenario, group_laws(REFERENCE_STRATEGY, len(settings.groups), turbine))
    simulator.evaluate()
    speed_base = turbine.nominal_rotor_speed_rad_s
    torque_base = 1e6 * turbine.rated_power_mw / speed_base
    share = ROTOR_INERTIA / (ROTOR_INERTIA + GENERATOR_INERTIA)
    rotor_2h, generator_2h = (2.0 * turbine.inertia_constant_s * part for part in (share, 1.0 - share))
    stiffness, damping = STIFFNESS * speed_base / torque_base, DAMPING * speed_base / torque_base
    wind = scenario.wind_speed[:, 0]
    wind_power = turbine.wind_power_pu_per_cubic_wind * wind**3
    row = simulator.layout.wtg("rotor_speed")
    start = simulator.wtg_values("rotor_speed")[0]
    power = simulator.wtg_values("power")[0]
    state = np.array([start, start, power / start])

    def rates(x: Floats, power: Floats) -> Floats:
        turning, generating, torque = x
        ratio = turbine.tip_speed_ratio_per_speed_m_s * turning / wind
        driving = wind_power * power_coefficient(ratio, 0.0, turbine.power_coefficient) / turning
        if masses == 1:
            both = (driving - power / turning) / (rotor_2h + generator_2h)
            return np.array([both, both, 0.0 * torque])
        shaft = torque + damping * (turning - generating)
        return np.array(
            [
                (driving - shaft) / rotor_2h,
                (shaft - power / generating) / generator_2h,
                stiffness * (turning - generating),
            ]
        )

    times, hertz, speeds, torques = [0.0], [HERTZ], [start], [state[2]]
    for interval in range(simulator.n_intervals):
        delivered = simulator.wtg_values("energy_delivered")[0]
        simulator.advance()
        power = (simulator.wtg_values("energy_delivered")[0] - delivered) / step_s
        k1 = rates(state, power)
        k2 = rates(state + 0.5 * step_s * k1, power)
        k3 = rates(state + 0.5 * step_s * k2, power)
        k4 = rates(state + step_s * k3, power)
        state = state + step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        simulator.blocks[0, row] = state[1]
        times.append((interval + 1) * step_s)
        hertz.append(HERTZ * float(simulator.lane_values("coi")[0]))
        speeds.append(state[1])
        torques.append(state[2])
    twist = np.degrees(np.ptp(torques, axis=0) / stiffness * speed_base)
    return answer(np.array(times), np.array(hertz)), np.min(speeds, axis=0), twist


def forming_runs() -> dict[str, Case]:
    """Return the case `grid-forming` with ANDES' reactance, with and without what our converter does not have."""
    case = next(case for case in CASES if case.name == "grid-forming")

    def units(model: str, **controls: float) -> Case:
        swing = FORMING_UNITS["2a"][1:]
        changed = {"xf": REACTANCE_PU, **controls}
        return dataclasses.replace(case, units=dict.fromkeys(FORMING_UNITS, (model, *swing)), controls=changed)

    return {
        "REGF1, REGF2 as in the golden case": dataclasses.replace(case, controls={"xf": REACTANCE_PU}),
        "REGF1 with voltage and current controllers": units("REGF1", **VOLTAGE_GAINS),
        "REGF1 with its power limiters too": units("REGF1", **VOLTAGE_GAINS, **POWER_GAINS),
        "REGF2 with its damping by a PLL": units("REGF2", dd=PLL_DAMPING),
        "REGF3 with voltage and current controllers": units("REGF3", **VOLTAGE_GAINS),
    }


def tables() -> str:
    """Return what is measured as Markdown."""
    rows = []
    for name, case in forming_runs().items():
        try:
            rows.append((name, *in_andes(case).cells()))
        except RuntimeError:
            rows.append((name, "ANDES stops", "–", "–"))
    rotors = []
    for masses, name in ((1, "one mass, here"), (2, "two masses (WTDTA1), here")):
        run, speed, twist = drive_train(masses)
        rows.append((name, *run.cells()))
        rotors.append((speed, twist))
    genrou = next(case for case in CASES if case.name == "genrou")
    nadirs = {}
    for name, shares in LOADS.items():
        there, here = in_andes(dataclasses.replace(genrou, load_shares=shares)), loads_here(name)
        rows += [(f"loads of {name}", *there.cells()), (f"loads of {name}, here", *here.cells())]
        nadirs[name] = np.array([there.nadir_hz, here.nadir_hz])
    (speed, _), (own_speed, twist) = rotors
    lower = " and ".join(f"{1e3 * value:.2g}" for value in speed - own_speed)
    cost = 1e3 * (nadirs["constant impedance"] - nadirs["constant power"])
    table = markdown_table(("model", "nadir [Hz]", "at 60 s [Hz]", "fall in 0.5 s [mHz]"), rows, right=(1, 2, 3))
    return (
        f"{table}\n\nWith two masses the shafts twist by {' and '.join(f'{value:.2g}' for value in twist)}°, and the "
        f"generators' smallest speeds are {lower} · 10⁻³ p.u. lower.\nLoads of constant power cost "
        f"{cost[0]:.1f} mHz of nadir in ANDES and {cost[1]:.1f} mHz here."
    )


def main() -> None:
    """Measure, print, and put the tables between the markers `andes-only` of a page."""
    parser = argparse.ArgumentParser(description="Measure ANDES' models that have no counterpart here.")
    parser.add_argument("--page", help="Markdown file with the markers 'andes-only' to put the tables between")
    arguments = parser.parse_args()
    andes.config_logger(stream_level=logging.WARNING)
    logging.getLogger("andes").setLevel(logging.WARNING)
    text = tables()
    print(text)
    if arguments.page:
        update_between_markers(arguments.page, text, "andes-only")


if __name__ == "__main__":
    main()
