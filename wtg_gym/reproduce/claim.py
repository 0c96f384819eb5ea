"""One claim of the paper, as it was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One statement of the paper and its measurement."""

    key: str  # short name
    source: str  # section, table or figure of the paper
    says: str  # the statement, in our words
    expected: str  # the result that confirms it, with its tolerance, in words
    measured: str  # the result, in words
    values: Mapping[str, float | list[float]]  # the numbers behind `measured`, units in their names
    holds: bool  # the verdict
    remark: str = ""  # a reader's footnote; empty for none
    fitted: str = ""  # the parameter that was chosen to meet this number; empty where none was
    #: target, tolerance: the expected number and its tolerance, where the claim is one number.
    target: float | None = None
    tolerance: float | None = None


_UNITS = {"deg": "°", "pu": " p.u."}


def near(
    key: str, source: str, says: str, found: tuple[str, float, int], target: float, tolerance: float, fitted: str
) -> Claim:
    """Return the claim that a fitted value is `target` within `tolerance`.

    Args:
        found: name of the value, which ends in its unit, the value, and its digits in the text.
        key, source, says, fitted: as for :class:`Claim`.
    """
    name, value, digits = found
    unit = _UNITS.get(name.rsplit("_", 1)[-1], "")
    return Claim(
        key=key,
        source=source,
        says=says,
        expected=f"{target:g}{unit} ± {tolerance:g}{unit}",
        measured=f"{value:.{digits}f}{unit}",
        values={name: float(value)},
        holds=abs(value - target) <= tolerance,
        target=target,
        tolerance=tolerance,
        fitted=fitted,
    )
