"""`wtg-gym reproduce`: the paper's figures and claims, and what lies beyond the paper."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from wtg_gym.cli import output
from wtg_gym.cli.parser import Commands, add_command, add_output_options
from wtg_gym.files import to_json, write_atomically
from wtg_gym.physics.modes import Mode, Side, linearise, modes
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.progress import Progress
from wtg_gym.reproduce import case_studies
from wtg_gym.reproduce.claim import Claim
from wtg_gym.reproduce.infinite_bus import Agreement, agreements, system_margins
from wtg_gym.reproduce.loops import SingleMachine, ideal_source_loop, single_machine
from wtg_gym.reproduce.paper_claims import paper_claims
from wtg_gym.reproduce.tables import claims_table, margins_table, modes_table
from wtg_gym.scenarios import get_suite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SECTIONS = ("claims", "figures", "studies", "small-signal", "modes")
_STUDIES = ("margins", "slopes", "equilibria", "damping", "machines")

_DESCRIPTION = f"""\
Runs the paper's analysis and case studies on the simulator and writes, within two minutes,

  claims.json   every claim of the paper with its tolerance, measurement and verdict; and the numbers of the studies and
                of the comparison on an infinite bus
  figures/*     the paper's figures, and studies beyond it: margins over wind and on both slopes of g(ω), lost
                equilibria, τ, machine models, the modes of the system

With --page sections of a Markdown file are renewed, each between <!-- NAME:start --> and <!-- NAME:end -->, with
links to the pictures in the output folder. Sections: {", ".join(_SECTIONS)}"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym reproduce`."""
    parser = add_command(
        commands,
        "reproduce",
        run,
        description=_DESCRIPTION,
        examples="  wtg-gym reproduce\n  wtg-gym reproduce --output figures-for-print --formats svg pdf\n"
        "  wtg-gym reproduce --output docs/validation --formats png --page docs/validation.md",
        after_interrupt="what has been written so far is complete; run the same command again",
    )
    add_output_options(
        parser,
        output="where to write (default: reproduction)",
        page="Markdown file whose sections are renewed",
        json="print claims.json on stdout instead of the table",
        default="reproduction",
    )


@dataclass(frozen=True)
class _Evidence:
    """All measurements; nothing is drawn before they are complete."""

    cases: case_studies.CaseStudies
    claims: tuple[Claim, ...]
    margins: case_studies.MarginStudy
    slopes: case_studies.MarginStudy
    equilibria: case_studies.EquilibriumStudy
    damping: case_studies.DampingStudy
    machines: case_studies.MachineModelStudy
    agreement: tuple[Agreement, ...]
    system_margins: tuple[SingleMachine, ...]
    modes: Mapping[str, tuple[Mode, ...]]


class _Picture(NamedTuple):
    """A figure of the page; `text` stands for the picture where it cannot be seen, `caption` below it."""

    name: str  # of the file, without suffix
    text: str
    caption: str
    draw: Callable[[], Figure]


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym reproduce`."""
    output.require_extra("matplotlib", "wtg-gym reproduce")
    from wtg_gym.plotting import save_figure

    folder = output.check_output_folder("--output", arguments.output)
    page = output.check_page("--page", arguments.page, *_SECTIONS)
    with Progress("steps") as progress:
        evidence = _measure(progress)
        of_paper, of_studies = _paper_pictures(evidence), _study_pictures(evidence)
        pictures = [*of_paper, *of_studies]
        for done, picture in enumerate(pictures):
            progress.update(f"drawing {picture.name}", done, len(pictures))
            save_figure(picture.draw(), folder / "figures" / picture.name, arguments.formats)
    data = _as_json(evidence)
    write_atomically(folder / "claims.json", to_json(data))
    output.note(f"wrote {folder / 'claims.json'} and {len(pictures)} figures in {folder / 'figures'}")
    if page is not None:
        suffix = "png" if "png" in arguments.formats else arguments.formats[0]
        where = Path(os.path.relpath((folder / "figures").resolve(), page.resolve().parent)).as_posix()
        sections = {
            "claims": claims_table(evidence.claims),
            "small-signal": margins_table(evidence.agreement, evidence.system_margins),
            "modes": modes_table(evidence.modes[REFERENCE_STRATEGY]),
        }
        for section, gallery in (("figures", of_paper), ("studies", of_studies)):
            texts = [f"![{p.text}]({where}/{p.name}.{suffix})\n\n{p.caption}" for p in gallery]
            sections[section] = "\n\n".join(texts)
        output.update_page(page, sections)
    if arguments.json:
        output.print_json(data)
    else:
        rows = [
            (c.key, c.expected, c.measured, c.fitted, "holds" if c.holds else "DOES NOT HOLD") for c in evidence.claims
        ]
        output.print_table(("claim", "expected", "measured", "fitted", "verdict"), rows, left=(0, 1, 2, 3, 4))
    return 0


def _measure(progress: Progress) -> _Evidence:
    cases = case_studies.run_case_studies(progress.update)
    steps: dict[str, Callable[[], Any]] = {
        "claims": lambda: paper_claims(cases),
        "margins over wind": case_studies.study_margins,
        "both slopes": case_studies.study_slopes,
        "lost equilibria": case_studies.study_equilibria,
        "damping time constant": case_studies.study_damping,
        "machine models": case_studies.study_machine_models,
        "infinite bus": lambda: tuple(agreements()),
        "margins in the system": lambda: tuple(system_margins()),
        "modes": _system_modes,
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


def _paper_pictures(evidence: _Evidence) -> list[_Picture]:
    from wtg_gym.reproduce import paper_figures
    from wtg_gym.reproduce.characteristics import plot_characteristic

    cases = evidence.cases
    characteristics = [
        _Picture(
            f"characteristic-{name}",
            "Power-frequency characteristic",
            f"Characteristic: {words}.",
            lambda name=name: plot_characteristic(STRATEGIES[name]),  # type: ignore[misc]
        )
        for name, words in (
            ("mppt", "maximum power point tracking"),
            ("deloaded-5", "5 % of deloading"),
            ("deloaded-10", "10 % of deloading"),
            (REFERENCE_STRATEGY, "the coordinated strategy"),
        )
    ]
    return [
        _Picture(
            "power-coefficient",
            "Power coefficient",
            "Power coefficient with the deloading points: λ_opt, λ_n (5 %) and λ_pr (10 %).",
            paper_figures.plot_power_coefficient,
        ),
        *characteristics,
        _Picture(
            "bode-comparison",
            "Bode plots",
            "Open loops at 11.4 m/s, K_p = 1.45: an ideal DC source, the fixed strategies, and the linear law without "
            "transient damping.",
            lambda: paper_figures.plot_bode(_bode_loops()),
        ),
        _Picture(
            "bode-proposed",
            "Bode plots",
            "Open loops of the coordinated strategy: the linear law with transient damping (τ = 0.8 s) and without, "
            "and both slopes of the piecewise law with it.",
            lambda: paper_figures.plot_bode(_proposed_loops()),
        ),
        _Picture(
            "load-increase",
            "Load increase",
            "Load increase: +75 MW at bus 2 at 5 s and at bus 3 at 30 s; a cross marks a stall.",
            lambda: paper_figures.plot_case_study(cases.increase, cases.increase_runs),
        ),
        _Picture(
            "load-decrease",
            "Load decrease",
            "Load decrease: the loads of bus 4 (47.8 MW) at 5 s and bus 9 (29.5 MW) at 30 s are lost.",
            lambda: paper_figures.plot_case_study(cases.decrease, cases.decrease_runs),
        ),
    ]


def _bode_loops() -> dict[str, SingleMachine]:
    laws = [*(STRATEGIES[name] for name in ("mppt", "deloaded-5", "deloaded-10")), case_studies.linear_undamped()]
    return {"ideal-source": ideal_source_loop(), **{law.name: single_machine(law, 11.4) for law in laws}}


def _proposed_loops() -> dict[str, SingleMachine]:
    linear, piecewise = STRATEGIES["coordinated-linear"], STRATEGIES[REFERENCE_STRATEGY]
    loops = {law.name: single_machine(law, 11.4) for law in (linear, case_studies.linear_undamped())}
    sides: tuple[Side, ...] = ("under", "over")
    return loops | {f"{piecewise.name}, {side}-frequency": single_machine(piecewise, 11.4, side=side) for side in sides}


def _study_pictures(evidence: _Evidence) -> list[_Picture]:
    from wtg_gym.reproduce import eigenvalue_plane, study_figures

    draw: dict[str, tuple[str, Callable[..., Figure]]] = {
        "margins": ("Phase margins over wind", study_figures.plot_margins),
        "slopes": ("Phase margins on both slopes", study_figures.plot_margins),
        "equilibria": ("Lost equilibria", study_figures.plot_equilibria),
        "damping": ("Effect of τ", study_figures.plot_damping),
        "machines": ("Machine models", study_figures.plot_machine_models),
    }
    pictures = []
    for name, (text, plot) in draw.items():
        study = getattr(evidence, name)
        pictures.append(_Picture(name, text, study.sentence, functools.partial(plot, study)))
    eigenvalues = functools.partial(eigenvalue_plane.plot_modes, evidence.modes)
    return [*pictures, _Picture("modes", "Eigenvalues", _modes_sentence(evidence), eigenvalues)]


def _modes_sentence(evidence: _Evidence) -> str:
    def least(name: str) -> Mode:
        return min((m for m in evidence.modes[name] if m.eigenvalue.imag > 0.0), key=lambda m: m.damping_ratio)

    with_damping, without = least(REFERENCE_STRATEGY), least("coordinated-undamped")
    return (
        "Eigenvalues of the whole 14-bus system at 11.4 and 8 m/s. The least damped oscillation of the reference is "
        f"one of the machines, with ζ = {with_damping.damping_ratio:.2f} at {with_damping.frequency_hz:.2f} Hz. "
        f"Without transient damping the least damped one has ζ = {without.damping_ratio:.2f} at "
        f"{without.frequency_hz:.2f} Hz."
    )


def _as_json(evidence: _Evidence) -> Any:
    studies: dict[str, Any] = {name: vars(getattr(evidence, name)) for name in _STUDIES}
    studies["machines"] = {"sentence": evidence.machines.sentence}
    studies["modes"] = {"sentence": _modes_sentence(evidence)}
    return output.plain_json(
        {
            "claims": [dataclasses.asdict(claim) for claim in evidence.claims],
            "studies": studies,
            "agreement": [dataclasses.asdict(row) for row in evidence.agreement],
        }
    )
