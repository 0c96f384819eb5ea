"""The model card of an exported policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from agents import rllib_ppo
from agents.runs import Run
from wtg_gym import ENV_ID
from wtg_gym.files import markdown_table, sha256

#: Columns of the training curve and their digits.
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

#: What a repetition gives.
_EXACTLY = "the same versions on the same kind of machine give the same weights"
_REPEATED = {rllib_ppo.NAME: "runners end in any order, so that a repetition may give other weights"}


def model_card(run: Run, best: Mapping[str, float], name: str, authors: Sequence[str], content: bytes) -> str:
    """Return the README.md of an exported policy.

    Args:
        run: that it comes from.
        best: the row of its curve that the policy is of.
        name: of the entry.
        authors: names.
        content: of policy.onnx.
    """
    settings, provenance = run.settings, run.provenance
    last = run.curve[-1]
    facts = {
        "environment": f"`{ENV_ID}`, suite `{settings.suite}`",
        "actions": f"`{settings.action_mode}`, deterministic",
        "observations": f"`{settings.observation_mode}`",
        "algorithm": f"`{settings.algo}`",
        "training seed": str(settings.seed),
        "steps": f"{best['timesteps']:,} for this policy, {last['timesteps']:,} of {settings.timesteps:,} in the run",
        "wall time": f"{last['wall_time_s']:,.0f} s, {run.resumed} interruptions",
        "validation score": f"{best['score']:.1f} on {settings.validation_episodes} scenarios "
        "(MPPT 0, reference 100), chosen as the best of the curve: a little optimistic",
        "authors": ", ".join(authors) or "not given",
        "sha256 of policy.onnx": f"`{sha256(content)}`",
    }
    changes = [change for process in run.resumptions for change in process["differences"]]
    if changes:
        facts["changed by a resumption"] = "; ".join(changes)
    curve = markdown_table(
        list(_CURVE),
        [[f"{row[key]:,.{digits}f}" for key, digits in _CURVE.items()] for row in run.curve],
        right=range(len(_CURVE)),
    )
    return (
        "\n\n".join(
            [
                f"# {name}",
                "A policy that modulates the grid-forming control of wind turbines on the IEEE 14-bus system.",
                _table(facts),
                "## Use",
                "With the checkout's root as the working folder, and this folder in place of `FOLDER`:",
                "```\nwtg-gym evaluate --entries FOLDER --suite standard\n```",
                "## Hyperparameters",
                _table({key: f"`{value}`" for key, value in sorted(settings.hyperparameters.items())}),
                f"Number of lanes in this run: {settings.n_envs}.",
                "## Training curve",
                curve,
                "## How to reproduce",
                f"In a checkout of commit `{provenance['git_commit']}`:",
                f"```\n{provenance['command']}\n```",
                _table({key: str(value) for key, value in sorted(provenance["versions"].items())}),
                f"Source hash `{provenance['source_hash']}`, suite hash `{provenance['suite_hash']}`, "
                f"{provenance['machine']}; {_REPEATED.get(settings.algo, _EXACTLY)}.",
            ]
        )
        + "\n"
    )


def _table(facts: Mapping[str, Any]) -> str:
    return markdown_table(["", ""], [[key, value] for key, value in facts.items()])


__all__ = ["model_card"]
