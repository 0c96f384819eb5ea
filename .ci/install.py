"""Install packages in the versions and with the hashes of the pins, into the Python that runs this.

usage: python .ci/install.py [--pins FILE] ARGUMENT [ARGUMENT ...]

The arguments are those of `uv pip install`; without `--pins` the versions are those of constraints.txt.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: To build from source would run what no hash covers.
WHEELS = ["--only-binary", ":all:"]


def main(arguments: list[str]) -> int:
    """Install, and return the exit status."""
    pins = ROOT / "constraints.txt"
    if arguments[:1] == ["--pins"]:
        pins, arguments = Path(arguments[1]), arguments[2:]
    if not arguments:
        sys.exit(__doc__)
    python = [sys.executable, "-m"]
    # pip cannot check hashes of dependencies beside a checkout, which has none.
    uv = ["--quiet", "--disable-pip-version-check", "--require-hashes", "--requirement", ROOT / ".ci" / "uv.txt"]
    failed = subprocess.run([*python, "pip", "install", *WHEELS, *uv]).returncode
    if failed:
        return failed
    pinned = ["--python", sys.executable, "--constraints", pins, "--build-constraints", ROOT / "constraints.txt"]
    if not arguments[-1].endswith(".whl"):
        # The checkout and the sdist are built.
        pinned += ["--no-binary", "wtg-gym"]
    # Wheels that lie on a disk for pip, such as a build of torch for processors, are for uv too.
    links = {"UV_FIND_LINKS": ",".join(os.environ.get("PIP_FIND_LINKS", "").split())}
    install = [*python, "uv", "pip", "install", *WHEELS, *pinned, *arguments]
    return subprocess.run(install, env=links | os.environ).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
