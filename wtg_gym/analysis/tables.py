"""Claims, omissions and small-signal results as Markdown tables for docs/validation.md."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from wtg_gym.analysis.claim import Claim
from wtg_gym.analysis.eigenvalues import Mode
from wtg_gym.analysis.infinite_bus import Agreement
from wtg_gym.analysis.loops import SingleMachine
from wtg_gym.analysis.omissions import Omissions, RotorRun
from wtg_gym.analysis.voltage_limits import REACTIVE_LIMIT_PU, VOLTAGE_LIMIT_PU
from wtg_gym.files import markdown_table
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY


def claims_table(claims: Iterable[Claim]) -> str:
    """Return the claims with their verdicts, remarks below the table."""
    claims = list(claims)
    notes: list[str] = []
    rows = []
    for claim in claims:
        verdict = ("holds" if claim.holds else "**does not hold**") + (", fitted" if claim.fitted else "")
        if claim.remark:
            notes.append(f"({len(notes) + 1}) {claim.remark}  ")
            verdict += f" ({len(notes)})"
        rows.append((claim.says, claim.source, claim.expected, claim.measured, verdict))
    held = sum(claim.holds for claim in claims)
    fitted = [claim.fitted for claim in claims if claim.fitted and claim.holds]
    by = ", ".join(f"{name} to {fitted.count(name)}" for name in dict.fromkeys(fitted))
    count = (
        f"{held} of {len(claims)} claims hold; {len(fitted)} of them are numbers that a parameter of this model was "
        f"fitted to ({by}), so that {held - len(fitted)} hold without a fit."
    )
    table = markdown_table(("the paper says", "section", "expected", "measured", "verdict"), rows)
    return "\n\n".join([count, table, "\n".join(notes)]).strip()


def omissions_sections(found: Omissions) -> tuple[str, str, str]:
    """Return the sections on rotor energy, on voltages, and on powers and rotor speeds without limits."""
    return _rotor_energy(found), _voltages(found), _limits(found)


def _rotor_energy(found: Omissions) -> str:
    frequency_hz = found.paper_runs[REFERENCE_STRATEGY].final_hz
    balance = markdown_table(
        (
            "wind [m/s]",
            "ω_m at ω_st [p.u.]",
            f"ω_m at {frequency_hz:.2f} Hz [p.u.]",
            "2H_m Δω_m [p.u. s]",
            "H_m Δ(ω_m²) [p.u. s]",
            "credited too much",
        ),
        [
            (
                f"{row.wind_m_s:g}",
                f"{row.before_pu:.3f}",
                f"{row.after_pu:.3f}",
                f"{row.credited_s:.3f}",
                f"{row.stored_s:.3f}",
                f"{100 * (row.credited_s / row.stored_s - 1):+.0f} %",
            )
            for row in found.energy
        ],
        right=range(6),
    )

    runs = markdown_table(
        ("strategy", "stall, the paper's rotor", "stall, H_m ω_m²", "nadir, the paper's rotor [Hz]", "H_m ω_m² [Hz]"),
        [
            (name, _stall(run), _stall(other), f"{run.nadir_hz:.4f}", f"{other.nadir_hz:.4f}")
            for (name, run), other in zip(found.paper_runs.items(), found.energy_runs.values(), strict=True)
        ],
        right=range(1, 5),
    )
    counts = markdown_table(
        ("suite", "strategy", "runs", "stalls, the paper's rotor", "stalls, H_m ω_m²", "nadir, median shift [mHz]"),
        [
            (
                row.suite,
                row.strategy,
                str(row.n_scenarios),
                str(row.stalls),
                str(row.energy_stalls),
                f"{1e3 * row.nadir_shift_hz:+.1f}",
            )
            for row in found.counts
        ],
        right=range(2, 6),
    )
    return f"{balance}\n\nThe paper's load increase:\n\n{runs}\n\nValidation scenarios of the suites:\n\n{counts}"


def _stall(run: RotorRun) -> str:
    return f"{run.end_s:.1f} s" if run.status == Status.STALL else "none"


def _voltages(found: Omissions) -> str:
    def pair(values: np.ndarray, digits: int) -> str:
        return " / ".join(f"{value:.{digits}f}" for value in values)

    rows = [
        (
            f"{case.bus_voltage_pu:.3f}",
            pair(case.voltage_pu, 2),
            pair(case.reactive_pu, 2),
            pair(case.synchronising_coefficient, 2),
            pair(case.phase_margin_deg, 0),
        )
        for case in (found.held, found.limited)
    ]
    header = ("V at bus 2 [p.u.]", "E [p.u.]", "Q [p.u.]", "K_p [p.u./rad]", "margin of the reference [°]")
    lowest, highest = (pick(row.voltage_pu[i] for row in found.counts) for i, pick in enumerate((min, max)))
    over, n = sum(row.over_reactive for row in found.counts), sum(row.n_scenarios for row in found.counts)
    return (
        f"{markdown_table(header, rows, right=range(5))}\n\n"
        f"The second row is the voltage of bus 2 at which no E exceeds {VOLTAGE_LIMIT_PU:g} p.u. In the suites E is "
        f"{lowest:.2f} … {highest:.2f} p.u., and {over} of {n} runs (four strategies) start with a group that feeds "
        f"more than {REACTIVE_LIMIT_PU:.2f} p.u. of reactive power, a power factor of 0.95 at rated power."
    )


def _limits(found: Omissions) -> str:
    rows = [
        (
            row.suite,
            row.strategy,
            f"{row.motoring} of {row.n_scenarios}",
            f"{row.peak_power_pu:.2f}",
            f"{row.least_rotor_pu:.2f}",
        )
        for row in found.counts
    ]
    header = ("suite", "strategy", "runs with p < 0", "largest p [p.u.]", "smallest ω_m [p.u.]")
    return markdown_table(header, rows, right=(2, 3, 4))


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
