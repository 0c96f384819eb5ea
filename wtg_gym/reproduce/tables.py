"""Claims and small-signal results as Markdown tables for docs/validation.md."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

from wtg_gym.files import markdown_table
from wtg_gym.physics.modes import Mode
from wtg_gym.reproduce.claim import Claim
from wtg_gym.reproduce.infinite_bus import Agreement
from wtg_gym.reproduce.loops import SingleMachine

#: Real eigenvalues below minus this are not listed one by one [1/s].
_FAST_1_S = 5.0


def claims_table(claims: Iterable[Claim]) -> str:
    """Return the claims with their verdicts, remarks below the table."""
    claims = list(claims)
    notes: list[str] = []
    rows: list[tuple[str, ...]] = []
    section = ""
    for claim in claims:
        if claim.source != section:
            section = claim.source
            rows.append((f"**{section}**", "", "", ""))
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


def margins_table(found: Iterable[Agreement], system: Iterable[SingleMachine]) -> str:
    """Return the margins on an infinite bus and in the 14-bus system, a law and a wind in one row."""
    found = list(found)
    cells: dict[tuple[str, float], list[str]] = {}
    for loops in (
        [(each.law, each.wind_m_s, each.synchronising_coefficient, each.phase_margin_deg) for each in found],
        [(each.law, each.wind_m_s, each.synchronising_coefficient, each.margins().phase_margin_deg) for each in system],
    ):
        for key, sides in itertools.groupby(loops, key=lambda loop: loop[:2]):
            coefficients, margins = zip(*((k_p, f"{margin:.1f}") for *_, k_p, margin in sides), strict=True)
            # One number where the slopes of g(ω) do not differ.
            cells.setdefault(key, []).extend([f"{coefficients[0]:.3f}", " / ".join(dict.fromkeys(margins))])
    rows = [(law, f"{wind:g}", *texts) for (law, wind), texts in cells.items()]
    header = ("law", "wind [m/s]", "K_p, infinite bus", "margin [°]", "K_p, 14 buses", "margin [°]")
    largest = max(each.largest_difference for each in found)
    return (
        f"Largest relative difference of a closed-loop pole between both models: {largest:.0e}.\n\n"
        f"{markdown_table(header, rows, right=range(1, 6))}"
    )


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
    """Return the oscillating modes as a table, the others as a list, each with the states that take part most."""
    found = list(found)
    header = ("eigenvalue [1/s]", "frequency [Hz]", "damping ratio", "takes part")
    rows = [(*cells[:3], cells[4]) for cells in (mode_cells(mode) for mode in found if mode.eigenvalue.imag > 0.0)]
    real = sorted((mode for mode in found if mode.eigenvalue.imag == 0.0), key=lambda mode: -mode.eigenvalue.real)
    texts = [f"{next(iter(_poles([mode.eigenvalue])))} ({next(iter(mode.participation))})" for mode in real]
    n_slow = sum(mode.eigenvalue.real > -_FAST_1_S for mode in real)
    return (
        f"{markdown_table(header, rows, right=(1, 2))}\n\n"
        f"Real eigenvalues [1/s], each with the state that takes part most: {', '.join(texts[:n_slow])}, and "
        f"{len(texts) - n_slow} from {texts[n_slow]} to {texts[-1]}."
    )
