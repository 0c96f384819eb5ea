"""Part of the wheel's build: compiles the simulator for the wheel, so that the first step and score do not.

WTG_GYM_PROCESSOR names the kind of processor, such as x86-64-v3; without it, the code is for the one that builds. With
"none" nothing is compiled: that wheel is for every Python and system. Code for another processor or numba is not used.
A checkout keeps a copy in wtg_gym/machine_code.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

KIND = os.environ.get("WTG_GYM_PROCESSOR", "")


class MachineCode(BuildHookInterface[Any]):
    """Takes machine code into the wheel, and tags it."""

    def dependencies(self) -> list[str]:
        """Return what the build needs: it runs the package."""
        return [] if KIND == "none" else self.metadata.core.dependencies

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Change how a wheel is built; an editable one is as it was."""
        if version == "editable" or KIND == "none":
            return
        self.app.display_info("compiling the simulator: some thirty seconds")
        self._folder = Path(tempfile.mkdtemp(prefix="wtg_gym-"))
        code = self._folder / "machine_code"
        try:
            compile_simulator(Path(self.root), self._folder / "cache", code)
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            reason = getattr(error, "stderr", None) or error
            self.app.display_warning(f"the wheel has no machine code, so its first use compiles: {reason}")
            return
        build_data |= {"pure_python": False, "infer_tag": not KIND}
        if KIND:
            python, platform = f"cp{sys.version_info[0]}{sys.version_info[1]}", sysconfig.get_platform()
            # It links to nothing of the system.
            platform = platform.replace("linux", "manylinux_2_17").replace("-", "_").replace(".", "_")
            build_data["tag"] = f"{python}-{python}-{platform}"
        build_data["force_include"][str(code)] = "wtg_gym/machine_code"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what the wheel was made from."""
        if hasattr(self, "_folder"):
            shutil.rmtree(self._folder, ignore_errors=True)


def compile_simulator(root: Path, cache: Path, code: Path) -> None:
    """Compile into a folder, by way of a cache; a checkout that can be written to gets a copy."""
    # Numba's settings change what it compiles.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    environment |= dict.fromkeys(("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME"), str(cache))
    environment["PYTHONPATH"] = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    if KIND:
        environment |= {"NUMBA_CPU_NAME": KIND, "NUMBA_CPU_FEATURES": ""}
    # What a checkout keeps would not be compiled.
    shutil.rmtree(root / "wtg_gym" / "machine_code", ignore_errors=True)
    cache.mkdir(mode=0o700)
    command = [sys.executable, "-m", "wtg_gym.cli", "warmup"]
    pipes = {"capture_output": True, "encoding": "utf-8", "errors": "replace"}
    subprocess.run(command, env=environment, check=True, timeout=1200, **pipes)
    shutil.copytree(cache / "wtg_gym" / "programs", code / "programs")
    for path in (cache / "wtg_gym").glob("*/*.nbc"):
        shutil.copy(path, code)
    with contextlib.suppress(OSError):
        shutil.copytree(code, root / "wtg_gym" / "machine_code", dirs_exist_ok=True)
