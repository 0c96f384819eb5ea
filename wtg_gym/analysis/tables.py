"""Claims, omissions and small-signal results as Markdown tables for docs/validation.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from wtg_gym.analysis.claim import Claim
from wtg_gym.analysis.eigenvalues import Mode
from wtg_gym.analysis.infinite_bus import Agreement
from wtg_gym.analysis.loops import SingleMachine
from wtg_gym.analysis.omissions import Omissions, RotorRun, SuiteCounts
from wtg_gym.analysis.voltage_limits import REACTIVE_LIMIT_PU, VOLTAGE_LIMIT_PU
from wtg_gym.files import markdown_table
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY

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
            "released too much",
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
    counts = _by_suite(
        found.counts,
        lambda row: f"{row.stalls} → {row.energy_stalls} ({1e3 * row.nadir_shift_hz:+.1f})",
    )
    return (
        f"{balance}\n\nThe paper's load increase:\n\n{runs}\n\nRuns that stall, out of {found.counts[0].n_scenarios}: "
        "with the paper's rotor → with H_m ω_m². In brackets the median change of the nadir [mHz].\n\n"
        f"{counts}"
    )


def _by_suite(counts: Sequence[SuiteCounts], cell: Callable[[SuiteCounts], str]) -> str:
    """Return a table with a row for each suite and a column for each strategy."""
    cells = {(row.suite, row.strategy): cell(row) for row in counts}
    suites, strategies = (list(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))
    rows = [(suite, *(cells[suite, strategy] for strategy in strategies)) for suite in suites]
    return markdown_table(("suite", *strategies), rows, right=range(1, 1 + len(strategies)))


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
    table = _by_suite(found.counts, lambda row: f"{row.motoring} / {row.peak_power_pu:.2f} / {row.least_rotor_pu:.2f}")
    return f"Runs with p < 0 out of {found.counts[0].n_scenarios} / largest p [p.u.] / smallest ω_m [p.u.]:\n\n{table}"


def margins_table(found: Iterable[Agreement], system: Iterable[SingleMachine]) -> str:
    """Return the margins on an infinite bus and in the 14-bus system, a law and a wind in one row.

    Args:
        found: comparison of both small-signal models on an infinite bus.
        system: the loops at the K_p of the 14-bus system.
    """
    found = list(found)
    rows: dict[tuple[str, float], list[tuple[float, list[float]]]] = {}
    own: dict[tuple[str, float], list[Agreement]] = {}
    for each in found:
        own.setdefault((each.law, each.wind_m_s), []).append(each)
    for key, sides in own.items():
        rows[key] = [(sides[0].synchronising_coefficient, [side.phase_margin_deg for side in sides])]
    loops: dict[tuple[str, float], list[SingleMachine]] = {}
    for loop in system:
        loops.setdefault((loop.law, loop.wind_m_s), []).append(loop)
    for key, both in loops.items():
        rows[key].append((both[0].synchronising_coefficient, [loop.margins().phase_margin_deg for loop in both]))
    cells = []
    for (law, wind), columns in rows.items():
        texts = []
        for coefficient, margins in columns:
            # One number where the slopes of g(ω) do not differ.
            shown = dict.fromkeys(f"{margin:.1f}" for margin in margins)
            texts += [f"{coefficient:.3f}", " / ".join(shown)]
        cells.append((law, f"{wind:g}", *texts))
    header = ("law", "wind [m/s]", "K_p, infinite bus", "margin [°]", "K_p, 14 buses", "margin [°]")
    largest = max(each.largest_difference for each in found)
    return (
        f"Largest relative difference of a closed-loop pole between both models: {largest:.0e}.\n\n"
        f"{markdown_table(header, cells, right=range(1, 6))}"
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
