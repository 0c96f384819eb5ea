"""One claim of the paper, as it was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One statement of the paper and what came out.

    Args:
        key: short name.
        source: section, table or figure of the paper.
        says: the statement, in our words.
        expected: what must come out, with its tolerance, in words.
        measured: what came out, in words.
        values: the numbers behind `measured`, units in their names.
        holds: the verdict.
        remark: what a reader should know about it.
        fitted: the parameter that was chosen so that this comes out; empty where none was.
        target, tolerance: the number that must come out and how closely, where the claim is one number.
    """

    key: str
    source: str
    says: str
    expected: str
    measured: str
    values: Mapping[str, float | list[float]]
    holds: bool
    remark: str = ""
    fitted: str = ""
    target: float | None = None
    tolerance: float | None = None


def near(
    key: str,
    source: str,
    says: str,
    name: str,
    value: float,
    expected: float,
    tolerance: float,
    *,
    digits: int = 3,
    fitted: str = "",
) -> Claim:
    """Return the claim that a value, whose name ends in its unit, is `expected` within `tolerance`."""
    unit = name.rsplit("_", 1)[-1] if name.endswith(("_deg", "_pu", "_s")) else ""
    unit = {"deg": "°", "pu": " p.u.", "s": " s"}.get(unit, "")
    return Claim(
        key=key,
        source=source,
        says=says,
        expected=f"{expected:g}{unit} ± {tolerance:g}{unit}",
        measured=f"{value:.{digits}f}{unit}",
        values={name: float(value)},
        holds=abs(value - expected) <= tolerance,
        target=expected,
        tolerance=tolerance,
        fitted=fitted,
    )


__all__ = ["Claim", "near"]
