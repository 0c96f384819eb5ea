"""`python docs/studies/linear.py`: tunes one linear feedback as an entry of the leaderboard."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import torch
from evolution import POPULATION, Search, add_search_options, search_of, tune_linear
from rollouts import (
    HISTORY_COLUMNS,
    difference_percent,
    history_feedback,
    history_gains,
    linear_feedback,
)
from torch import nn

from agents.command import Parser, Progress, check_output_file, check_output_folder, note, print_table, run_command
from agents.entry_file import played_in, write_entry
from agents.onnx_graph import LowPass, PolicyNetwork, to_onnx
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.evaluation import NoScaleError, OnnxPolicy, evaluate
from wtg_gym.evaluation.score import pinned
from wtg_gym.files import to_json, write_atomically
from wtg_gym.physics.layout import Floats
from wtg_gym.policies import Entry
from wtg_gym.policies.load import POLICY_FILE
from wtg_gym.scenarios import get_suite

_DESCRIPTION = """\
Tunes a = clip(G o + b) of a group's own observation o, the same G and b in every group, by CMA-ES on training
scenarios: what a simple learner must beat. Writes entry.toml and policy.onnx, which make the folder an entry of the
leaderboard, and with --gains the gains, how they were found, and the policy's costs on all validation scenarios."""
_EXAMPLES = """\
examples:
  python docs/studies/linear.py --output agents/policies/linear-feedback \\
      --gains docs/studies/linear_feedback_gains.json
  python docs/studies/linear.py --suite standard-v1 --history --scenarios 96 --name history-feedback-v1 \\
      --output agents/policies/history-feedback-v1
  wtg-gym evaluate --entries agents/policies/linear-feedback --suite standard"""


def linear_policy(gains: Floats, n_wtg: int, *, history_dt: float | None = None) -> bytes:
    """Return the ONNX file of a = clip(G o + b), the same for each of n_wtg groups, of their local observation.

    Args:
        gains: G and, as the last column, b: (n_action, n_local + 1); with history the gains of the slow copies stand
            before b.
        n_wtg: number of groups.
        history_dt: control interval of a feedback with history [s]; None without.
    """
    n_action = gains.shape[0]
    n_history = 0 if history_dt is None else len(HISTORY_COLUMNS)
    n_local = gains.shape[1] - 1 - n_history
    # A group's observation ends with its last actions, which the feedback does not use.
    own = np.hstack([gains[:, :n_local], np.zeros((n_action, n_action))])
    weight = np.hstack([np.kron(np.eye(n_wtg), own), np.kron(np.eye(n_wtg), gains[:, n_local:-1])])
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    with torch.no_grad():
        layer.weight.copy_(torch.as_tensor(weight))
        layer.bias.copy_(torch.as_tensor(np.tile(gains[:, -1], n_wtg)))
    low_pass = None
    if history_dt is not None:
        first = (n_local + n_action) * np.arange(n_wtg)[:, None]
        columns = (first + np.array(HISTORY_COLUMNS)).ravel()
        low_pass = LowPass(columns=columns, gain=np.tile(history_gains(history_dt), n_wtg))
    n_observation = n_wtg * (n_local + n_action)
    return to_onnx(PolicyNetwork(n_observation, None, None, [layer], low_pass))


def make_linear_feedback(
    search: Search,
    output: Path,
    gains_file: Path | None = None,
    *,
    name: str = "linear-feedback",
    authors: Sequence[str] = (),
    history: bool = False,
    n_threads: int | None = None,
) -> dict[str, Any]:
    """Tune a feedback, write its folder, and return gains, search and costs, which `gains_file` gets too, if any.

    Raises:
        ValueError: the leaderboard would refuse the name.
    """
    # A name that is refused is refused before the work.
    Entry(name=name)
    seeds = search.scenario_seeds
    gains, training, n_wtg = _tuned(search, history, n_threads)
    history_dt = EnvSettings(suite=search.suite).control_dt if history else None
    write_atomically(output / POLICY_FILE, linear_policy(gains, n_wtg, history_dt=history_dt))
    data = {
        "suite": search.suite,
        "suite_hash": get_suite(search.suite).hash,
        "action_mode": search.action_mode,
        "strategy": search.strategy,
        "seed": search.seed,
        "generations": search.generations,
        "population": POPULATION,
        "gains": gains.tolist(),
        "training": {"scenarios": len(seeds), **training},
        # Judged is the file that will be played.
        "validation": _validate(output / POLICY_FILE, search, n_threads),
    }
    if gains_file is not None:
        write_atomically(gains_file, to_json(data))
    # Last, because it makes the folder an entry.
    write_entry(
        output,
        {
            "name": name,
            "description": f"Linear feedback of a group's own observation{' and its past' if history else ''}, "
            f"the same in every group, tuned by CMA-ES on {len(seeds)} training scenarios of {search.suite}.",
            "action_mode": search.action_mode,
            **played_in(search.suite, search.strategy),
            "training_seed": search.seed,
            "authors": list(authors),
        },
    )
    return data


def _tuned(search: Search, history: bool, n_threads: int | None) -> tuple[Floats, dict[str, float], int]:
    """Gains, mean pinned training costs of the feedback and of the reference, and the number of groups."""
    with (
        Progress("generations") as progress,
        closing(search.rollouts(search.scenario_seeds, n_threads)) as rollouts,
        closing(rollouts.with_candidates(1)) as alone,
    ):

        def tell(done: int, cost: float) -> None:
            progress.update(f"linear feedback, mean cost {cost:.2f}", done, search.generations)

        gains = tune_linear(rollouts, search.generations, tell, search.seed, history=history)
        dt = rollouts.lanes.settings.control_dt
        act = history_feedback(gains, dt) if history else linear_feedback(gains)
        terms = {"policy": alone.play(act)[:, 0], "reference": alone.reference()}
        return gains, {who: float(alone.pinned(each).mean()) for who, each in terms.items()}, rollouts.n_wtg


def _validate(path: Path, search: Search, n_threads: int | None) -> dict[str, Any]:
    """Costs of the policy and of the reference on all validation scenarios, and its score, if there is one."""
    policy = OnnxPolicy(path)
    entry = Entry(name="linear feedback", policy=policy, action_mode=search.action_mode, strategy=search.strategy)
    with Progress("episodes") as progress:
        results = evaluate([entry], search.suite, "validation", n_threads=n_threads, on_progress=progress.update)
    try:
        score = next(s.score.value for s in results.summaries if s.name == entry.name)
    except NoScaleError:
        score = None
    cap = float(results.settings["weights"]["cap"])
    found: dict[str, Any] = {"scenarios": len(results.seeds), "score": score}
    for who, key, name in (
        ("policy", "terms", entry.name),
        ("reference", "reference_terms", results.benchmark.hundred),
    ):
        episodes = results.episodes_of(name)
        found[who] = float(np.mean([pinned(episode, cap) for episode in episodes]))
        found[key] = {
            term: float(np.mean([episode.metrics[f"cost_{term}"] for episode in episodes])) for term in COST_TERMS
        }
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python docs/studies/linear.py", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("--output", required=True, metavar="FOLDER", help="folder of the entry; made if missing")
    parser.add_argument("--gains", metavar="FILE", help="JSON file to write the gains to (default: none)")
    parser.add_argument("--name", default="linear-feedback", help="of the entry (default: linear-feedback)")
    parser.add_argument("--history", action="store_true", help="feed back slow copies of the observation too")
    parser.add_argument("--authors", nargs="+", default=[], metavar="NAME", help="who tuned it")
    parser.add_argument("--scenarios", type=int, default=64, metavar="N", help="training scenarios (default: 64)")
    add_search_options(parser)

    def work() -> None:
        given = parser.parse_args(argv)
        output = check_output_folder("--output", given.output)
        search = search_of(given, "train")
        gains_file = None if given.gains is None else check_output_file("--gains", given.gains, (".json",))
        data = make_linear_feedback(
            search,
            output,
            gains_file,
            name=given.name,
            authors=given.authors,
            history=given.history,
            n_threads=given.threads,
        )
        note(f"wrote {output}" if gains_file is None else f"wrote {output} and {gains_file}")
        rows = [(split, data[split]) for split in ("training", "validation")]
        print_table(
            ("split", "scenarios", "reference's mean cost", "linear feedback's", "difference [%]"),
            [
                (
                    split,
                    str(row["scenarios"]),
                    f"{row['reference']:.2f}",
                    f"{row['policy']:.2f}",
                    difference_percent(row["policy"], row["reference"]),
                )
                for split, row in rows
            ],
        )

    return run_command(work)


if __name__ == "__main__":
    sys.exit(main())
