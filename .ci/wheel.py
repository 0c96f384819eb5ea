"""Part of the wheel's build: compiles the simulator for the wheel, so that nothing is compiled at its first use.

WTG_GYM_PROCESSOR names the kind of processor, such as x86-64-v3; without it, the code is for the one that builds. With
"none" nothing is compiled: that wheel is for every Python and system. Code for another processor or numba is not used.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class MachineCode(BuildHookInterface[Any]):
    """Takes machine code into the wheel, and tags it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Change how a wheel is built; an editable one is as it was."""
        kind = os.environ.get("WTG_GYM_PROCESSOR", "")
        if version == "editable" or kind == "none":
            return
        self.app.display_info("compiling the simulator: some thirty seconds")
        try:
            compile_simulator(Path(self.root), kind)
        except (OSError, subprocess.CalledProcessError) as error:
            reason = getattr(error, "stderr", error)
            self.app.display_warning(f"the wheel has no machine code, so its first use compiles: {reason}")
            return
        python, platform = f"cp{sys.version_info[0]}{sys.version_info[1]}", sysconfig.get_platform()
        # It links to nothing of the system.
        platform = platform.replace("linux", "manylinux_2_17").replace("-", "_").replace(".", "_")
        build_data |= {"pure_python": False, "tag": f"{python}-{python}-{platform}"}
        build_data["artifacts"].append("/wtg_gym/machine_code/")


def compile_simulator(root: Path, kind: str) -> None:
    """Compile into wtg_gym/machine_code for a kind of processor; an empty one is that of this machine."""
    code = root / "wtg_gym" / "machine_code"
    shutil.rmtree(code, ignore_errors=True)
    with tempfile.TemporaryDirectory() as cache:
        changes = {"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": cache, "LOCALAPPDATA": cache}
        if kind:
            changes |= {"NUMBA_CPU_NAME": kind, "NUMBA_CPU_FEATURES": ""}
        changes["PYTHONPATH"] = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
        command = [sys.executable, "-m", "wtg_gym.cli", "warmup"]
        subprocess.run(command, env={**os.environ, **changes}, check=True, capture_output=True, text=True)
        folder = Path(cache) / "wtg_gym"
        code.mkdir()
        shutil.copytree(folder / "programs", code / "programs")
        for path in folder.glob("*/*.nbc"):
            shutil.copy(path, code)
