"""`python -m agents.export`: a trained policy as ONNX, as an entry of the leaderboard."""

import functools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from agents.run import BEST, Run, folders, note, run_command
from wtg_gym.files import read_bytes, write_together
from wtg_gym.policies.entry_folder import ENTRY_FILE, POLICY_FILE, entry_text, load_entry_folder


def export(
    run: Path,
    /,
    output: Path,
    *,
    name: str = "",
    description: str = "",
    authors: Annotated[Sequence[str], Parameter(consume_multiple=1, negative="")] = (),
) -> None:
    """Write the best policy of a run as an entry of the leaderboard.

    The folder has policy.onnx, normalisation and clipping included, as the training wrote it, and an entry.toml.

    Args:
        run: folder of the run
        output: new folder to write to
        name: of the entry; runs of one name and several seeds share a row of the table; default: algorithm and mode
        description: one sentence on what it is
        authors: who trained it; a submission needs them
    """
    if output.exists():
        raise ValueError(f"{output} is there already; give a new folder")
    trained = Run.read(run)
    # A kill may leave a policy whose validation is not in run.json.
    validated = {int(row["timesteps"]) for row in trained.curve}
    best = [folder for folder in folders(run / BEST) if int(folder.name) in validated]
    if not best:
        raise ValueError(f"{run} has no validated policy yet: go on with the run first")
    entry = {**trained.settings.entry(name, description), "authors": list(authors)}
    if load_entry_folder(best[-1]).per_group:
        entry["per_group"] = True
    # The same for all training seeds, which share a row.
    steps = f"up to {trained.settings.timesteps} steps"
    entry["trained_on"] = f"{trained.settings.suite}, split train, {steps}; chosen on split validation"
    policy = read_bytes(best[-1] / POLICY_FILE, "policy")
    # The entry last, because it makes the folder one.
    write_together({output / POLICY_FILE: policy, output / ENTRY_FILE: entry_text(entry)})
    note(f"wrote {output}")


main = functools.partial(run_command, export, "agents.export", "begin anew")

if __name__ == "__main__":
    sys.exit(main())
