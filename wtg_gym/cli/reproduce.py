"""`wtg-gym reproduce`: the paper's figures and claims."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from wtg_gym.cli import output as out
from wtg_gym.cli.options import Json, OutputFolder


def reproduce(
    *,
    output: OutputFolder = Path("reproduction"),
    json: Json = False,
) -> int:
    """Run the paper's analysis and case studies on the simulator (two minutes), and write

      claims.json   every claim of the paper with its tolerance, measurement and verdict
      figures/*     the paper's figures as SVG

    examples:
      wtg-gym reproduce
      wtg-gym reproduce --output elsewhere

    Args:
        output: folder to write to
    """
    out.require_extra("matplotlib", "wtg-gym reproduce")
    from wtg_gym.files import to_json, write_atomically
    from wtg_gym.plotting import save_figure
    from wtg_gym.plotting.paper import paper_figures
    from wtg_gym.progress import Progress
    from wtg_gym.reproduce import paper_claims, run_case

    with Progress("steps") as progress:
        cases = tuple(run_case(seed, progress.update) for seed in range(2))
        progress.update("claims", 0, 1)
        claims = list(paper_claims(*cases))
        progress.update("figures", 0, 1)
        for name, figure in paper_figures(*cases):
            save_figure(figure, output / "figures" / name, ("svg",))
    data = out.plain_json({"claims": [dataclasses.asdict(claim) for claim in claims]})
    write_atomically(output / "claims.json", to_json(data))
    out.note(f"wrote {output / 'claims.json'} and the figures in {output / 'figures'}")
    if json:
        out.print_json(data)
    else:
        rows = [(c.key, c.expected, c.measured, c.fitted, "holds" if c.holds else "DOES NOT HOLD") for c in claims]
        out.print_table(("claim", "expected", "measured", "fitted", "verdict"), rows, left=(0, 1, 2, 3, 4))
    return 0
