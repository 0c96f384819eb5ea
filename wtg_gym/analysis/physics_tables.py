"""The study of the paper's omissions as Markdown, for docs/physics.md."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from wtg_gym.analysis.load_models import LOAD_MODELS, LoadRun
from wtg_gym.analysis.loops import PAPER_SYNCHRONISING_COEFFICIENT
from wtg_gym.analysis.physics_study import COMPARED, CRITICAL_WIND, SUITES_OF_ALL, THREE_FORMS, PhysicsStudy, SuiteCount
from wtg_gym.analysis.plant_forms import HONEST, HYDRO, NREL, PAPER, PlantRun
from wtg_gym.analysis.voltage_limits import VOLTAGE_LIMIT_PU, VoltageLimit
from wtg_gym.files import markdown_table
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY

#: Largest difference of nadirs that "slightly lower" covers [Hz].
_SLIGHTLY_HZ = 0.01
#: The second step of the paper's load increase; its claims on nadir and RoCoF are about the first [s].
_SECOND_STEP_S = 30.0
_CHECKED = (PAPER, HONEST, NREL, HYDRO)


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
    """Return the paper's conclusions against four plants."""
    reference, others = COMPARED[0], COMPARED[1:]

    def verdict(holds: bool, text: str) -> str:
        return f"{'yes' if holds else '**no**'}: {text}"

    def keeps(plant: str) -> str:
        rows = study.counts[plant].values()
        failures = sum(row[reference].failures for row in rows)
        in_cases = sum(table[plant][reference].failed for table in (study.increase, study.decrease))
        n = sum(row[reference].n_scenarios for row in rows) + 2
        return verdict(failures + in_cases == 0, f"{failures + in_cases}/{n}")

    def stalls(plant: str) -> str:
        runs = [study.increase[plant][s] for s in others]
        ends = [run.end_s for run in runs]
        return verdict(all(run.failed for run in runs) and ends == sorted(set(ends)), _ends(runs))

    def first_step(plant: str) -> dict[str, PlantRun]:
        return {s: study.increase[plant][s].until(_SECOND_STEP_S) for s in COMPARED}

    def nadir(plant: str) -> str:
        runs = first_step(plant)
        below = [1e3 * (runs[s].nadir_hz - runs[reference].nadir_hz) for s in others]
        cut = ", others stalled" if all(runs[s].end_s < _SECOND_STEP_S for s in others) else ""
        return verdict(min(below) > 0.0 and max(below) < 1e3 * _SLIGHTLY_HZ, f"{_range(below, 0)}{cut}")

    def rocof(plant: str) -> str:
        runs = first_step(plant)
        own, least = runs[reference].rocof_hz_s, min(runs[s].rocof_hz_s for s in others)
        return verdict(own < least, f"{own:.3f} to {least:.3f}")

    def rise(plant: str) -> str:
        runs = study.decrease[plant]
        speeds = {s: runs[s].rotor_pu.max(axis=0) - runs[s].rotor_pu[0] for s in (reference, *others[1:])}
        own = speeds.pop(reference)
        least = np.min(list(speeds.values()), axis=0)
        return verdict(bool((own < least).all()), f"{_pair(own, 2)} to {_pair(least, 2)}")

    rows = [
        ("coordinated never fails", keeps),
        ("MPPT, 5, 10 % stall in turn [s]", stalls),
        ("its nadir is lower, by < 10 mHz", nadir),
        ("its RoCoF is smaller [Hz/s]", rocof),
        ("its rotors rise less, load decrease [p.u.]", rise),
    ]
    cells = [(name, *(check(plant) for plant in _CHECKED)) for name, check in rows]
    starts = {s: float(study.increase[NREL][s].power_pu[0, 0]) for s in COMPARED}
    held_back = "/".join(f"{100.0 * (1.0 - starts[s] / starts['mppt']):.0f}" for s in (reference, *others[1:]))
    table = markdown_table(("the paper concludes", *_CHECKED), cells)
    return (
        f"{table}\n\nWith the NREL rotor the pitch protection acts at 11.4 m/s: coordinated, 5 % and 10 % hold back "
        f"{held_back} % of MPPT's power there."
    )


def _cases(study: PhysicsStudy) -> str:
    header = (
        "strategy",
        "plant",
        "stall [s]",
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
        "stalls [s]",
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
        ("the paper's", "–", "–", "–", f"{PAPER_SYNCHRONISING_COEFFICIENT:g}", "–", _pair(study.paper_margins_deg, 0))
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
            _pair(form.voltage_pu, 2),
            _pair(form.reactive_pu, 2),
            _pair(form.synchronising_coefficient, 2),
            _pair(form.slow_coefficient, 2) if (form.slow_coefficient != form.synchronising_coefficient).any() else "–",
            _pair(form.phase_margin_deg, 0),
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
    header = ("loads", "nadir [Hz]", "settles at [Hz]", "least V [p.u.]", "stalls [s]")
    return markdown_table(header, rows, right=range(1, 5))


def _ends(runs: Sequence[PlantRun | LoadRun]) -> str:
    return "/".join(f"{run.end_s:.1f}" if run.status else "none" for run in runs)


def _pair(values: Floats, digits: int) -> str:
    return "/".join(f"{value:.{digits}f}" for value in values)


def _range(values: Sequence[float], digits: int) -> str:
    return f"{min(values):.{digits}f}…{max(values):.{digits}f}"
