"""The evidence as Markdown tables, for a page that the commands keep up to date."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from wtg_gym.analysis.eigenvalues import Mode
from wtg_gym.analysis.infinite_bus import Agreement
from wtg_gym.analysis.loops import SingleMachine
from wtg_gym.analysis.omissions import REACTIVE_LIMIT_PU, VOLTAGE_LIMIT_PU, Omissions, RotorRun
from wtg_gym.analysis.paper_claims import Claim
from wtg_gym.analysis.step_error import AccuracyStudy
from wtg_gym.files import markdown_table
from wtg_gym.physics.layout import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY


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
            claim.fitted,
            ("holds" if claim.holds else "**does not hold**")
            + (f" ({number[claim.key]})" if claim.key in number else ""),
        )
        for claim in claims
    ]
    table = markdown_table(("the paper says", "where", "expected", "measured", "fitted", "verdict"), rows)
    notes = "\n".join(f"({number[claim.key]}) {claim.remark}  " for claim in remarks)
    held = sum(claim.holds for claim in claims)
    fitted = [claim.fitted for claim in claims if claim.fitted and claim.holds]
    by = ", ".join(f"{name} to {fitted.count(name)}" for name in dict.fromkeys(fitted))
    count = (
        f"{held} of {len(claims)} claims hold; {len(fitted)} of them are numbers that a parameter of this model was "
        f"fitted to ({by}), so that {held - len(fitted)} hold without a fit."
    )
    return f"{count}\n\n{table}\n\n{notes}".strip()


def omissions_sections(found: Omissions) -> tuple[str, str, str]:
    """Return what is measured about rotor energy, about voltages, and about powers and rotor speeds without limits."""
    return _rotor_energy(found), _voltages(found), _limits(found)


def _rotor_energy(found: Omissions) -> str:
    """Return the energy balance of a rotor over wind, and the paper's load increase under both rotor equations."""
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

    def ends(run: RotorRun) -> str:
        return f"{run.end_s:.1f} s" if run.status == Status.STALL else "none"

    runs = markdown_table(
        ("strategy", "stall, the paper's rotor", "stall, H_m ω_m²", "nadir, the paper's rotor [Hz]", "H_m ω_m² [Hz]"),
        [
            (name, ends(run), ends(other), f"{run.nadir_hz:.4f}", f"{other.nadir_hz:.4f}")
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


def _voltages(found: Omissions) -> str:
    """Return internal voltages and K_p with bus 2 held where it is, and where no internal voltage is too high."""

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
    """Return how far powers and rotors go where the model has no limit, by suite and strategy."""
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
    "omissions_sections",
    "order_table",
    "system_margins_table",
]
