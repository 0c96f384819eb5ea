"""`python -m agents.export`: a trained policy as ONNX, with a model card and as an entry of the leaderboard."""

from __future__ import annotations

import contextlib
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents import gradient, ppo, rllib
from agents.command import Parser, note, run_command
from agents.entry_file import entry_values
from agents.folders import BEST, folders
from agents.onnx_graph import PolicyNetwork, to_onnx
from agents.runs import Run, RunSettings
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.evaluation import OnnxPolicy, Policy
from wtg_gym.files import markdown_table, sha256, write_together
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE
from wtg_gym.policies.submission_folder import entry_text
from wtg_gym.scenarios import get_suite

#: Largest difference between the export's actions and the learner's [full action].
TOLERANCE = 1e-6
_CARD_FILE = "README.md"
_CHECKED_LANES, _CHECKED_STEPS = 16, 250
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
_REPEATED = {rllib.NAME: "runners end in any order, so that a repetition may give other weights"}

_DESCRIPTION = """\
Writes the best policy of a run as policy.onnx, normalisation and clipping included, a model card README.md, and an
entry.toml that makes the folder an entry of the leaderboard. The file's actions are compared with the learner's on 4000
observations of random episodes, and must agree to 1e-6."""
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
) -> float:
    """Write the best policy of a run into a folder.

    Args:
        run_folder: of the run.
        output: folder to write policy.onnx, README.md and entry.toml into; made if missing.
        name: of the entry; None for one made of algorithm and action mode.
        description: one sentence on what it is; empty for a general one.
        authors: names.
        overwrite: replace these files where they are there.

    Returns:
        the largest difference between the file's actions and the learner's.

    Raises:
        ValueError: the folder has one of the files, there is no policy, the leaderboard would refuse the name, it
            cannot be written as ONNX, or the file's actions differ.
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
    # A name that the leaderboard refuses is refused before the work.
    entry = entry_values(settings, timesteps, name=name, description=description)
    policy, network, settings = _trained(best[-1], settings)
    content = to_onnx(network)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / POLICY_FILE
        path.write_bytes(content)
        difference = largest_difference(policy, OnnxPolicy(path), settings)
    if not difference <= TOLERANCE:
        raise ValueError(f"the actions of the ONNX file differ by {difference:.2g}, allowed are {TOLERANCE:g}")
    trained_on = f"{settings.suite}, split train, {timesteps} steps; chosen on split validation"
    files: dict[str, str | bytes] = {
        POLICY_FILE: content,
        _CARD_FILE: _model_card(run, row, entry["name"], authors, content),
        # Last, because it makes the folder an entry.
        ENTRY_FILE: entry_text({**entry, "authors": list(authors), "trained_on": trained_on}),
    }
    write_together({output / name: data for name, data in files.items()})
    return difference


def _trained(best: Path, settings: RunSettings) -> tuple[Policy, PolicyNetwork, RunSettings]:
    """Return the policy in a folder of a run, the network in it, and the run's settings with its suite's groups."""
    algo = settings.algo
    if algo in (rllib.NAME, ppo.NAME):
        agent = ppo.load(best)
        return agent, agent.network(), settings
    if algo == gradient.NAME:
        found = gradient.load(best)
        return found, found.network(), settings
    # Imported here, because the policies above are exported where Stable-Baselines3 is not installed.
    from agents import multi_agent
    from agents.hyperparameters import ALGORITHMS
    from wtg_gym.policies.sb3_archive import load_archive

    folder = best / multi_agent.ARCHIVE_FOLDER if algo in multi_agent.ALGORITHMS else best
    policy, _ = load_archive(folder, ALGORITHMS[multi_agent.base_algorithm(algo)].__name__)
    settings = multi_agent.entry_settings(settings)
    return multi_agent.joint_policy(settings, policy), multi_agent.joint_network(settings, policy), settings


def largest_difference(policy: Policy, other: Policy, settings: RunSettings) -> float:
    """Return the largest difference between two policies' actions, [-1, 1], over 4000 observations.

    The first one acts, with some noise so that the episodes differ; episodes start anew within.
    """
    envs = GFMWTGVectorEnv(_CHECKED_LANES, autoreset_mode="SameStep", duration_s=20.0, **settings.env_arguments)
    rng = np.random.default_rng(0)
    largest, states, start = 0.0, (None, None), np.ones(_CHECKED_LANES, dtype=np.bool_)
    with contextlib.closing(envs):
        observations, _ = envs.reset(seed=0)
        for _ in range(_CHECKED_STEPS):
            (one, first), (two, second) = (
                each.predict(observations, state, start, deterministic=True)
                for each, state in zip((policy, other), states, strict=True)
            )
            states = first, second
            largest = max(largest, float(np.abs(one - two).max()))
            noise = rng.normal(0.0, 0.3, one.shape)
            observations, _, terminated, truncated, _ = envs.step((one + noise).astype(np.float32))
            start = terminated | truncated
    return largest


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
        difference = export(Path(given.pop("run")), output, **given)
        note(f"wrote {output}; its actions agree to {difference:.1g}")
        if not given["authors"]:
            note("no --authors: a submission needs them in entry.toml")

    return run_command(work)


if __name__ == "__main__":
    sys.exit(main())
