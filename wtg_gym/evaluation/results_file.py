"""The two files of results, a JSON that describes and a CSV with the table, and the checks of both."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wtg_gym.evaluation.episodes import Episode, from_csv
from wtg_gym.evaluation.metrics import METRICS
from wtg_gym.files import parse_json, read_text, sha256, to_json, write_together
from wtg_gym.names import check_name
from wtg_gym.policies.entry import check_rows
from wtg_gym.scenarios import get_suite

#: Version of the files; another number is another form.
FORMAT = 8
#: Keys of the description that are texts.
TEXTS = ("suite", "split", "suite_hash", "source_hash")
#: By how much a summary may differ from the sum of its table, relative, or absolute near zero.
_ROUNDING = 1e-6


def write(stem: Path, description: Mapping[str, Any], table: str) -> tuple[Path, Path]:
    """Write `<stem>.json` and `<stem>.csv`, both or none; return their paths."""
    json_path, csv_path = (stem.with_name(f"{stem.name}.{ending}") for ending in ("json", "csv"))
    data = {**description, "csv_sha256": sha256(table.encode())}
    data["sha256"] = sha256(to_json(data).encode())
    # The JSON last, so that it never describes a table that is not there yet.
    write_together({csv_path: table, json_path: to_json(data)})
    return json_path, csv_path


def read(json_path: Path) -> tuple[dict[str, Any], list[Episode]]:
    """Return the checked description and the episodes of results; the CSV lies beside the JSON.

    Raises:
        ValueError: a file is missing, cut short, of another version or was edited.
        KeyError, TypeError: the description is none of results.
    """
    text = read_text(json_path, "description of the results")
    data = parse_json(text, "it")
    if not isinstance(data, dict):
        raise ValueError(f"expected an object that describes the results, got {type(data).__name__}")
    if data.get("format") != FORMAT:
        got = repr(data.get("format"))[:80]
        raise ValueError(f"format must be {FORMAT}, that of this version, got {got}; evaluate again")
    content = {key: value for key, value in data.items() if key != "sha256"}
    if sha256(to_json(content).encode()) != data.get("sha256") or to_json(data) != text:
        raise ValueError("it was edited or damaged: its sha256 does not fit its content")
    _check_description(data)
    csv_path = json_path.with_suffix(".csv")
    table = read_text(csv_path, "table of the results")
    if sha256(table.encode()) != data["csv_sha256"]:
        raise ValueError(f"{csv_path} is not its table: that was edited or belongs to another run")
    episodes = from_csv(table, csv_path)
    expected = [(entry["name"], entry["training_seed"], seed) for entry in data["entries"] for seed in data["seeds"]]
    if [(*episode.run, episode.seed) for episode in episodes] != expected:
        raise ValueError(
            f"{csv_path}: expected one row per entry and seed, in the order of the JSON's entries and seeds "
            f"({len(expected)} rows), got {len(episodes)} rows that differ"
        )
    return data, episodes


def check_summary(stored: Any, summed: Any, where: str) -> None:
    """Raise a ValueError if a stored summary differs from the sum of its table by more than rounding."""
    if isinstance(stored, dict) and isinstance(summed, dict) and set(stored) == set(summed):
        for key in summed:
            check_summary(stored[key], summed[key], f"{where}.{key}")
        return
    numbers = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in (stored, summed))
    if not (math.isclose(stored, summed, rel_tol=_ROUNDING, abs_tol=_ROUNDING) if numbers else stored == summed):
        raise ValueError(f"{where} is {str(stored)[:80]}, the table sums up to {str(summed)[:80]}; evaluate again")


def _check_description(data: dict[str, Any]) -> None:
    for entry in (*data["entries"], *data["failed"]):
        # It goes into tables and pages as it is.
        check_name("the entry's name", entry["name"])
    check_rows((*data["entries"], *data["failed"]))
    if data["metrics"] != {name: asdict(metric) for name, metric in METRICS.items()}:
        raise ValueError("the metrics are not those of this version; evaluate again")
    get_suite(data["suite"]).seeds(data["split"])
    if not data["seeds"] or any(type(seed) is not int for seed in data["seeds"]):
        raise ValueError("seeds must be a list of whole numbers")
