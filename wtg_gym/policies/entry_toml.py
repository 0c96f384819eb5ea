"""entry.toml: the one parser of it, for folders of one's own as for submissions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from wtg_gym.files import parse_toml
from wtg_gym.physics.tracking_law import STRATEGY_NAMES
from wtg_gym.policies.submission_texts import short
from wtg_gym.tasks import TASKS, V1
from wtg_gym.tasks.episode import ACTION_MODES
from wtg_gym.tasks.observation import OBSERVATION_MODES

#: What any folder's file must say.
NEEDED = ("name", "action_mode")
_KEYS = (
    "name",
    "description",
    "action_mode",
    "observation_mode",
    "per_group",
    "environment",
    "strategy",
    "training_seed",
    "authors",
    "trained_on",
)
_CHOICES = {
    "action_mode": tuple(ACTION_MODES),
    "observation_mode": OBSERVATION_MODES,
    "environment": tuple(TASKS),
    "strategy": STRATEGY_NAMES,
}
_LARGEST_SEED = 2**32 - 1


def parse_entry(text: str, needed: Sequence[str] = NEEDED) -> dict[str, Any]:
    """Return the keys and values of an entry.toml; without `environment`, it is for version v1.

    Args:
        text: content of the file.
        needed: keys that it must have; it may have the others of a submission, see CONTRIBUTING.md.

    Raises:
        ValueError: it is not TOML, or a key is missing, unknown, of the wrong type or not one of its choices; the
            message, one line of ASCII but for this package's own words, names what is allowed.
    """
    try:
        data = parse_toml(text, "it")
    except ValueError as error:
        raise ValueError(ascii(str(error))[1:-1][:160]) from error
    others = [key for key in _KEYS if key not in needed]
    missing, unknown = [key for key in needed if key not in data], sorted(set(data) - {*needed, *others})
    if missing or unknown:
        raise ValueError(
            f"it must have the keys {', '.join(needed)} and may have {', '.join(others)}; "
            f"missing: {missing}, unknown: {ascii(unknown)[:120]}"
        )
    for key, allowed in _CHOICES.items():
        if key in data and (not isinstance(data[key], str) or data[key] not in allowed):
            raise ValueError(f"{key} must be one of {', '.join(allowed)}, got {short(data[key])}")
    for key in ("name", "description", "trained_on"):
        if not isinstance(data.get(key, ""), str):
            raise ValueError(f"{key} must be text, got {short(data[key])}")
    authors = data.get("authors", [])
    if not isinstance(authors, list) or not all(isinstance(each, str) and each for each in authors):
        raise ValueError(f"authors must be a list of texts, none of them empty, got {short(authors)}")
    if not isinstance(data.get("per_group", False), bool):
        raise ValueError(f"per_group must be true or false, got {short(data['per_group'])}")
    seed = data.get("training_seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed <= _LARGEST_SEED:
        raise ValueError(f"training_seed must be a whole number 0 … {_LARGEST_SEED}, got {short(seed)}")
    return {"environment": V1.env_id, **data}
