"""`python -m agents.export`: a trained policy as ONNX, with a model card and as an entry of the leaderboard."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.command import make_parser, note, run_command
from agents.folders import BEST, folders
from agents.runs import RUN_FILE, Run
from agents.training import entry_values
from wtg_gym.files import interpreting, markdown_table, read_bytes, sha256, write_together
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE, load_entry_folder
from wtg_gym.policies.submission_folder import entry_text
from wtg_gym.scenarios import get_suite

_DESCRIPTION = """\
Writes the best policy of a run, normalisation and clipping included, as policy.onnx, a model card README.md, and an
entry.toml that makes the folder an entry of the leaderboard. The file is the one that the training wrote."""


def export(
    run_folder: Path, output: Path, *, name: str = "", description: str = "", authors: Sequence[str] = ()
) -> None:
    """Write the best policy of a run into a new folder: policy.onnx, README.md and entry.toml.

    Without a name it is one made of algorithm and action mode. A ValueError says that the folder is there already, that
    there is no policy, or that the leaderboard would refuse the name.
    """
    if output.exists():
        raise ValueError(f"{output} is there already; give a new folder")
    run = Run.read(run_folder)
    settings = run.settings
    # A kill may leave a policy whose validation is not in run.json.
    rows = {int(row["timesteps"]): row for row in run.curve}
    best = [folder for folder in folders(run_folder / BEST) if int(folder.name) in rows]
    if not best:
        raise ValueError(f"{run_folder} has no validated policy yet: go on with the run first")
    timesteps = int(best[-1].name)
    entry = entry_values(settings, timesteps, name, description)
    if load_entry_folder(best[-1]).per_group:
        entry["per_group"] = True
    content = read_bytes(best[-1] / POLICY_FILE, "policy")
    trained_on = f"{settings.suite}, split train, {timesteps} steps; chosen on split validation"
    with interpreting(run_folder / RUN_FILE, "description of the run"):
        card = _model_card(run, rows[timesteps], entry["name"], authors, content)
    files: dict[str, str | bytes] = {
        POLICY_FILE: content,
        "README.md": card,
        # Last, because it makes the folder an entry.
        ENTRY_FILE: entry_text({**entry, "authors": list(authors), "trained_on": trained_on}),
    }
    write_together({output / name: data for name, data in files.items()})


def _model_card(run: Run, best: Mapping[str, float], name: str, authors: Sequence[str], content: bytes) -> str:
    """Return the README.md of an exported policy; `best` is its row of the run's curve, `content` its policy.onnx."""
    settings, provenance = run.settings, run.provenance
    suite = get_suite(settings.suite)
    benchmark = suite.benchmark
    changes = [change for process in run.resumptions for change in process["differences"]]
    facts = {
        "actions": f"`{settings.action_mode}` of `{settings.strategy}`, deterministic",
        "observations": f"`{settings.observation_mode}` of `{suite.env_id}`, suite `{settings.suite}`",
        "steps": f"{best['timesteps']:,} of {settings.timesteps:,}",
        "changed by a resumption": "; ".join(changes) or "nothing",
        "validation score": f"{best['score']:.1f} on {settings.validation_episodes} scenarios "
        f"({benchmark.zero} 0, {benchmark.hundred} 100), chosen as the best of the curve: a little optimistic",
        "authors": ", ".join(authors) or "not given",
        "sha256 of policy.onnx": f"`{sha256(content)}`",
        **{key: f"`{value}`" for key, value in sorted(settings.hyperparameters.items())},
        "source hash": f"`{provenance['source_hash']}`",
        **provenance["versions"],
    }
    return f"""\
# {name}

A policy that modulates the grid-forming control of wind turbines on the IEEE 14-bus system.

{markdown_table(["", ""], [[key, str(value)] for key, value in facts.items()])}

In a checkout of commit `{provenance["git_commit"]}`, with these versions on a machine like {provenance["machine"]}:

```
{provenance["command"]}
```
"""


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
