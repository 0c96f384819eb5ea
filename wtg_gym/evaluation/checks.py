"""Is this the description that an evaluation writes? Types and ranges of the JSON file, key by key."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from wtg_gym.evaluation.entries import is_name
from wtg_gym.evaluation.metrics import METRICS
from wtg_gym.scenarios import SPLITS, SUITES, VERIFICATION, VerificationDraw

_HEX = re.compile("[0-9a-f]{64}")


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_hash(value: Any) -> bool:
    return isinstance(value, str) and _HEX.fullmatch(value) is not None


def _is_seed(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _is_object(value: Any) -> bool:
    return isinstance(value, dict)


_ALL_SPLITS = (*SPLITS, VERIFICATION)
_SHA256 = (_is_hash, "64 hexadecimal digits")
_DESCRIPTION: dict[str, tuple[Callable[[Any], bool], str]] = {
    "suite": (lambda v: _is_text(v) and v in SUITES, f"one of {', '.join(SUITES)}"),
    "split": (lambda v: _is_text(v) and v in _ALL_SPLITS, f"one of {', '.join(_ALL_SPLITS)}"),
    "suite_hash": _SHA256,
    "source_hash": _SHA256,
    "csv_sha256": _SHA256,
    "sha256": _SHA256,
    "seeds": (
        lambda v: isinstance(v, list) and bool(v) and all(map(_is_seed, v)),
        "a list of whole numbers from 0 on",
    ),
    "draw": (
        lambda v: v is None or (_is_object(v) and set(v) == {"commit", "secret_sha256"}),
        "null or an object with commit and secret_sha256",
    ),
    "environment": (
        lambda v: (
            _is_object(v) and set(v) == {"id", "fingerprint"} and _is_text(v["id"]) and _is_hash(v["fingerprint"])
        ),
        "an object with id, text, and fingerprint, 64 hexadecimal digits",
    ),
    "settings": (_is_object, "an object"),
    "versions": (lambda v: _is_object(v) and all(map(_is_text, v.values())), "an object of texts"),
    "entries": (lambda v: isinstance(v, list) and bool(v) and all(map(_is_object, v)), "a list of objects"),
    "failed": (lambda v: isinstance(v, list) and all(map(_is_object, v)), "a list of objects"),
    "metrics": (_is_object, "an object"),
    "summary": (_is_object, "an object"),
}
_ENTRY: dict[str, tuple[Callable[[Any], bool], str]] = {
    # It goes into tables and pages as it is.
    "name": (is_name, "1 … 60 printable characters without markup"),
    **{key: (_is_text, "text") for key in ("action_mode", "observation_mode")},
    **{key: (_is_text, "text") for key in ("description", "equation", "source")},
    "kind": (lambda v: v in ("law", "feedback", "learned"), "law, feedback or learned"),
    "training_seed": (lambda v: v is None or _is_seed(v), "null or a whole number from 0 on"),
    **{
        key: (lambda v: v is None or _is_hash(v), "null or 64 hexadecimal digits")
        for key in ("sha256", "policy_sha256")
    },
    "strategy": (_is_object, "an object"),
}
#: Fields of an entry's summary that are an interval.
_INTERVALS = ("score", "interquartile_mean", "difference", "probability_of_improvement")
#: Those that are null for some entries.
_OPTIONAL_INTERVALS = ("difference_to_above", "gap_closed_percent")


def check_description(data: Any, path: Path, version: int) -> None:
    """Check the JSON data of a results file.

    Args:
        data: the parsed file.
        path: the file, for messages.
        version: the format it must have.

    Raises:
        ValueError: a key is missing or unknown, or a value is of the wrong type or not finite; the message names
            file, key, value and what is expected.
    """
    if not isinstance(data, dict):
        raise ValueError(f"{path}: expected an object with results, got {type(data).__name__}")
    if data.get("format") != version or isinstance(data["format"], bool):
        raise ValueError(
            f"{path}: format must be {version}, that of this version, got {_short(data.get('format'))}; evaluate again"
        )
    _check_keys({key: value for key, value in data.items() if key != "format"}, _DESCRIPTION, str(path))
    for i, entry in enumerate(data["entries"]):
        _check_keys(entry, _ENTRY, f"{path}: entries[{i}]")
    for i, entry in enumerate(data["failed"]):
        _check_keys(entry, {**_ENTRY, "reason": (_is_text, "text")}, f"{path}: failed[{i}]")
    _check_metrics(data["metrics"], path)
    _check_draw(data, path)
    weights = data["settings"].get("weights")
    if not isinstance(weights, dict) or not _is_number(weights.get("cap")):
        raise ValueError(f"{path}: settings.weights.cap must be a number [1/s], got {weights!r}")
    # Empty: MPPT was not worse than the reference, there is no score.
    if data["summary"] and set(data["summary"]) != {entry["name"] for entry in data["entries"]}:
        raise ValueError(f"{path}: summary must have one object per entry, got {sorted(data['summary'])}")
    for name, summary in data["summary"].items():
        for key in (*_INTERVALS, *_OPTIONAL_INTERVALS):
            interval = summary.get(key) if isinstance(summary, dict) else None
            if key in _OPTIONAL_INTERVALS and interval is None:
                continue
            if not isinstance(interval, dict) or not all(_is_number(interval.get(k)) for k in ("value", "low", "high")):
                raise ValueError(f"{path}: summary.{name}.{key} must give value, low and high, got {interval!r}")


def _check_draw(data: dict[str, Any], path: Path) -> None:
    """The seeds of the split "verification", and no others, come of a draw."""
    if (data["split"] == VERIFICATION) != (data["draw"] is not None):
        raise ValueError(f"{path}: draw must be given for the split {VERIFICATION!r} alone, got {_short(data['draw'])}")
    if data["draw"] is not None:
        try:
            VerificationDraw(suite=data["suite"], seeds=tuple(data["seeds"]), **data["draw"])
        except ValueError as error:
            raise ValueError(f"{path}: draw: {error}") from error


def _check_keys(data: dict[str, Any], expected: dict[str, tuple[Callable[[Any], bool], str]], where: str) -> None:
    missing, unknown = sorted(set(expected) - set(data)), sorted(set(data) - set(expected))
    if missing or unknown:
        raise ValueError(f"{where}: missing keys {missing}, unknown keys {unknown}; expected {', '.join(expected)}")
    for key, (is_right, wanted) in expected.items():
        if not is_right(data[key]):
            raise ValueError(f"{where}: {key} must be {wanted}, got {_short(data[key])}")


def _check_metrics(metrics: dict[str, Any], path: Path) -> None:
    known = {name: asdict(metric) for name, metric in METRICS.items()}
    missing, unknown = sorted(set(known) - set(metrics)), sorted(set(metrics) - set(known))
    if missing or unknown:
        raise ValueError(f"{path}: missing metrics {missing}, unknown metrics {unknown}; known: {', '.join(known)}")
    for name, metric in metrics.items():
        if metric != known[name]:
            raise ValueError(f"{path}: metrics.{name} must be {known[name]}, got {_short(metric)}")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


__all__ = ["check_description"]
