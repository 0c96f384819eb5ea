"""`wtg-gym gap`: public against fresh scenarios."""

from __future__ import annotations

import argparse

from wtg_gym.cli.output import check_page, note, print_json, print_table, say, update_page
from wtg_gym.cli.parser import Commands, add_command
from wtg_gym.evaluation import Results
from wtg_gym.evaluation.generalisation import COLUMNS, describe, gap_cells, gap_page, generalisation_gaps, left_out

_DESCRIPTION = """\
Compares the scores of entries on the public test scenarios with those on fresh ones, which were drawn after the entries
were submitted. An entry that was fitted to the public scenarios, by mistake or on purpose, is better there. All entries
are a little, or worse, by the luck of the draw: what suits one good controller suits the others. So beside the gap,
public minus fresh, stands for every learned entry the excess: the part of its gap that the controllers made by hand in
the same results do not share (a regression on their gains). Both have a bootstrap 95 % interval over scenarios; that
of the gap is over training seeds too. An excess whose interval lies above zero is marked; of forty honest entries one
is, by chance.

Fresh scenarios are played by 'wtg-gym evaluate' or 'wtg-gym submission score' with --split verification, --commit, the
full hash of the commit with the entries, and --secret-file. Publish the sha256 of the secret before anybody submits and
the secret afterwards: then 'wtg-gym verify --secret-file' shows that the seeds were not chosen."""
_EXAMPLES = """\
  wtg-gym evaluate --entries baselines agents/policies/* --split verification --commit $(git rev-parse HEAD) \\
      --secret-file secret.txt --results results
  wtg-gym gap results/standard-test.json results/standard-verification.json
  wtg-gym verify results/standard-verification.json --entries baselines agents/policies/* --secret-file secret.txt"""


def add_commands(commands: Commands) -> None:
    """Add `wtg-gym gap`."""
    parser = add_command(
        commands,
        "gap",
        run,
        summary="compare scores on public and on fresh scenarios",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("public", metavar="PUBLIC.json", help="results on the test scenarios")
    parser.add_argument("fresh", metavar="FRESH.json", help="results on the split verification")
    parser.add_argument(
        "--page", metavar="FILE", help="Markdown file with markers 'gap:SUITE' to put the table between"
    )
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, on stdout")


def run(arguments: argparse.Namespace) -> int:
    """Carry out `wtg-gym gap`."""
    public, fresh = Results.read(arguments.public), Results.read(arguments.fresh)
    section = f"gap:{public.suite}"
    page = check_page("--page", arguments.page, section)
    gaps = generalisation_gaps(public, fresh)
    missing = left_out(public, fresh)
    if arguments.json:
        print_json({"draw": fresh.draw, "gaps": [gap.to_dict() for gap in gaps], "left_out": missing})
    else:
        say(describe(public, fresh), "")
        left = [index for index, is_number in enumerate(COLUMNS.values()) if not is_number]
        print_table(tuple(COLUMNS), gap_cells(gaps), left=left)
    if missing:
        note(f"left out, not the same policy in both results: {', '.join(missing)}")
    if page is not None:
        update_page(page, {section: gap_page(public, fresh, gaps)})
    return 0


__all__ = ["add_commands", "run"]
