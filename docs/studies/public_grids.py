"""Public grid files, brought in: how near their power flow is to the library's, and whether they stand still and start.

    python docs/studies/public_grids.py FILE ...

prints a table of networks of pandapower and of files (RAW, MATPOWER; a .dyr of the same name is used).
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandapower
import pandapower.networks

from wtg_gym.files import markdown_table
from wtg_gym.grids.reading import read_case
from wtg_gym.grids.wind import with_wind
from wtg_gym.physics.equilibrium import StartError
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import longest_step
from wtg_gym.physics.trajectory import simulate

NETWORKS = (
    "case9",
    "case14",
    "case24_ieee_rts",
    "case30",
    "case39",
    "case57",
    "case118",
    "case_illinois200",
    "iceland",
)
N_RESETS = 30


def row(path: Path) -> tuple[str, ...]:
    """Name, buses, load, differences, drift over 20 s at rest and resets of a file."""
    dynamic = path.with_suffix(".dyr") if path.with_suffix(".dyr").exists() else None
    try:
        read = read_case(path, dynamic, substitute=True)
        grid = with_wind(read)
    except ValueError as error:
        return path.name, "–", "–", str(error).partition(": ")[2][:120], "–", "–"
    near = read.substitutions[-1].partition("[p.u., rad]: ")[2]
    size = path.name, f"{len(grid.case.buses)}", f"{grid.case.load_mw:.6g}", near
    try:
        plant = Plant().replaced(physics="extended", case=grid.with_groups, groups=grid.groups, shares_dispatch=True)
        plant = plant.replaced(simulation_dt=longest_step(plant))
        still = Scenario(name="rest", wind_speed=np.full((len(grid.groups), 1), 10.0), duration_s=20.0,
                         load_noise_bus=grid.case.slack_bus)  # fmt: skip
        run = simulate(still, "coordinated-tuned", plant)
        drift = f"{np.abs(run.frequency_hz - grid.case.frequency_hz).max():.0e} Hz"
    except ValueError:
        drift = "does not start"
    started = 0
    try:
        env = gym.make("wtg_gym:GFMWTG-v1", grid=grid, reward="cost")
        for seed in range(N_RESETS):
            env.reset(seed=seed)
            started += 1
    except StartError:
        pass
    except ValueError as error:
        return (*size, drift, str(error)[:80])
    return (*size, drift, f"{started} of {N_RESETS}")


def main() -> None:
    """Make the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="*")
    options = parser.parse_args()
    files = list(options.files)
    with tempfile.TemporaryDirectory() as folder:
        for name in NETWORKS:
            path = Path(folder) / f"{name}.json"
            pandapower.to_json(getattr(pandapower.networks, name)(), str(path))
            files.append(path)
        rows = [row(path) for path in files]
    header = "file", "buses", "load [MW]", "largest differences [p.u., rad]", "20 s at rest", "resets"
    print(markdown_table(header, rows))


if __name__ == "__main__":
    main()
