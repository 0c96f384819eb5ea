"""`wtg-gym reproduce`: the paper's figures and claims."""

from __future__ import annotations

import argparse
import dataclasses
import os
from pathlib import Path

from wtg_gym.cli import output
from wtg_gym.cli.parser import Commands, add_command, add_output_options
from wtg_gym.files import to_json, write_atomically
from wtg_gym.progress import Progress
from wtg_gym.reproduce.case_claims import paper_claims, run_case
from wtg_gym.reproduce.claims import claims_table

_DESCRIPTION = """\
Runs the paper's analysis and case studies on the simulator and writes, within two minutes,

  claims.json   every claim of the paper with its tolerance, measurement and verdict
  figures/*     the paper's figures

With --page the sections `claims` and `figures` of a Markdown file are renewed, each between <!-- NAME:start --> and
<!-- NAME:end -->, with links to the pictures in the output folder."""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym reproduce`."""
    parser = add_command(
        commands,
        "reproduce",
        run,
        description=_DESCRIPTION,
        examples="  wtg-gym reproduce\n  wtg-gym reproduce --output figures-for-print --formats svg pdf\n"
        "  wtg-gym reproduce --output docs/validation --formats svg --page docs/validation.md",
        after_interrupt="what has been written so far is complete; run the same command again",
    )
    add_output_options(
        parser,
        output="where to write (default: reproduction)",
        page="Markdown file whose sections are renewed",
        json="print claims.json on stdout instead of the table",
        default="reproduction",
    )


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym reproduce`."""
    output.require_extra("matplotlib", "wtg-gym reproduce")
    from wtg_gym.plotting import save_figure
    from wtg_gym.reproduce.figures import paper_figures

    folder = output.check_output_folder("--output", arguments.output)
    page = output.check_page("--page", arguments.page, "claims", "figures")
    with Progress("steps") as progress:
        cases = tuple(run_case(seed, progress.update) for seed in range(2))
        progress.update("claims", 0, 1)
        claims = paper_claims(*cases)
        figures = paper_figures(*cases)
        for done, (name, figure) in enumerate(figures.items()):
            progress.update(f"drawing {name}", done, len(figures))
            save_figure(figure.draw(), folder / "figures" / name, arguments.formats)
    data = output.plain_json({"claims": [dataclasses.asdict(claim) for claim in claims]})
    write_atomically(folder / "claims.json", to_json(data))
    output.note(f"wrote {folder / 'claims.json'} and {len(figures)} figures in {folder / 'figures'}")
    if page is not None:
        suffix = "png" if "png" in arguments.formats else arguments.formats[0]
        where = Path(os.path.relpath((folder / "figures").resolve(), page.resolve().parent)).as_posix()
        gallery = [f"![{name}]({where}/{name}.{suffix})\n\n{each.caption}" for name, each in figures.items()]
        output.update_page(page, {"claims": claims_table(claims), "figures": "\n\n".join(gallery)})
    if arguments.json:
        output.print_json(data)
    else:
        rows = [(c.key, c.expected, c.measured, c.fitted, "holds" if c.holds else "DOES NOT HOLD") for c in claims]
        output.print_table(("claim", "expected", "measured", "fitted", "verdict"), rows, left=(0, 1, 2, 3, 4))
    return 0
