"""Install packages in the versions and with the hashes of the pins, into the Python that runs this.

usage: python .ci/install.py [--pins FILE] ARGUMENT [ARGUMENT ...]

The arguments are those of `pip install`; without `--pins` the versions are those of constraints.txt.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
INSTALL = [sys.executable, "-m", "pip", "install", "--disable-pip-version-check", "--only-binary", ":all:"]


def main(arguments: list[str]) -> int:
    """Install, and return pip's exit status."""
    pins = ROOT / "constraints.txt"
    if arguments[:1] == ["--pins"]:
        pins, arguments = Path(arguments[1]), arguments[2:]
    # pip before 26.3 either refuses folders beside hashes or does not check the hashes.
    newest = subprocess.run([*INSTALL, "--quiet", "--require-hashes", "--requirement", ROOT / ".ci" / "pip.txt"])
    if newest.returncode:
        return newest.returncode
    # The checkout itself has no hash, hence "no"; those of the pins are still checked, of its build's pins too.
    pinned = ["--no-require-hashes", "--constraint", pins, "--build-constraint", ROOT / "constraints.txt"]
    return subprocess.run([*INSTALL, *pinned, *arguments]).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
