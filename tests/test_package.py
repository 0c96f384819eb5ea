"""Facts about the installed package."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import wtg_gym


def test_importing_the_package_loads_nothing_heavy() -> None:
    program = "import sys, json, wtg_gym; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(json.loads(done.stdout))
    assert not loaded & {
        "torch",
        "onnx",
        "onnxruntime",
        "matplotlib",
        "pandas",
        "stable_baselines3",
        "rich",
        "baselines",
        "agents",
    }


def test_package_is_typed() -> None:
    assert (Path(wtg_gym.__file__).parent / "py.typed").exists()


def test_environment_is_found_by_module_and_id() -> None:
    program = "import gymnasium; gymnasium.make('wtg_gym:GFMWTG-14bus-v0'); print('made')"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "made"
