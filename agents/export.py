"""`python -m agents.export`: a trained policy as ONNX, with a model card and as an entry of the leaderboard."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agents.command import Parser, note, run_command
from agents.folders import BEST, folders
from agents.runs import Run
from agents.training import SHARED, entry_values
from wtg_gym.files import markdown_table, sha256, write_together
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE
from wtg_gym.policies.submission_folder import entry_text
from wtg_gym.scenarios import get_suite

_CARD_FILE = "README.md"
#: Columns of the training curve in the model card and their digits.
_CURVE = {
    "timesteps": 0,
    "wall_time_s": 0,
    "score": 1,
    "cost": 1,
    "failures_percent": 1,
    "nadir_hz": 3,
    "rocof_hz_s": 3,
    "duty_error_percent": 2,
}
#: Result of a repetition, in the model card.
_EXACTLY = "the same versions on the same kind of machine give the same weights"
_REPEATED = {"rllib_ppo": "runners end in any order, so that a repetition may give other weights"}

_DESCRIPTION = """\
Writes the best policy of a run, normalisation and clipping included, as policy.onnx, a model card README.md, and an
entry.toml that makes the folder an entry of the leaderboard. The file is the one that the training wrote."""
_EXAMPLES = """\
examples:
  python -m agents.export runs/ppo-0 --output agents/policies/ppo-0 --name PPO --authors 'Jane Doe'
  wtg-gym evaluate --entries agents/policies/ppo-0 --suite standard"""


def export(
    run_folder: Path,
    output: Path,
    *,
    name: str | None = None,
    description: str = "",
    authors: Sequence[str] = (),
    overwrite: bool = False,
) -> None:
    """Write the best policy of a run into a folder.

    Args:
        run_folder: of the run.
        output: folder to write policy.onnx, README.md and entry.toml into; made if missing.
        name: of the entry; None for one made of algorithm and action mode.
        description: one sentence on what it is; empty for a general one.
        authors: names.
        overwrite: replace these files where they are there.

    Raises:
        ValueError: the folder has one of the files, there is no policy, the leaderboard would refuse the name, or the
            policy acts for other groups than the suite has.
    """
    there = [file for file in (POLICY_FILE, _CARD_FILE, ENTRY_FILE) if (output / file).exists()]
    if there and not overwrite:
        raise ValueError(f"{output} has {', '.join(there)} already; --overwrite replaces them")
    run = Run.read(run_folder)
    settings = run.settings
    best = folders(run_folder / BEST)
    if not best:
        raise ValueError(f"{run_folder} has no policy yet: its first validation has not been reached")
    timesteps = int(best[-1].name)
    row = next((row for row in run.curve if row["timesteps"] == timesteps), None)
    if row is None:
        raise ValueError(f"{run_folder} was interrupted while it wrote the policy of step {timesteps}: resume it first")
    entry = entry_values(settings, timesteps, name=name, description=description)
    own = len(get_suite(settings.suite).plant.groups)
    if settings.algo not in SHARED and settings.groups not in (None, own):
        raise ValueError(f"the policy acts for {settings.groups} WTG groups, suite {settings.suite!r} has {own}")
    content = (best[-1] / POLICY_FILE).read_bytes()
    trained_on = f"{settings.suite}, split train, {timesteps} steps; chosen on split validation"
    files: dict[str, str | bytes] = {
        POLICY_FILE: content,
        _CARD_FILE: _model_card(run, row, entry["name"], authors, content),
        # Last, because it makes the folder an entry.
        ENTRY_FILE: entry_text({**entry, "authors": list(authors), "trained_on": trained_on}),
    }
    write_together({output / name: data for name, data in files.items()})


def _model_card(run: Run, best: Mapping[str, float], name: str, authors: Sequence[str], content: bytes) -> str:
    """Return the README.md of an exported policy; `best` is its row of the run's curve, `content` its policy.onnx."""
    settings, provenance = run.settings, run.provenance
    benchmark = get_suite(settings.suite).benchmark
    last = run.curve[-1]
    facts = {
        "environment": f"`{benchmark.env_id}`, suite `{settings.suite}`",
        "actions": f"`{settings.action_mode}` of `{settings.strategy}`, deterministic",
        "observations": f"`{settings.observation_mode}`",
        "algorithm": f"`{settings.algo}`",
        "training seed": str(settings.seed),
        "steps": f"{best['timesteps']:,} for this policy, {last['timesteps']:,} of {settings.timesteps:,} in the run",
        "wall time": f"{last['wall_time_s']:,.0f} s, {run.resumed} interruptions",
        "validation score": f"{best['score']:.1f} on {settings.validation_episodes} scenarios "
        f"({benchmark.zero} 0, {benchmark.hundred} 100), chosen as the best of the curve: a little optimistic",
        "authors": ", ".join(authors) or "not given",
        "sha256 of policy.onnx": f"`{sha256(content)}`",
    }
    changes = [change for process in run.resumptions for change in process["differences"]]
    if changes:
        facts["changed by a resumption"] = "; ".join(changes)
    rows = [[f"{row[key]:,.{digits}f}" for key, digits in _CURVE.items()] for row in run.curve]
    hyperparameters = {key: f"`{value}`" for key, value in sorted(settings.hyperparameters.items())}
    return f"""\
# {name}

A policy that modulates the grid-forming control of wind turbines on the IEEE 14-bus system.

{_table(facts)}

## Use

With the checkout's root as the working folder, and this folder in place of `FOLDER`:

```
wtg-gym evaluate --entries FOLDER --suite {settings.suite}
```

## Hyperparameters

{_table(hyperparameters)}

Number of lanes in this run: {settings.n_envs}.

## Training curve

{markdown_table(list(_CURVE), rows, right=range(len(_CURVE)))}

## How to reproduce

In a checkout of commit `{provenance["git_commit"]}`:

```
{provenance["command"]}
```

{_table(dict(sorted(provenance["versions"].items())))}

Source hash `{provenance["source_hash"]}`, suite hash `{provenance["suite_hash"]}`, \
{provenance["machine"]}; {_REPEATED.get(settings.algo, _EXACTLY)}.
"""


def _table(facts: Mapping[str, Any]) -> str:
    return markdown_table(["", ""], [[key, str(value)] for key, value in facts.items()])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.export", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("run", metavar="RUN_FOLDER", help="folder of the run")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="folder to write to")
    parser.add_argument("--name", help="of the entry; runs of one name and several seeds share a row of the table")
    parser.add_argument("--description", default="", help="one sentence on what it is")
    parser.add_argument("--authors", nargs="+", default=[], metavar="NAME", help="who trained it")
    parser.add_argument("--overwrite", action="store_true", help="replace an entry that is in the folder")

    def work() -> None:
        given = vars(parser.parse_args(argv))
        output = Path(given.pop("output"))
        export(Path(given.pop("run")), output, **given)
        note(f"wrote {output}")
        if not given["authors"]:
            note("no --authors: a submission needs them in entry.toml")

    return run_command(work, "begin anew with --overwrite")


if __name__ == "__main__":
    sys.exit(main())
