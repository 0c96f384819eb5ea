"""A tuned linear feedback as an entry of the leaderboard."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from agents.evolution import POPULATION, tune_linear
from agents.networks import PolicyNetwork
from agents.onnx_graph import to_onnx
from agents.rollouts import Rollouts, linear_feedback
from wtg_gym.cli.output import Progress
from wtg_gym.envs.task import COST_TERMS
from wtg_gym.evaluation import ANCHORS, NoScaleError, OnnxPolicy, evaluate
from wtg_gym.evaluation.score import pinned
from wtg_gym.files import to_json, write_atomically
from wtg_gym.policies import Entry
from wtg_gym.policies.load import ENTRY_FILE, POLICY_FILE
from wtg_gym.scenarios import get_suite

Floats = npt.NDArray[np.float64]


def linear_policy(gains: Floats, n_wtg: int) -> bytes:
    """Return the ONNX file of a = clip(G o + b), the same for each of n_wtg groups, of their local observation.

    Args:
        gains: G and, as the last column, b: (n_action, N_LOCAL + 1).
        n_wtg: number of groups.
    """
    n_action = gains.shape[0]
    # A group's observation ends with its last actions, which the feedback does not use.
    own = np.hstack([gains[:, :-1], np.zeros((n_action, n_action))])
    weight = np.kron(np.eye(n_wtg), own)
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    with torch.no_grad():
        layer.weight.copy_(torch.as_tensor(weight))
        layer.bias.copy_(torch.as_tensor(np.tile(gains[:, -1], n_wtg)))
    return to_onnx(PolicyNetwork(n_observation=weight.shape[1], normalization=None, lstm=None, layers=[layer]))


def make_linear_feedback(
    output: Path,
    *,
    gains_file: Path | None,
    suite: str,
    action_mode: str,
    n_scenarios: int,
    generations: int,
    seed: int,
    name: str,
    authors: Sequence[str],
    n_threads: int | None = None,
) -> dict[str, Any]:
    """Tune a feedback on the first training scenarios, write its folder, and return gains, search and costs.

    Args:
        output: folder to write entry.toml and policy.onnx into; made if missing.
        gains_file: JSON file to write what is returned into; None for none.
        suite: of the scenarios.
        action_mode: what it modulates.
        n_scenarios: training scenarios.
        generations: of the search.
        seed: of the search.
        name: of the entry.
        authors: names.
        n_threads: threads to step with; None for one per processor.

    Raises:
        ValueError: a value is unknown or out of range.
    """
    training = get_suite(suite).train
    limits = {"scenarios": (n_scenarios, min(len(training), 10_000)), "generations": (generations, 100_000)}
    for option, (value, high) in limits.items():
        if not 1 <= value <= high:
            raise ValueError(f"--{option} = {value} is outside the allowed range 1 … {high}")
    if not 0 <= seed < 2**32:
        raise ValueError(f"--seed = {seed} is outside the allowed range 0 … {2**32 - 1}")
    # Whatever is wrong with the name is said before the work.
    Entry(name=name, action_mode=action_mode)
    training = training[:n_scenarios]
    rollouts = Rollouts(suite, "train", training, POPULATION, n_threads, action_mode=action_mode)
    try:
        with Progress("generations") as progress:
            gains = tune_linear(
                rollouts,
                generations,
                lambda done, cost: progress.update(f"linear feedback, mean cost {cost:.2f}", done, generations),
                seed,
            )
        costs = _training_costs(rollouts, gains)
    finally:
        rollouts.close()
    data = {
        "suite": suite,
        "suite_hash": get_suite(suite).hash,
        "action_mode": action_mode,
        "seed": seed,
        "generations": generations,
        "population": POPULATION,
        "gains": gains.tolist(),
        "training": {"scenarios": len(training), **costs},
    }
    entry = {
        "name": name,
        "description": f"Linear feedback of a group's own observation, the same in every group, tuned by CMA-ES on "
        f"{len(training)} training scenarios of {suite}.",
        "action_mode": action_mode,
        "training_seed": seed,
        "authors": list(authors),
    }
    write_atomically(output / POLICY_FILE, linear_policy(gains, rollouts.n_wtg))
    # What is judged is the file that will be played.
    data["validation"] = _validate(output / POLICY_FILE, suite, action_mode, n_threads)
    if gains_file is not None:
        write_atomically(gains_file, to_json(data))
    # Last, because it is what makes the folder an entry. Such texts, numbers and lists are alike in JSON and TOML.
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in entry.items()]
    write_atomically(output / ENTRY_FILE, "".join(lines))
    return data


def _training_costs(rollouts: Rollouts, gains: Floats) -> dict[str, float]:
    """Mean pinned costs of the feedback and of the reference."""
    alone = rollouts.with_candidates(1)
    try:
        costs = {"policy": alone.play(linear_feedback(gains))[:, 0], "reference": alone.reference()}
        return {name: float(alone.pinned(terms).mean()) for name, terms in costs.items()}
    finally:
        alone.close()


def _validate(path: Path, suite: str, action_mode: str, n_threads: int | None) -> dict[str, Any]:
    """Costs of the policy and of the reference on all validation scenarios, and its score, if there is one."""
    entry = Entry(name="linear feedback", policy=OnnxPolicy(path), action_mode=action_mode)
    with Progress("episodes") as progress:
        results = evaluate([entry], suite, "validation", n_threads=n_threads, on_progress=progress.update)
    try:
        score = next(s.score.value for s in results.summaries if s.name == entry.name)
    except NoScaleError:
        score = None

    def means(of: str) -> dict[str, float]:
        rows = [episode.metrics for episode in results.episodes_of(of)]
        return {term: float(np.mean([row[f"cost_{term}"] for row in rows])) for term in COST_TERMS}

    cap = float(results.settings["weights"]["cap"])
    costs = {
        who: float(np.mean([pinned(episode, cap) for episode in results.episodes_of(name)]))
        for who, name in (("policy", entry.name), ("reference", ANCHORS[1]))
    }
    terms = {"terms": means(entry.name), "reference_terms": means(ANCHORS[1])}
    return {"scenarios": len(results.seeds), "score": score, **costs, **terms}


__all__ = ["linear_policy", "make_linear_feedback"]
