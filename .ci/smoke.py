"""What an installed package must do outside a checkout: make, step, score, and run its command."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np

import wtg_gym
from wtg_gym.systems.elementary import fma


def main() -> None:
    """Fail with the first thing that does not work."""
    installed = Path(wtg_gym.__file__)
    assert "site-packages" in installed.parts, f"this is not an installed package: {installed}"
    # It is the C library's, and rounds once.
    assert fma(1.0 + 2.0**-30, 1.0 + 2.0**-30, -1.0 - 2.0**-29) == 2.0**-60
    for version, suite in (("v0", "standard"), ("v1", "standard-v1")):
        env = gym.make(f"wtg_gym:GFMWTG-14bus-{version}")
        env.reset(seed=0)
        for _ in range(20):
            env.step(np.zeros(env.action_space.shape, np.float32))
        env.close()
        results = wtg_gym.evaluate([], suite, seeds=(10_000, 10_001))
        assert len(results.episodes) == 2 * len(results.scores) > 0, results
    shown = subprocess.run(["wtg-gym", "--version"], capture_output=True, text=True, check=True).stdout
    assert importlib.metadata.version("wtg-gym") in shown, shown
    subprocess.run(["wtg-gym", "suites", "standard-v1", "--seed", "20000"], check=True, stdout=subprocess.DEVNULL)
    print(f"wtg-gym {importlib.metadata.version('wtg-gym')} works on Python {sys.version.split()[0]}, {sys.platform}")


if __name__ == "__main__":
    main()
