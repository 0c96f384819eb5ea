"""`python -m agents.export`: a trained policy as ONNX, as an entry of the leaderboard."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agents.command import make_parser, note, run_command
from agents.folders import BEST, folders
from agents.runs import Run
from agents.training import entry_values
from wtg_gym.files import write_together
from wtg_gym.policies.entry_toml import parse_entry
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE
from wtg_gym.policies.submission_folder import entry_text

_DESCRIPTION = """\
Writes the best policy of a run, normalisation and clipping included, as policy.onnx, and an entry.toml
that makes the folder an entry of the leaderboard. The file is the one that the training wrote."""


def export(
    run_folder: Path, output: Path, *, name: str = "", description: str = "", authors: Sequence[str] = ()
) -> None:
    """Write the best policy of a run into a new folder: policy.onnx and entry.toml.

    Without a name it is one made of algorithm and action mode. A ValueError says that the folder is there already, that
    there is no policy, or that the leaderboard would refuse the name.
    """
    if output.exists():
        raise ValueError(f"{output} is there already; give a new folder")
    run = Run.read(run_folder)
    settings = run.settings
    # A kill may leave a policy whose validation is not in run.json.
    validated = {int(row["timesteps"]) for row in run.curve}
    best = [folder for folder in folders(run_folder / BEST) if int(folder.name) in validated]
    if not best:
        raise ValueError(f"{run_folder} has no validated policy yet: go on with the run first")
    entry = entry_values(settings, name, description)
    if parse_entry((best[-1] / ENTRY_FILE).read_text(encoding="utf-8")).get("per_group"):
        entry["per_group"] = True
    # The same for all training seeds, which share a row.
    trained_on = f"{settings.suite}, split train, up to {settings.timesteps} steps; chosen on split validation"
    files: dict[str, str | bytes] = {
        POLICY_FILE: (best[-1] / POLICY_FILE).read_bytes(),
        # Last, because it makes the folder an entry.
        ENTRY_FILE: entry_text({**entry, "authors": list(authors), "trained_on": trained_on}),
    }
    write_together({output / name: data for name, data in files.items()})


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = make_parser("agents.export", _DESCRIPTION)
    parser.add_argument("run", metavar="RUN_FOLDER", help="folder of the run")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="new folder to write to")
    parser.add_argument("--name", help="of the entry; runs of one name and several seeds share a row of the table")
    parser.add_argument("--description", help="one sentence on what it is")
    parser.add_argument("--authors", nargs="+", metavar="NAME", help="who trained it; a submission needs them")

    def work() -> None:
        given: dict[str, Any] = vars(parser.parse_args(argv))
        output = Path(given.pop("output"))
        export(Path(given.pop("run")), output, **given)
        note(f"wrote {output}")

    return run_command(work, "begin anew")


if __name__ == "__main__":
    sys.exit(main())
