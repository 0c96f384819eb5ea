"""`python -m agents.shipped`: trains policies of `agents/policies` again, by the commands in their model cards."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from agents.command import make_parser, note, run_command
from agents.runs import RUN_FILE
from wtg_gym.policies.load import ENTRY_FILE
from wtg_gym.policies.submission_folder import parse_submission

POLICIES = Path(__file__).parent / "policies"
_DESCRIPTION = """\
Trains the named policies of agents/policies and exports them to runs/policies; without a name, lists them all. A run
that is there already goes on from its last checkpoint, or is exported at once. Its output goes to runs/NAME.log.
Eight at a time:

  python -m agents.shipped | xargs -P 8 -n 1 python -m agents.shipped"""


def commands() -> dict[str, list[str]]:
    """Return module and options that trained every policy, by the name of its folder."""
    found = {}
    for folder in sorted(POLICIES.iterdir()):
        card = (folder / "README.md").read_text(encoding="utf-8")
        if command := re.search(r"^python\S* -m (agents\.\w+ .*)$", card, re.MULTILINE):
            words = shlex.split(command[1])
            # Where the cards of v0 were written it was what a run trained on without this option.
            found[folder.name] = words if "--suite" in words else [*words, "--suite", "standard"]
    return found


def make(name: str) -> None:
    """Train a policy and export it under the name and with the texts that it has now.

    Raises:
        ValueError: one of the two commands failed; the message names the log.
    """
    run, log = Path("runs", name), Path("runs", f"{name}.log")
    module, *new = commands()[name]
    entry = parse_submission((POLICIES / name / ENTRY_FILE).read_bytes())
    texts = ["--name", entry.name, "--description", entry.description, "--authors", *entry.authors]
    run.parent.mkdir(exist_ok=True)
    # Several trainings at a time on one thread each are faster than one after another on all of them.
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with log.open("a", encoding="utf-8") as stream:
        for command in (
            [module, *(["--resume", str(run)] if (run / RUN_FILE).is_file() else new)],
            ["agents.export", str(run), "--output", f"runs/policies/{name}", "--overwrite", *texts],
        ):
            done = subprocess.run([sys.executable, "-m", *command], stdout=stream, stderr=stream, env=environment)
            if done.returncode:
                raise ValueError(f"{' '.join(command)} failed; its last words are in {log}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = make_parser("agents.shipped", _DESCRIPTION)
    parser.add_argument("names", nargs="*", default=[], metavar="NAME", help="of the policies")

    def work() -> None:
        chosen, known = parser.parse_args(argv).names, commands()
        if unknown := [name for name in chosen if name not in known]:
            raise ValueError(f"unknown {', '.join(unknown)}; known: {', '.join(known)}")
        for name in chosen:
            make(name)
            note(f"wrote runs/policies/{name}")
        if not chosen:
            print("\n".join(known))

    return run_command(work, "the same command goes on")


if __name__ == "__main__":
    sys.exit(main())
