"""The evidence as Markdown tables, for a page that the commands keep up to date."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from wtg_gym.files import markdown_table
from wtg_gym.small_signal import Mode, SingleMachine
from wtg_gym.validation.accuracy import AccuracyStudy
from wtg_gym.validation.agreement import Agreement
from wtg_gym.validation.claims import Claim


def claims_table(claims: Iterable[Claim]) -> str:
    """Return the claims with their verdicts, remarks below the table."""
    claims = list(claims)
    remarks = [claim for claim in claims if claim.remark]
    number = {claim.key: str(i) for i, claim in enumerate(remarks, start=1)}
    rows = [
        (
            claim.says,
            claim.source,
            claim.expected,
            claim.measured,
            ("holds" if claim.holds else "**does not hold**")
            + (f" ({number[claim.key]})" if claim.key in number else ""),
        )
        for claim in claims
    ]
    table = markdown_table(("the paper says", "where", "expected", "measured", "verdict"), rows)
    notes = "\n".join(f"({number[claim.key]}) {claim.remark}  " for claim in remarks)
    held = sum(claim.holds for claim in claims)
    return f"{held} of {len(claims)} claims hold.\n\n{table}\n\n{notes}".strip()


def agreement_table(found: Iterable[Agreement]) -> str:
    """Return the comparison of both small-signal models on an infinite bus."""
    rows = [
        (
            row.law,
            f"{row.wind_m_s:g}",
            row.side,
            f"{row.synchronising_coefficient:.3f}",
            f"{row.phase_margin_deg:.1f}",
            ", ".join(_poles(row.poles)),
            f"{row.largest_difference:.0e}",
        )
        for row in found
    ]
    header = ("law", "wind [m/s]", "slope", "K_p", "margin [°]", "closed-loop poles [1/s]", "largest difference")
    return markdown_table(header, rows, right=(1, 3, 4, 6))


def system_margins_table(loops: Iterable[SingleMachine]) -> str:
    """Return the margins at the system's own K_p, both slopes of g(ω) of a law and wind in one row."""
    rows: dict[tuple[str, float], list[SingleMachine]] = {}
    for loop in loops:
        rows.setdefault((loop.law, loop.wind_m_s), []).append(loop)
    cells = [
        (
            law,
            f"{wind:g}",
            f"{own[0].synchronising_coefficient:.3f}",
            f"{own[0].margins().phase_margin_deg:.1f}",
            f"{own[-1].margins().phase_margin_deg:.1f}",
        )
        for (law, wind), own in rows.items()
    ]
    header = ("law", "wind [m/s]", "K_p", "margin, under-frequency [°]", "margin, over-frequency [°]")
    return markdown_table(header, cells, right=(1, 2, 3, 4))


def _poles(poles: Iterable[complex]) -> Iterable[str]:
    for pole in poles:
        if pole.imag > 1e-9:
            yield f"{pole.real:.3f} ± j{pole.imag:.3f}".replace("-", "−")
        elif abs(pole.imag) <= 1e-9:
            yield f"{pole.real:.3f}".replace("-", "−")


def mode_cells(mode: Mode) -> tuple[str, str, str, str, str]:
    """Return eigenvalue, frequency, damping ratio, time constant and the three states that take part most, as text."""
    oscillates = mode.eigenvalue.imag > 0.0
    shares = [f"{name} {100 * share:.0f} %" for name, share in mode.participation.items() if share >= 0.05]
    return (
        next(iter(_poles([mode.eigenvalue]))),
        f"{mode.frequency_hz:.3f}" if oscillates else "–",
        f"{mode.damping_ratio:.3f}" if oscillates else "–",
        f"{mode.time_constant_s:.3f}",
        ", ".join(shares[:3]),
    )


def modes_table(found: Iterable[Mode]) -> str:
    """Return the modes of a system with the states that take part most."""
    header = ("eigenvalue [1/s]", "frequency [Hz]", "damping ratio", "takes part")
    rows = [(*cells[:3], cells[4]) for cells in map(mode_cells, found)]
    return markdown_table(header, rows, right=(1, 2))


def accuracy_table(study: AccuracyStudy) -> str:
    """Return error and cost of every method and step; the default one in bold."""
    rows = []
    for row in study.rows:
        chosen = row.method == "RK4" and math.isclose(row.step_s, study.default_step_s)
        cells = (
            row.method,
            f"{1e3 * row.step_s:g}",
            f"{row.evaluations_per_s:.0f}",
            f"{row.microseconds_per_s:.0f}",
            _median_and_worst(row.frequency_hz),
            _median_and_worst(row.rotor_speed_pu),
            _median_and_worst(row.power_pu),
        )
        rows.append(tuple(f"**{cell}**" if chosen else cell for cell in cells))
    header = (
        "method",
        "step [ms]",
        "evaluations per s",
        "time per s [µs]",
        "frequency [Hz]",
        "rotor speed [p.u.]",
        "power [p.u.]",
    )
    return markdown_table(header, rows, right=(1, 2, 3))


def _median_and_worst(errors: np.ndarray) -> str:
    return f"{_error(float(np.median(errors)))} / {_error(float(errors.max()))}"


def _error(value: float) -> str:
    return f"{value:.1e}" if math.isfinite(value) else "diverges"


def order_table(study: AccuracyStudy) -> str:
    """Return the order of convergence of every method: its own, on a smooth case, and on the random ones."""
    names = list(dict.fromkeys(row.method for row in study.rows))
    rows = [
        (
            name,
            str(study.row(name, study.default_step_s).order),
            f"{study.smooth_order[name]:.2f}",
            f"{study.observed_order(name):.2f}",
        )
        for name in names
    ]
    header = ("method", "order", "observed, smooth case", "observed, random scenarios (median)")
    return markdown_table(header, rows, right=(1, 2, 3))


__all__ = [
    "accuracy_table",
    "agreement_table",
    "claims_table",
    "mode_cells",
    "modes_table",
    "order_table",
    "system_margins_table",
]
