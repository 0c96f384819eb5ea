"""The paper's claims: what a claim is, and the table of all. Texts are in claims.toml."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wtg_gym.files import markdown_table, read_toml

#: Texts of every claim by its key.
TEXTS: dict[str, dict[str, Any]] = read_toml(Path(__file__).with_name("claims.toml"), "table of claims")
_UNITS = {"deg": "°", "pu": " p.u."}


@dataclass(frozen=True)
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


def measured(key: str, text: str, values: Mapping[str, float | list[float]], holds: bool, in_remark: str = "") -> Claim:
    """Return a claim as it was measured; `in_remark` are the numbers that its remark names."""
    words = TEXTS[key]
    remark = words.get("remark", "").format(in_remark)
    return Claim(key, **words | {"remark": remark}, measured=text, values=values, holds=holds)


def near(key: str, name: str, value: float, digits: int) -> Claim:
    """Return the claim that a value is the paper's number within its tolerance; `name` ends in the unit."""
    words, unit = TEXTS[key], _UNITS.get(name.rsplit("_", 1)[-1], "")
    holds = abs(value - words["target"]) <= words["tolerance"]
    return measured(key, f"{value:.{digits}f}{unit}", {name: float(value)}, holds)


def claims_table(claims: Iterable[Claim]) -> str:
    """Return the claims with their verdicts as Markdown, remarks below the table."""
    claims = list(claims)
    notes: list[str] = []
    rows: list[tuple[str, ...]] = []
    for source, section in itertools.groupby(claims, key=lambda claim: claim.source):
        rows.append((f"**{source}**", "", "", ""))
        for claim in section:
            verdict = ("holds" if claim.holds else "**does not hold**") + (", fitted" if claim.fitted else "")
            if claim.remark:
                notes.append(f"({len(notes) + 1}) {claim.remark}  ")
                verdict += f" ({len(notes)})"
            rows.append((claim.says, claim.expected, claim.measured, verdict))
    held = sum(claim.holds for claim in claims)
    fitted = [claim.fitted for claim in claims if claim.fitted and claim.holds]
    by = ", ".join(f"{name} to {fitted.count(name)}" for name in dict.fromkeys(fitted))
    count = (
        f"{held} of {len(claims)} claims hold: {held - len(fitted)} without a fit, and {len(fitted)} numbers that "
        f"parameters of this model were fitted to ({by})."
    )
    table = markdown_table(("the paper says", "expected", "measured", "verdict"), rows)
    return "\n\n".join([count, table, "\n".join(notes)]).strip()
