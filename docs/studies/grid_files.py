"""`python docs/studies/grid_files.py FILE|FOLDER …`: how files become grids, at rest and at 30 resets, or why not."""

import contextlib
import re
import sys
from pathlib import Path

import numpy as np

from wtg_gym import GFMWTGEnv, Plant, Scenario, simulate
from wtg_gym.grids.reading import read_case, with_wind
from wtg_gym.physics.grid import Grid
from wtg_gym.physics.simulator import longest_step

ENDINGS = (".m", ".mat", ".raw", ".rawx", ".zip", ".uct", ".txt", ".cdf", ".dgs", ".json", ".xiidm", ".jiidm")
SEEDS, REST_S, WIND_M_S = 30, 20.0, 10.0


def rest_hz(grid: Grid) -> float:
    """Return how far a frequency moves in 20 s without any event, under the law of `grid check` [Hz]."""
    shares = sum(machine.governor is not None for machine in grid.with_groups.machines) > 1
    plant = Plant().replaced(physics="extended", case=grid.with_groups, groups=grid.groups, shares_dispatch=shares)
    plant = plant.replaced(simulation_dt=longest_step(plant))
    wind = np.full((len(grid.groups), 1), WIND_M_S)
    scenario = Scenario(name="rest", wind_speed=wind, duration_s=REST_S, load_noise_bus=grid.case.slack_bus)
    run = simulate(scenario, "coordinated-tuned", plant)
    moved = np.abs(run.local_frequency_hz - run.nominal_frequency_hz).max()
    return float(moved) if run.time_s[-1] >= REST_S - 1.0 else np.inf


def resets(grid: Grid) -> str:
    """Return how many of 30 resets start, and how many scenarios were drawn again for them."""
    env, redrawn = GFMWTGEnv(grid=grid, reward="cost"), []
    for seed in range(SEEDS):
        with contextlib.suppress(RuntimeError, ValueError):
            redrawn.append(env.reset(seed=seed)[1]["redrawn"])
    return f"{len(redrawn)} / {sum(redrawn)}"


def row(path: Path) -> list[str]:
    """Return the cells of a file, or of the sentence that refuses it."""
    cells = [path.name]
    try:
        grid = read_case(path)
        said = dict(re.findall(r"(voltage|angle|total load) (\S+e[-+]\d+)", grid.substitutions[-1]))
        load = f"{grid.case.load_mw:.1f} ({said['total load']})"
        cells += [str(len(grid.case.buses)), said["voltage"], said["angle"], load]
        grid = with_wind(grid)
        cells += [f"{rest_hz(grid):.1e}", resets(grid)]
    except ValueError as error:
        cells += [re.sub(r"^the case \S+ ", "", str(error)).replace("|", "/")]
    return cells


if __name__ == "__main__":
    given = [Path(name) for name in sys.argv[1:]]
    files = [file for path in given for file in ([path] if path.is_file() else sorted(path.rglob("*")))]
    print("| file | buses | voltage [p.u.] | angle [rad] | load [MW] | 20 s at rest [Hz] | started / redrawn |")
    print("| --- " * 7 + "|")
    for file in files:
        if file.suffix.lower() in ENDINGS and file.is_file():
            print(f"| {' | '.join(row(file))} |", flush=True)
