"""`wtg-gym reproduce`: the paper's figures and claims, and what lies beyond the paper."""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wtg_gym.analysis.case_studies import (
    CaseStudies,
    DampingStudy,
    EquilibriumStudy,
    MachineModelStudy,
    MarginStudy,
    linear_undamped,
    run_case_studies,
    study_damping,
    study_equilibria,
    study_machine_models,
    study_margins,
    study_slopes,
)
from wtg_gym.analysis.eigenvalues import Mode, linearise, modes
from wtg_gym.analysis.infinite_bus import Agreement, agreements, system_margins
from wtg_gym.analysis.loops import SingleMachine, ideal_source_loop, single_machine
from wtg_gym.analysis.omissions import Omissions, study_omissions
from wtg_gym.analysis.paper_claims import Claim, paper_claims
from wtg_gym.analysis.tables import (
    agreement_table,
    claims_table,
    modes_table,
    omissions_sections,
    system_margins_table,
)
from wtg_gym.cli.output import (
    FIGURE_FORMATS,
    Progress,
    check_output_folder,
    check_page,
    note,
    plain_json,
    print_json,
    print_table,
    require_extra,
    update_page,
)
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.files import to_json, write_atomically
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.scenarios import get_suite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_OMISSIONS = ("rotor-energy", "voltages", "limits")
_SECTIONS = ("claims", "figures", "studies", *_OMISSIONS, "agreement", "system-margins", "modes")

_DESCRIPTION = f"""\
Runs the paper's analysis and case studies on the simulator and writes, within two or three minutes,

  claims.md, claims.json   every claim of the paper: what it says, what came out, tolerance, verdict
  figures/*                every figure of the paper that a simulator can give, and what lies beyond the paper:
                           margins over wind and on both slopes of g(ω), where the deloaded strategies lose their
                           equilibrium, what τ trades, classical against GENROU machines, the modes of the system

claims.json also holds the numbers on what the paper's model leaves out: rotor energy, voltages, limits.

With --page sections of a Markdown file are renewed, each between <!-- NAME:start --> and <!-- NAME:end -->; its
pictures are those of the output folder. Sections: {", ".join(_SECTIONS)}"""

_EXAMPLES = """\
  wtg-gym reproduce
  wtg-gym reproduce --output figures-for-print --formats svg pdf
  wtg-gym reproduce --output docs/validation --formats png --page docs/validation.md"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym reproduce`."""
    parser = add_command(
        commands,
        "reproduce",
        run,
        summary="the paper's figures and claims, measured; and what lies beyond the paper",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
        after_interrupt="what has been written so far is complete; run the same command again",
    )
    parser.add_argument(
        "--output", default="reproduction", metavar="FOLDER", help="where to write (default: reproduction)"
    )
    parser.add_argument(
        "--formats", nargs="+", choices=FIGURE_FORMATS, default=["svg", "png"], help="of the figures (default: svg png)"
    )
    parser.add_argument("--page", metavar="FILE", help="Markdown file whose sections are renewed")
    parser.add_argument("--json", action="store_true", help="print claims.json on stdout instead of the table")


@dataclass(frozen=True)
class _Picture:
    """A figure to be: file name, caption, and how it is drawn."""

    name: str
    caption: str
    draw: Callable[[], Figure]


@dataclass(frozen=True)
class _Evidence:
    """All that is measured before anything is drawn."""

    cases: CaseStudies
    claims: tuple[Claim, ...]
    margins: MarginStudy
    slopes: MarginStudy
    equilibria: EquilibriumStudy
    damping: DampingStudy
    machines: MachineModelStudy
    agreement: tuple[Agreement, ...]
    system_margins: tuple[SingleMachine, ...]
    modes: Mapping[str, tuple[Mode, ...]]
    omissions: Omissions


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym reproduce`."""
    require_extra("matplotlib", "wtg-gym reproduce")
    from wtg_gym.plotting import save_figure

    folder = check_output_folder("--output", arguments.output)
    page = check_page("--page", arguments.page, *_SECTIONS)
    with Progress("steps") as progress:
        evidence = _measure(progress)
        pictures = [*_paper_pictures(evidence), *_study_pictures(evidence)]
        for done, picture in enumerate(pictures):
            progress.update(f"drawing {picture.name}", done, len(pictures))
            save_figure(picture.draw(), folder / "figures" / picture.name, arguments.formats)
    data = _as_json(evidence)
    write_atomically(folder / "claims.json", to_json(data))
    write_atomically(folder / "claims.md", claims_table(evidence.claims) + "\n")
    note(f"wrote {folder / 'claims.md'}, claims.json and {len(pictures)} figures in {folder / 'figures'}")
    if page is not None:
        update_page(page, _sections(evidence, folder, page, arguments.formats))
    if arguments.json:
        print_json(data)
    else:
        rows = [
            (c.key, c.expected, c.measured, c.fitted, "holds" if c.holds else "DOES NOT HOLD") for c in evidence.claims
        ]
        print_table(("claim", "expected", "measured", "fitted", "verdict"), rows, left=(0, 1, 2, 3, 4))
    return 0


def _measure(progress: Progress) -> _Evidence:
    cases = run_case_studies(progress.update)
    steps: dict[str, Callable[[], Any]] = {
        "claims": lambda: paper_claims(cases),
        "margins over wind": study_margins,
        "both slopes": study_slopes,
        "lost equilibria": study_equilibria,
        "damping time constant": study_damping,
        "machine models": study_machine_models,
        "infinite bus": lambda: tuple(agreements()),
        "margins in the system": lambda: tuple(system_margins()),
        "modes": _system_modes,
        "omissions": lambda: study_omissions(progress.update),
    }
    found = []
    for done, (name, measure) in enumerate(steps.items()):
        progress.update(name, done, len(steps))
        found.append(measure())
    return _Evidence(cases, *found)


def _system_modes() -> dict[str, tuple[Mode, ...]]:
    scenario = get_suite("paper").scenario(0)
    return {
        name: modes(linearise(scenario, STRATEGIES[name]).renamed(PlantSettings()))
        for name in (REFERENCE_STRATEGY, "coordinated-undamped", "deloaded-5")
    }


def _paper_pictures(evidence: _Evidence) -> Iterator[_Picture]:
    from wtg_gym import plotting

    yield _Picture(
        "power-coefficient",
        "Power coefficient with the deloading points: λ_opt, λ_n (5 %) and λ_pr (10 %).",
        plotting.plot_power_coefficient,
    )
    for name, words in (
        ("mppt", "maximum power point tracking"),
        ("deloaded-5", "a low deloading level (5 %)"),
        ("deloaded-10", "a high deloading level (10 %)"),
        (REFERENCE_STRATEGY, "the coordinated strategy"),
    ):
        yield _Picture(
            f"characteristic-{name}",
            f"Power-frequency characteristic with {words} at 11.4 and 8 m/s: A at the set-point, B at ω_min or where "
            "the equilibrium is lost, C at ω_max, M at the maximum power point; dashed: unstable.",
            lambda name=name: plotting.plot_characteristic(STRATEGIES[name]),  # type: ignore[misc]
        )
    yield _Picture(
        "bode-comparison",
        "Open-loop Bode plots at 11.4 m/s, K_p = 1.45, with phase margins: ideal DC source, fixed strategies, and the "
        "linear law without transient damping.",
        lambda: plotting.plot_bode(_bode_loops()),
    )
    yield _Picture(
        "bode-proposed",
        "Open-loop Bode plots of the proposed strategy: the linear law with transient damping (τ = 0.8 s) and without, "
        "and both slopes of the piecewise law with it.",
        lambda: plotting.plot_bode(_proposed_loops()),
    )
    cases = evidence.cases
    yield _Picture(
        "load-increase",
        "Load increase: +75 MW at bus 2 at 5 s and at bus 3 at 30 s; a cross marks a stall.",
        lambda: plotting.plot_case_study(cases.increase, cases.increase_runs),
    )
    yield _Picture(
        "load-decrease",
        "Load decrease: the loads of bus 4 (47.8 MW) at 5 s and bus 9 (29.5 MW) at 30 s are lost.",
        lambda: plotting.plot_case_study(cases.decrease, cases.decrease_runs),
    )


def _proposed_loops() -> dict[str, SingleMachine]:
    piecewise = STRATEGIES[REFERENCE_STRATEGY]
    return {
        "coordinated-linear": single_machine(STRATEGIES["coordinated-linear"], 11.4),
        "coordinated-linear-undamped": single_machine(linear_undamped(), 11.4),
        f"{REFERENCE_STRATEGY}, under-frequency": single_machine(piecewise, 11.4, side="under"),
        f"{REFERENCE_STRATEGY}, over-frequency": single_machine(piecewise, 11.4, side="over"),
    }


def _bode_loops() -> dict[str, SingleMachine]:
    return {
        "ideal-source": ideal_source_loop(),
        "mppt": single_machine(STRATEGIES["mppt"], 11.4),
        "deloaded-5": single_machine(STRATEGIES["deloaded-5"], 11.4),
        "deloaded-10": single_machine(STRATEGIES["deloaded-10"], 11.4),
        "coordinated-linear-undamped": single_machine(linear_undamped(), 11.4),
    }


def _study_pictures(evidence: _Evidence) -> Iterator[_Picture]:
    from wtg_gym import plotting

    yield _Picture("margins", evidence.margins.sentence, lambda: plotting.plot_margins(evidence.margins))
    yield _Picture("slopes", evidence.slopes.sentence, lambda: plotting.plot_slopes(evidence.slopes))
    yield _Picture("equilibria", evidence.equilibria.sentence, lambda: plotting.plot_equilibria(evidence.equilibria))
    yield _Picture("damping", evidence.damping.sentence, lambda: plotting.plot_damping(evidence.damping))
    yield _Picture("machines", evidence.machines.sentence, lambda: plotting.plot_machine_models(evidence.machines))
    yield _Picture("modes", _modes_sentence(evidence), lambda: plotting.plot_modes(evidence.modes))


def _modes_sentence(evidence: _Evidence) -> str:
    def least(name: str) -> Mode:
        return min((m for m in evidence.modes[name] if m.eigenvalue.imag > 0.0), key=lambda m: m.damping_ratio)

    with_damping, without = least(REFERENCE_STRATEGY), least("coordinated-undamped")
    return (
        "Eigenvalues of the whole 14-bus system at 11.4 and 8 m/s: the least damped oscillation of the reference has "
        f"ζ = {with_damping.damping_ratio:.2f} at {with_damping.frequency_hz:.2f} Hz and belongs to the machines, "
        f"without transient damping ζ = {without.damping_ratio:.2f} at {without.frequency_hz:.2f} Hz."
    )


def _sections(evidence: _Evidence, folder: Path, page: Path, formats: list[str]) -> dict[str, str]:
    suffix = "png" if "png" in formats else formats[0]
    where = Path(os.path.relpath((folder / "figures").resolve(), page.resolve().parent))

    def gallery(pictures: Iterator[_Picture]) -> str:
        return "\n\n".join(
            f"![{picture.caption}]({(where / picture.name).as_posix()}.{suffix})\n\n{picture.caption}"
            for picture in pictures
        )

    return {
        "claims": claims_table(evidence.claims),
        "figures": gallery(_paper_pictures(evidence)),
        "studies": gallery(_study_pictures(evidence)),
        **dict(zip(_OMISSIONS, omissions_sections(evidence.omissions), strict=True)),
        "agreement": agreement_table(evidence.agreement),
        "system-margins": system_margins_table(evidence.system_margins),
        "modes": modes_table(evidence.modes[REFERENCE_STRATEGY]),
    }


def _as_json(evidence: _Evidence) -> dict[str, Any]:
    return {
        "claims": [dataclasses.asdict(claim) for claim in evidence.claims],
        "studies": {
            "margins": _study(evidence.margins),
            "slopes": _study(evidence.slopes),
            "equilibria": _study(evidence.equilibria),
            "damping": _study(evidence.damping),
            "machines": {"sentence": evidence.machines.sentence},
            "modes": {"sentence": _modes_sentence(evidence)},
        },
        "omissions": plain_json(dataclasses.asdict(evidence.omissions)),
        "agreement": [plain_json(dataclasses.asdict(row)) for row in evidence.agreement],
    }


def _study(study: Any) -> Any:
    return plain_json({field.name: getattr(study, field.name) for field in dataclasses.fields(study)})
