"""The entry.toml that makes a folder with a policy an entry of the leaderboard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agents.runs import RunSettings
from wtg_gym.evaluation import Entry
from wtg_gym.files import write_atomically
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.policies.load import ENTRY_FILE
from wtg_gym.policies.names import check_not_built_in
from wtg_gym.policies.submission_folder import entry_text
from wtg_gym.scenarios import get_suite


def entry_values(
    settings: RunSettings, timesteps: int, *, name: str | None = None, description: str = ""
) -> dict[str, Any]:
    """Return the keys and values of entry.toml for a run's policy.

    Args:
        settings: of the run.
        timesteps: steps that the policy was trained for.
        name: of the entry; None for one made of algorithm and action mode.
        description: one sentence on what it is; empty for a general one.

    Raises:
        ValueError: the leaderboard would refuse the name.
    """
    values: dict[str, Any] = {
        "name": name or f"{settings.algo} {settings.action_mode}",
        "description": description or f"Trained with {settings.algo} for {timesteps} steps.",
        "action_mode": settings.action_mode,
        "observation_mode": settings.observation_mode,
        "training_seed": settings.seed,
    }
    values |= played_in(settings.suite, settings.strategy)
    Entry(**values)
    check_not_built_in("the entry's name", values["name"])
    return values


def played_in(suite: str, strategy: str) -> dict[str, str]:
    """Return the keys for a suite's environment, and for a law that is not the published one."""
    values = {} if strategy == REFERENCE_STRATEGY else {"strategy": strategy}
    return {**values, "environment": get_suite(suite).benchmark.env_id}


def write_entry(folder: Path, values: Mapping[str, Any]) -> None:
    """Write entry.toml; the values are texts, whole numbers and lists of texts."""
    write_atomically(folder / ENTRY_FILE, entry_text(values))
