"""Part of the wheel's build: with machine code, see `.ci/machine_code`, it is one of this Python and platform."""

from __future__ import annotations

import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class MachineCode(BuildHookInterface[Any]):
    """Takes machine code into the wheel, and tags it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Change how a wheel is built; an editable one is as it was."""
        if version == "editable" or not (Path(self.root) / "wtg_gym" / "machine_code").is_dir():
            return
        python, platform = f"cp{sys.version_info[0]}{sys.version_info[1]}", sysconfig.get_platform()
        # It links to nothing of the system.
        platform = platform.replace("linux", "manylinux_2_17").replace("-", "_").replace(".", "_")
        build_data |= {"pure_python": False, "tag": f"{python}-{python}-{platform}"}
        build_data["artifacts"].append("/wtg_gym/machine_code/")
