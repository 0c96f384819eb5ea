"""The study of the paper's omissions as Markdown, for docs/physics.md."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from wtg_gym.analysis.load_models import LOAD_MODELS, LoadRun
from wtg_gym.analysis.physics_study import (
    CHECKED,
    COMPARED,
    CRITICAL_WIND,
    SUITES_OF_ALL,
    THREE_FORMS,
    PhysicsStudy,
    SuiteCount,
)
from wtg_gym.analysis.plant_forms import HONEST, NREL, PAPER, PlantRun
from wtg_gym.analysis.voltage_limits import VOLTAGE_LIMIT_PU, VoltageLimit
from wtg_gym.envs.lanes import TERMINATION_REASONS
from wtg_gym.files import markdown_table
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.reproduce.loops import PAPER_SYNCHRONISING_COEFFICIENT

#: Largest difference of nadirs that "slightly lower" covers [Hz].
_SLIGHTLY_HZ = 0.01
#: The second step of the paper's load increase; its claims on nadir and RoCoF are about the first [s].
_SECOND_STEP_S = 30.0


def physics_sections(study: PhysicsStudy) -> dict[str, str]:
    """Return the tables by the names of their markers."""
    return {
        "survival": _survival(study),
        "cases": _cases(study),
        "parts": _parts(study),
        "suites": _suites(study),
        "rotor-energy": _rotor_energy(study),
        "margins": _margins(study),
        "loads": _loads(study.loads),
    }


def _survival(study: PhysicsStudy) -> str:
    """Return the paper's conclusions against several plants."""
    reference, others = COMPARED[0], COMPARED[1:]

    def verdict(holds: bool, text: str) -> str:
        return f"{'yes' if holds else '**no**'}: {text}"

    def keeps(plant: str) -> str:
        runs = {suite: row[reference] for suite, row in study.counts[plant].items()}
        ends = [(suite, n, reason) for suite, row in runs.items() for reason, n in row.ends.items()]
        for name, table in (("load increase", study.increase), ("load decrease", study.decrease)):
            if table[plant][reference].failed:
                ends.append((name, 1, TERMINATION_REASONS[table[plant][reference].status]))
        n_failed = sum(n for _, n, _ in ends)
        n_runs = sum(row.n_scenarios for row in runs.values()) + 2
        where = f" ({', '.join(f'{name}: {n} {reason}' for name, n, reason in ends)})" if ends else ""
        return verdict(n_failed == 0, f"{n_failed}/{n_runs}{where}")

    def fail(plant: str) -> str:
        runs = [study.increase[plant][s] for s in others]
        ends = [run.end_s for run in runs]
        return verdict(all(run.failed for run in runs) and ends == sorted(set(ends)), _ends(runs))

    def nadir(plant: str) -> str:
        runs, until = _together(study.increase[plant], _SECOND_STEP_S)
        below = [1e3 * (runs[s].nadir_hz - runs[reference].nadir_hz) for s in others]
        return verdict(min(below) > 0.0 and max(below) < 1e3 * _SLIGHTLY_HZ, f"{_range(below, 0)}{until}")

    def rocof(plant: str) -> str:
        runs, _ = _together(study.increase[plant], _SECOND_STEP_S)
        own, least = runs[reference].rocof_hz_s, min(runs[s].rocof_hz_s for s in others)
        return verdict(own < least, f"{own:.3f} to {least:.3f}")

    def rise(plant: str) -> str:
        runs, until = _together(study.decrease[plant], study.scenario.duration_s)
        speeds = {s: runs[s].rotor_pu.max(axis=0) - runs[s].rotor_pu[0] for s in (reference, *others[1:])}
        own = speeds.pop(reference)
        least = np.min(list(speeds.values()), axis=0)
        return verdict(bool((own < least).all()), f"{_slashed(own, 2)} to {_slashed(least, 2)}{until}")

    rows = [
        ("coordinated never fails", keeps),
        ("MPPT, 5, 10 % fail in turn [s]", fail),
        ("its nadir is lower, by < 10 mHz", nadir),
        ("its RoCoF is smaller [Hz/s]", rocof),
        ("its rotors rise less, load decrease [p.u.]", rise),
    ]
    cells = [(name, *(check(plant) for plant in CHECKED)) for name, check in rows]
    starts = {s: float(study.increase[NREL][s].power_pu[0, 0]) for s in COMPARED}
    held_back = "/".join(f"{100.0 * (1.0 - starts[s] / starts['mppt']):.0f}" for s in (reference, *others[1:]))
    held_at = f"{study.increase[NREL][reference].rotor_pu[0, 0]:.2f} p.u."
    table = markdown_table(("the paper concludes", *CHECKED), cells)
    least_winds = ", ".join(f"{_slashed(row.values(), 1)} m/s ({name})" for name, row in study.least_start_m_s.items())
    return (
        f"{table}\n\nWith the NREL rotor at 11.4 m/s, coordinated, 5 % and 10 % hold back {held_back} % of MPPT's "
        f"power: they need a rotor speed above {held_at}, and the pitch protection keeps it there, where their "
        "set-point k ω_m³ is lower.\n\n"
        f"Rotors start below the under-speed trip in less wind than {least_winds} under coordinated/MPPT/5 %/10 %."
    )


def _cases(study: PhysicsStudy) -> str:
    header = (
        "strategy",
        "plant",
        "fails at [s]",
        "nadir [Hz]",
        "RoCoF [Hz/s]",
        "least ω_m",
        "least p",
        "largest I",
        "largest E",
        "largest q",
    )
    rows = []
    for strategy in COMPARED:
        for plant, name in ((PAPER, "paper"), (HONEST, "all")):
            run = study.increase[plant][strategy]
            rows.append(
                (
                    strategy,
                    name,
                    _ends([run]),
                    f"{run.nadir_hz:.3f}",
                    f"{run.rocof_hz_s:.3f}",
                    *(f"{value:.2f}" for value in (run.rotor_pu.min(), run.power_pu.min())),
                    *(f"{values.max():.2f}" for values in (run.current_pu, run.internal_pu, np.abs(run.reactive_pu))),
                )
            )
    return markdown_table(header, rows, right=range(2, len(header)))


def _parts(study: PhysicsStudy) -> str:
    header = (
        "plant",
        "nadir [Hz]",
        "RoCoF [Hz/s]",
        "fail at [s]",
        *SUITES_OF_ALL,
        "nadirs [mHz]",
        "least λ",
    )
    rows = []
    for plant, suites in study.counts.items():
        run = study.increase[plant][REFERENCE_STRATEGY]
        own = [suites[suite][REFERENCE_STRATEGY] for suite in SUITES_OF_ALL]
        paper = [study.counts[PAPER][suite][REFERENCE_STRATEGY] for suite in SUITES_OF_ALL]
        shifts = [
            1e3 * float(np.nanmedian(row.nadirs_hz - base.nadirs_hz)) for row, base in zip(own, paper, strict=True)
        ]
        rows.append(
            (
                plant,
                f"{run.nadir_hz:.3f}",
                f"{run.rocof_hz_s:.3f}",
                _ends([study.increase[plant][s] for s in COMPARED[1:]]),
                *("/".join(_failures(suites[suite][s]) for s in COMPARED) for suite in SUITES_OF_ALL),
                "/".join(f"{shift:+.0f}" if abs(shift) >= 0.5 else "0" for shift in shifts),
                "/".join(f"{row.least_ratio:.1f}" for row in own),
            )
        )

    def lowest(water: bool) -> float:
        return min(
            row.lowest_hz
            for plant, suites in study.counts.items()
            if ("hydro" in plant) == water
            for by_strategy in suites.values()
            for row in by_strategy.values()
        )

    return (
        f"{markdown_table(header, rows, right=range(1, len(header)))}\n\n"
        f"Lowest frequency of a suite's run: {lowest(False):.2f} Hz with steam, {lowest(True):.2f} Hz with water."
    )


def _failures(row: SuiteCount) -> str:
    return f"{row.failures}" if row.refused == 0 else f"{row.failures} ({row.refused} refused)"


def _suites(study: PhysicsStudy) -> str:
    suites = list(study.counts[PAPER])
    rows = [
        (suite, *("/".join(str(study.counts[plant][suite][s].failures) for plant in THREE_FORMS) for s in COMPARED))
        for suite in suites
    ]
    table = markdown_table(("suite", *COMPARED), rows, right=range(1, 5))
    extremes = [
        [row for by_suite in study.counts[plant].values() for row in by_suite.values()] for plant in THREE_FORMS
    ]
    paper, honest = extremes[0], extremes[-1]
    return (
        f"Failures out of {paper[0].n_scenarios}, {' / '.join(THREE_FORMS)}:\n\n{table}\n\n"
        f"In these runs, the paper's / all together: p < 0 in {_total(paper)}/{_total(honest)} of "
        f"{sum(row.n_scenarios for row in paper)}, largest current {max(row.peak_current_pu for row in paper):.2f}/"
        f"{max(row.peak_current_pu for row in honest):.2f}, smallest ω_m "
        f"{min(row.least_rotor_pu for row in paper):.2f}/{min(row.least_rotor_pu for row in honest):.2f}, E "
        f"{_spread(paper)}/{_spread(honest)}."
    )


def _total(rows: Iterable[SuiteCount]) -> int:
    return sum(row.motoring for row in rows)


def _spread(rows: Sequence[SuiteCount]) -> str:
    return f"{min(row.internal_pu[0] for row in rows):.2f}…{max(row.internal_pu[1] for row in rows):.2f}"


def _rotor_energy(study: PhysicsStudy) -> str:
    return markdown_table(
        (
            "wind [m/s]",
            "2H_m Δω_m [p.u. s]",
            "H_m Δ(ω_m²) [p.u. s]",
            "too much",
        ),
        [
            (
                f"{row.wind_m_s:g}",
                f"{row.credited_s:.3f}",
                f"{row.stored_s:.3f}",
                f"{100 * (row.credited_s / row.stored_s - 1):+.0f} %",
            )
            for row in study.energy
        ],
        right=range(4),
    )


def _margins(study: PhysicsStudy) -> str:
    rows = [
        (
            "the paper's",
            "–",
            "–",
            "–",
            f"{PAPER_SYNCHRONISING_COEFFICIENT:g}",
            "–",
            _slashed(study.paper_margins_deg, 0),
        )
    ]
    forms: dict[str, VoltageLimit] = {
        "constant E": study.held,
        f"constant E ≤ {VOLTAGE_LIMIT_PU:g}": study.limited,
        "voltage control": study.regulated,
        "and rotor energy": study.consistent,
        "and NREL 5 MW": study.nrel,
    }
    rows += [
        (
            name,
            f"{form.bus_voltage_pu:.3f}",
            _slashed(form.voltage_pu, 2),
            _slashed(form.reactive_pu, 2),
            _slashed(form.synchronising_coefficient, 2),
            _slashed(form.slow_coefficient, 2)
            if (form.slow_coefficient != form.synchronising_coefficient).any()
            else "–",
            _slashed(form.phase_margin_deg, 0),
        )
        for name, form in forms.items()
    ]
    header = ("groups", "V at bus 2", "E", "q", "K_p", "slow K_p", "margin [°]")

    def frequencies(turbine: str) -> str:
        return "/".join("none" if f is None else f"{f:.2f}" for f in study.critical_hz[turbine].values())

    return (
        f"{markdown_table(header, rows, right=range(1, 7))}\n\nBelow these frequencies MPPT/5 %/10 % have no "
        f"equilibrium at {CRITICAL_WIND:g} m/s: {frequencies('paper')} Hz with the paper's curve, "
        f"{frequencies('NREL 5 MW')} Hz with the NREL rotor."
    )


def _loads(runs: Sequence[LoadRun]) -> str:
    rows = []
    for model in LOAD_MODELS:
        own = {run.strategy: run for run in runs if run.model == model}
        reference = own.pop(REFERENCE_STRATEGY)
        rows.append(
            (
                model,
                f"{reference.nadir_hz:.3f}",
                f"{reference.final_hz:.3f}",
                f"{min(run.least_voltage_pu for run in (reference, *own.values())):.3f}",
                _ends(list(own.values())),
            )
        )
    header = ("loads", "nadir [Hz]", "settles at [Hz]", "least V [p.u.]", "fail at [s]")
    return markdown_table(header, rows, right=range(1, 5))


def _together(runs: Mapping[str, PlantRun], limit_s: float) -> tuple[dict[str, PlantRun], str]:
    """Return runs up to a time or the first one's end, whatever comes first, and words for that end."""
    end_s = min(limit_s, *(run.end_s for run in runs.values()))
    cut = {name: run.until(end_s) for name, run in runs.items()}
    return cut, f" until {end_s:.1f} s" if end_s < limit_s else ""


def _ends(runs: Sequence[PlantRun | LoadRun]) -> str:
    """Return when runs fail, and why unless they all stall."""
    times = "/".join(f"{run.end_s:.1f}" if run.status else "none" for run in runs)
    reasons = [TERMINATION_REASONS[run.status] for run in runs if run.status]
    if all(run.status in (Status.RUNNING, Status.STALL) for run in runs):
        return times
    return f"{times} ({reasons[0] if len(set(reasons)) == 1 else '/'.join(reasons)})"


def _slashed(values: Iterable[float], digits: int) -> str:
    return "/".join(f"{value:.{digits}f}" for value in values)


def _range(values: Sequence[float], digits: int) -> str:
    return f"{min(values):.{digits}f}…{max(values):.{digits}f}"
