"""What parameters do to nadir, RoCoF and rotor speed: bars of :mod:`wtg_gym.analysis.influence_study`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.analysis.influence_study import MEASURES
from wtg_gym.plotting.style import DOUBLE_COLUMN_MM, PALETTE, REFERENCE_GREY, letter_panel, new_figure, printed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from wtg_gym.analysis.influence_study import Influences


@printed
def plot_influences(found: Influences, n_bars: int) -> Figure:
    """Draw what one per cent more of the parameters of most influence does to each measure.

    Bars are means over the scenarios; where there are several, a line goes from the least to the largest.
    """
    chosen = found.order()[:n_bars]
    figure = new_figure(DOUBLE_COLUMN_MM, 22.0 + 4.2 * len(chosen))
    panels = figure.subplots(1, len(MEASURES), sharey=True)
    places = np.arange(len(chosen))
    for m, (axes, (name, (unit, _, _))) in enumerate(zip(panels, MEASURES.items(), strict=True)):
        effects = found.effects[:, chosen, m]
        axes.barh(places, effects.mean(axis=0), height=0.62, color=PALETTE[m])
        if effects.shape[0] > 1:
            axes.hlines(places, effects.min(axis=0), effects.max(axis=0), color="0.15", linewidth=0.8)
        axes.axvline(0.0, color=REFERENCE_GREY, linewidth=0.6)
        axes.grid(visible=False, axis="y")
        axes.tick_params(axis="y", length=0.0)
        axes.set_xlabel(f"{name.replace('_', ' ').replace('rocof', 'RoCoF')} [{unit}]")
        letter_panel(axes, "abc"[m])
    panels[0].set_yticks(places, [found.parameters[i] for i in chosen])
    panels[0].set_ylim(len(chosen) - 0.4, -0.6)
    figure.suptitle("Effect of one per cent more", fontweight="normal")
    return figure
