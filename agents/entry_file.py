"""The entry.toml of what a run has trained."""

from __future__ import annotations

import json
from typing import Any

from agents.runs import RunSettings
from wtg_gym.evaluation import Entry

_KEYS = ("name", "description", "action_mode", "observation_mode", "training_seed")


def entry_of(settings: RunSettings, timesteps: int, *, name: str | None = None, description: str = "") -> Entry:
    """Return the entry of a run's policy, without the policy.

    Args:
        settings: of the run.
        timesteps: steps that the policy was trained for.
        name: of the entry; None for one made of algorithm and action mode.
        description: one sentence on what it is; empty for a general one.

    Raises:
        ValueError: the leaderboard would refuse the name.
    """
    return Entry(
        name=name or f"{settings.algo} {settings.action_mode}",
        description=description or f"Trained with {settings.algo} for {timesteps} steps.",
        action_mode=settings.action_mode,
        observation_mode=settings.observation_mode,
        training_seed=settings.seed,
    )


def entry_file(entry: Entry, **further: Any) -> str:
    """Return the text of the entry's entry.toml; `further` keys hold texts or lists of texts."""
    values = {**{key: getattr(entry, key) for key in _KEYS}, **further}
    # Such texts, numbers and lists are written alike in JSON and TOML.
    return "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in values.items())


__all__ = ["entry_file", "entry_of"]
