"""`python -m agents.export`: a trained policy as ONNX, with a model card and as an entry of the leaderboard."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from agents import rllib_ppo, single_file_ppo
from agents.command import run_command
from agents.entry_file import entry_file, entry_of
from agents.model_card import model_card
from agents.networks import PolicyNetwork
from agents.onnx_graph import to_onnx
from agents.runs import BEST, Run, RunSettings, folders
from wtg_gym.cli.output import note
from wtg_gym.cli.parser import Parser
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.evaluation import OnnxPolicy, Policy
from wtg_gym.files import write_atomically
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE

#: Largest difference between the export's actions and the learner's [full action].
TOLERANCE = 1e-6
_CHECKED_LANES, _CHECKED_STEPS = 16, 250

_DESCRIPTION = """\
Writes the best policy of a run as policy.onnx, normalisation and clipping included, a model card README.md, and an
entry.toml that makes the folder an entry of the leaderboard. The file's actions are compared with the learner's on 4000
observations of random episodes, and must agree to 1e-6."""
_EXAMPLES = """\
examples:
  python -m agents.export runs/ppo-0 --output agents/policies/ppo-0 --name PPO --authors 'Jane Doe'
  wtg-gym evaluate --entries agents/policies/ppo-0 --suite standard"""


def export(
    run_folder: Path, output: Path, *, name: str | None = None, description: str = "", authors: Sequence[str] = ()
) -> float:
    """Write the best policy of a run into a folder.

    Args:
        run_folder: of the run.
        output: folder to write policy.onnx, README.md and entry.toml into; made if missing.
        name: of the entry; None for one made of algorithm and action mode.
        description: one sentence on what it is; empty for a general one.
        authors: names.

    Returns:
        the largest difference between the file's actions and the learner's.

    Raises:
        ValueError: there is no policy, the leaderboard would refuse the name, it cannot be written as ONNX, or the
            file's actions differ.
    """
    run = Run.read(run_folder)
    settings = run.settings
    best = folders(run_folder / BEST)
    if not best:
        raise ValueError(f"{run_folder} has no policy yet: its first validation has not been reached")
    timesteps = int(best[-1].name)
    row = next((row for row in run.curve if row["timesteps"] == timesteps), None)
    if row is None:
        raise ValueError(f"{run_folder} was interrupted while it wrote the policy of step {timesteps}: resume it first")
    # What the leaderboard refuses is refused before the work.
    entry = entry_of(settings, timesteps, name=name, description=description)
    policy, network = _trained(best[-1], settings.algo)
    content = to_onnx(network)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / POLICY_FILE
        path.write_bytes(content)
        difference = largest_difference(policy, OnnxPolicy(path), settings)
    if not difference <= TOLERANCE:
        raise ValueError(f"the actions of the ONNX file differ by {difference:.2g}, allowed are {TOLERANCE:g}")
    write_atomically(output / POLICY_FILE, content)
    write_atomically(output / "README.md", model_card(run, row, entry.name, authors, content))
    trained_on = f"{settings.suite}, split train, {timesteps} steps; chosen on split validation"
    # Last, because it is what makes the folder an entry.
    write_atomically(output / ENTRY_FILE, entry_file(entry, authors=list(authors), trained_on=trained_on))
    return difference


def _trained(best: Path, algo: str) -> tuple[Policy, PolicyNetwork]:
    """Return the policy in a folder and the network in it."""
    if algo in (rllib_ppo.NAME, single_file_ppo.NAME):
        agent = single_file_ppo.load(best)
        return agent, agent.network()
    # Here, because the policies above are exported where Stable-Baselines3 is not installed.
    from agents.hyperparameters import ALGORITHMS
    from agents.learners import network_of
    from wtg_gym.policies.sb3_archive import load_archive

    policy, _ = load_archive(best, ALGORITHMS[algo].__name__)
    return policy, network_of(policy.policy, policy.vec_normalize)


def largest_difference(policy: Policy, other: Policy, settings: RunSettings) -> float:
    """Return the largest difference between two policies' actions, [-1, 1], over 4000 observations.

    The first one acts, with some noise so that the episodes differ; episodes start anew within.
    """
    env = GFMWTGVectorEnv(_CHECKED_LANES, autoreset_mode="SameStep", duration_s=20.0, **settings.env_arguments)
    rng = np.random.default_rng(0)
    largest, states, start = 0.0, (None, None), np.ones(_CHECKED_LANES, dtype=np.bool_)
    try:
        observations, _ = env.reset(seed=0)
        for _ in range(_CHECKED_STEPS):
            (one, first), (two, second) = (
                each.predict(observations, state, start, deterministic=True)
                for each, state in zip((policy, other), states, strict=True)
            )
            states = first, second
            largest = max(largest, float(np.abs(one - two).max()))
            noise = rng.normal(0.0, 0.3, one.shape)
            observations, _, terminated, truncated, _ = env.step((one + noise).astype(np.float32))
            start = terminated | truncated
    finally:
        env.close()
    return largest


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.export", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("run", metavar="RUN_FOLDER", help="folder of the run")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="folder to write to")
    parser.add_argument("--name", help="of the entry; runs of one name and several seeds share a row of the table")
    parser.add_argument("--description", default="", help="one sentence on what it is")
    parser.add_argument("--authors", nargs="+", default=[], metavar="NAME", help="who trained it")
    return run_command(lambda: _export(parser.parse_args(argv)))


def _export(given: argparse.Namespace) -> None:
    difference = export(
        Path(given.run), Path(given.output), name=given.name, description=given.description, authors=given.authors
    )
    note(f"wrote {given.output}; its actions agree to {difference:.1g}")


if __name__ == "__main__":
    sys.exit(main())
