"""Eigenvalues of the whole system in the complex plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.plotting import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from wtg_gym.physics.modes import Mode

#: Damping ratios whose lines are drawn in the plane of eigenvalues [-].
_DAMPING_RATIOS = (0.05, 0.10, 0.30)
#: Left edge of the plane of eigenvalues [1/s]; faster modes are left out.
_LEFT = -12.0


@style.printed
def plot_modes(groups: Mapping[str, Sequence[Mode]]) -> Figure:
    """Draw eigenvalues in the upper half of the complex plane: (a) the oscillations, (b) what is slow, enlarged.

    Lines of constant damping ratio: 5, 10 and 30 %. One marker and colour per label.
    """
    values = {label: np.array([mode.eigenvalue for mode in found]) for label, found in groups.items()}
    everything = np.concatenate([np.empty(0), *values.values()])
    looks = style.strategy_looks(values)
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 82.0)
    plane, slow = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    right = max(0.0, float(everything.real.max()))
    # Panel (b): as far to the left as up, so that angles show damping.
    reach = -0.1 * _LEFT
    highest = max(1.12 * float(everything.imag[everything.real >= _LEFT].max()), -0.5 * _LEFT)
    for axes, left, top in ((plane, _LEFT, highest), (slow, -reach, reach)):
        for i, (label, eigenvalues) in enumerate(values.items()):
            shown = eigenvalues[(eigenvalues.real >= left) & (eigenvalues.imag <= top)]
            axes.plot(
                shown.real,
                shown.imag,
                style.MARKERS[i % len(style.MARKERS)],
                color=looks[label].colour,
                markerfacecolor="none",
                markeredgewidth=1.0,
                # Shrinking, so that equal modes show as nested markers.
                markersize=max(6.5 - 0.6 * i, 3.0),
                label=label if axes is plane else f"_{label}",
                clip_on=False,
                # A label without a mode here has no extent that a layout could make room for.
                in_layout=False,
                zorder=3,
            )
        axes.set_xlim(left, right - 0.04 * left)
        axes.set_ylim(-0.03 * top, top)
        _draw_damping_ratios(axes, left, top)
        axes.axvline(0.0, color="0.2", linewidth=0.8, zorder=1)
        axes.set_xlabel(r"Re $s$ [1/s]")
        axes.set_ylabel(r"Im $s$ [rad/s]")
    plane.plot((-reach, -reach, right), (0.0, reach, reach), color="0.2", linewidth=0.7)
    plane.annotate("(b)", (-reach, reach), (-2.0, 1.0), textcoords="offset points", ha="right", fontsize=style.SMALL_PT)
    style.letter_panel(plane, "a", "modes and damping ratios")
    style.letter_panel(slow, "b", "slow modes, enlarged")
    figure.legend(loc="outside lower center", ncols=min(4, len(values)))
    return figure


def _draw_damping_ratios(axes: Axes, left: float, highest: float) -> None:
    for ratio in _DAMPING_RATIOS:
        # Im/Re along a line of constant ζ = -Re/|s|.
        slope = (1.0 - ratio**2) ** 0.5 / ratio
        end = min(-left, highest / slope)
        axes.plot(
            (0.0, -end),
            (0.0, slope * end),
            color=style.REFERENCE_GREY,
            linewidth=0.7,
            linestyle=style.THIN_DASHES,
            zorder=1,
            label=f"_damping ratio {ratio:g}",
        )
        axes.annotate(
            f"{100 * ratio:.0f} %",
            (-end, slope * end),
            (0.0, 1.5),
            textcoords="offset points",
            # The two steep lines end close to each other.
            ha="left" if ratio == _DAMPING_RATIOS[0] else "right",
            va="bottom",
            fontsize=style.SMALL_PT,
            color="0.3",
        )
