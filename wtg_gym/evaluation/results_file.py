"""The two files of results: a JSON with description and summary, a CSV of the episodes; how they are checked."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wtg_gym.evaluation.episodes import Episode, from_csv, to_csv
from wtg_gym.evaluation.metrics import METRICS
from wtg_gym.files import parse_json, read_text, sha256, to_json, write_together
from wtg_gym.policies.entry import is_name
from wtg_gym.scenarios import FRESH, SPLITS, SUITES, FreshDraw, get_suite

#: Version of the files; another number is another form. Version 3 sums its table up in other words, and is read too.
FORMAT, _READ = 4, (3, 4)
#: Keys of the description that are texts.
TEXTS = ("suite", "split", "suite_hash", "source_hash")
#: By how much a summary may differ from the sum of its table, relative, or absolute near zero.
_ROUNDING = 1e-6


def write(stem: Path, description: Mapping[str, Any], episodes: Sequence[Episode]) -> tuple[Path, Path]:
    """Write `<stem>.json` and `<stem>.csv`; return their paths."""
    json_path, csv_path = (stem.with_name(f"{stem.name}.{ending}") for ending in ("json", "csv"))
    table = to_csv(episodes)
    data = {**description, "csv_sha256": sha256(table.encode())}
    data["sha256"] = sha256(to_json(data).encode())
    # The JSON last, so that it never describes a table that is not there yet.
    write_together({csv_path: table, json_path: to_json(data)})
    return json_path, csv_path


def read(json_path: Path) -> tuple[dict[str, Any], list[Episode]]:
    """Return the checked description and episodes of a JSON and the CSV beside it; errors as of `Results.read`."""
    csv_path = json_path.with_suffix(".csv")
    text = read_text(json_path, "results file")
    data = parse_json(text, f"the results file {json_path}")
    _check_description(data, str(json_path))
    content = {key: value for key, value in data.items() if key != "sha256"}
    if sha256(to_json(content).encode()) != data["sha256"] or to_json(data) != text:
        raise ValueError(f"{json_path} was edited or damaged: its sha256 does not fit its content; evaluate again")
    table = read_text(csv_path, "table of episodes")
    episodes = from_csv(table, csv_path)
    if sha256(table.encode()) != data["csv_sha256"]:
        raise ValueError(
            f"{csv_path} is not the table that {json_path} describes (csv_sha256): it was edited or belongs to "
            "another run; evaluate again"
        )
    names = [entry["name"] for entry in data["entries"]]
    missing = [name for name in get_suite(data["suite"]).benchmark.anchors if name not in names]
    if missing:
        raise ValueError(f"{csv_path}: the score's anchors {missing} are missing from the entries {names}")
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
    numbers = _is_number(stored) and _is_number(summed)
    if not (math.isclose(stored, summed, rel_tol=_ROUNDING, abs_tol=_ROUNDING) if numbers else stored == summed):
        raise ValueError(f"{where} is {str(stored)[:80]}, the table sums up to {str(summed)[:80]}; evaluate again")


# --- the description, key by key -------------------------------------------------------------------------------------


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_hash(value: Any) -> bool:
    return isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None


def _is_seed(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


def _is_environment(value: Any) -> bool:
    return _is_object(value) and set(value) == {"id", "fingerprint"} and _is_text(value["id"])


_Test = tuple[Callable[[Any], bool], str]
_SPLITS = (*SPLITS, FRESH)
_SHA256: _Test = (_is_hash, "64 hexadecimal digits")
_SHA256_OR_NULL: _Test = (lambda v: v is None or _is_hash(v), "null or 64 hexadecimal digits")
_TEXT: _Test = (_is_text, "text")
_OBJECT: _Test = (_is_object, "an object")
_DESCRIPTION: dict[str, _Test] = {
    "suite": (lambda v: _is_text(v) and v in SUITES, f"one of {', '.join(SUITES)}"),
    "split": (lambda v: _is_text(v) and v in _SPLITS, f"one of {', '.join(_SPLITS)}"),
    **{key: _SHA256 for key in ("suite_hash", "source_hash", "csv_sha256", "sha256")},
    "seeds": (
        lambda v: isinstance(v, list) and bool(v) and all(map(_is_seed, v)),
        "a list of whole numbers from 0 on",
    ),
    "draw": (
        lambda v: v is None or (_is_object(v) and set(v) == {"commit", "secret_sha256"}),
        "null or an object with commit and secret_sha256",
    ),
    "environment": (_is_environment, "an object with id and fingerprint"),
    "settings": (
        lambda v: _is_object(v) and _is_object(v.get("weights")) and _is_number(v["weights"].get("cap")),
        "an object in which weights.cap is a number [1/s]",
    ),
    "versions": (lambda v: _is_object(v) and all(map(_is_text, v.values())), "an object of texts"),
    "entries": (lambda v: isinstance(v, list) and bool(v) and all(map(_is_object, v)), "a list of objects"),
    "failed": (lambda v: isinstance(v, list) and all(map(_is_object, v)), "a list of objects"),
    "metrics": _OBJECT,
    "summary": _OBJECT,
}
_ENTRY: dict[str, _Test] = {
    # It goes into tables and pages as it is.
    "name": (is_name, "1 … 60 printable characters without markup"),
    **{key: _TEXT for key in ("action_mode", "observation_mode", "description", "equation", "source")},
    "kind": (lambda v: v in ("law", "feedback", "learned"), "law, feedback or learned"),
    "training_seed": (lambda v: v is None or _is_seed(v), "null or a whole number from 0 on"),
    **{key: _SHA256_OR_NULL for key in ("sha256", "policy_sha256")},
    "strategy": _OBJECT,
}


def _check_description(data: Any, where: str) -> None:
    if not isinstance(data, dict):
        raise ValueError(f"{where}: expected an object with results, got {type(data).__name__}")
    if data.get("format") not in _READ:
        raise ValueError(
            f"{where}: format must be {FORMAT}, that of this version, or 3, got {_short(data.get('format'))}; "
            "evaluate again"
        )
    _check_keys({key: value for key, value in data.items() if key != "format"}, _DESCRIPTION, where)
    for i, entry in enumerate(data["entries"]):
        _check_keys(entry, _ENTRY, f"{where}: entries[{i}]")
    for i, entry in enumerate(data["failed"]):
        _check_keys(entry, {**_ENTRY, "reason": _TEXT}, f"{where}: failed[{i}]")
    known = {name: asdict(metric) for name, metric in METRICS.items()}
    for name in sorted({*known, *data["metrics"]}):
        if data["metrics"].get(name) != known.get(name):
            got = _short(data["metrics"].get(name))
            raise ValueError(f"{where}: metrics.{name} must be {known.get(name, 'left out')}, got {got}")
    if (data["split"] == FRESH) != (data["draw"] is not None):
        raise ValueError(f"{where}: draw must be given for the split {FRESH!r} alone, got {_short(data['draw'])}")
    if data["draw"] is not None:
        try:
            FreshDraw(suite=data["suite"], seeds=tuple(data["seeds"]), **data["draw"])
        except ValueError as error:
            raise ValueError(f"{where}: draw: {error}") from error


def _check_keys(data: dict[str, Any], expected: dict[str, _Test], where: str) -> None:
    missing, unknown = sorted(set(expected) - set(data)), sorted(set(data) - set(expected))
    if missing or unknown:
        raise ValueError(f"{where}: missing keys {missing}, unknown keys {unknown}; expected {', '.join(expected)}")
    for key, (is_right, wanted) in expected.items():
        if not is_right(data[key]):
            raise ValueError(f"{where}: {key} must be {wanted}, got {_short(data[key])}")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
