"""Install packages in the versions and with the hashes of constraints.txt, into the Python that runs this.

usage: python .ci/install.py ARGUMENT [ARGUMENT ...]

The arguments are those of `uv pip install`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PINS = ROOT / "constraints.txt"
PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
#: To build a dependency from source would run what no hash covers.
WHEELS = ["--only-binary", ":all:"]


def main(arguments: list[str]) -> int:
    """Install, and return the exit status."""
    if not arguments:
        sys.exit(__doc__)
    # pip cannot check hashes of dependencies beside a checkout, which has none.
    bring_uv = ["--quiet", "--require-hashes", "--requirement", ROOT / ".ci" / "uv.txt"]
    failed = subprocess.run([*PIP, "install", *WHEELS, *bring_uv]).returncode
    if failed:
        return failed
    # Wheels that lie on a disk for pip, such as a build of torch for processors, are for uv too.
    configured = subprocess.run([*PIP, "config", "get", "global.find-links"], capture_output=True, text=True).stdout
    folders = os.environ.get("PIP_FIND_LINKS") or configured
    environment = {"UV_FIND_LINKS": ",".join(folders.split()), **os.environ}
    if {"-e", "--editable"} & set(arguments):
        # Its build compiles nothing, and needs no packages for that.
        environment.setdefault("WTG_GYM_PROCESSOR", "none")
    pinned = ["--python", sys.executable, "--constraints", PINS, "--build-constraints", PINS]
    if not arguments[-1].endswith(".whl"):
        # The checkout and the sdist are built.
        pinned += ["--no-binary", "wtg-gym"]
    install = [sys.executable, "-m", "uv", "pip", "install", *WHEELS, *pinned]
    return subprocess.run([*install, *arguments], env=environment).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
