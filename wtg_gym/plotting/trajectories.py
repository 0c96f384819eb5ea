"""The figure of recorded runs of one scenario under several strategies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY
from wtg_gym.physics.trajectory import Trajectory
from wtg_gym.plotting import style
from wtg_gym.plotting.event_marks import draw_run, endings, explain_events, mark_instants

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Most WTG groups that are drawn, and the width of a column at the least [mm].
_MOST_COLUMNS, _COLUMN_MM = 4, 70.0


class Panel(NamedTuple):
    """One quantity of the WTG groups."""

    label: str
    values: Callable[[Trajectory], Floats]  # (n, n_wtg)
    references: Mapping[str, float] = {}  # dashed lines by their names


PANELS = (
    Panel("frequency [Hz]", lambda run: run.wtg_frequency_hz),
    Panel("power [p.u.]", lambda run: run.power_pu),
    Panel("rotor speed [p.u.]", lambda run: run.rotor_speed_pu),
    Panel("coefficient k [p.u.]", lambda run: run.coefficient_pu),
)


@style.printed
def plot_trajectories(
    runs: Mapping[str, Trajectory], scenario: Scenario, columns: Mapping[str, Sequence[Panel]] | None = None
) -> Figure:
    """Draw frequency, power, rotor speed and tracking coefficient of the WTG groups, one column per group.

    The reference strategy is drawn on top and thick; a cross marks where a run ended before its time; events are
    numbered and explained above.

    Args:
        runs: recorded runs of the scenario by label, at least one.
        scenario: what happened in them.
        columns: four panels by the title of each group's column; None for those of the first four groups.
    """
    n_groups = next(iter(runs.values())).power_pu.shape[1]
    columns = columns or {f"WTG group {1 + group}": PANELS for group in range(min(n_groups, _MOST_COLUMNS))}
    figure = style.new_figure(max(style.DOUBLE_COLUMN_MM, _COLUMN_MM * len(columns)), 178.0)
    grid = figure.subplots(4, len(columns), sharex=True, squeeze=False, height_ratios=(1.0, 1.15, 1.15, 0.85))
    looks = style.strategy_looks(runs)
    for group, (title, panels) in enumerate(columns.items()):
        style.letter_panel(grid[0, group], "abcd"[group], title)
        for axes, panel in zip(grid[:, group], panels, strict=True):
            for name, run in runs.items():
                width, order = (1.7, 3.5) if name == REFERENCE_STRATEGY else (1.0, 3.0)
                line = {"label": name, "linewidth": width, "zorder": order, "linestyle": looks[name].dashes}
                draw_run(axes, run, panel.values(run)[:, group], looks[name].colour, **line)
            for text, value in panel.references.items():
                style.draw_reference(axes, value, text)
            mark_instants(axes, scenario, numbered=axes is grid[0, group])
            if group == 0:
                axes.set_ylabel(panel.label)
        grid[3, group].set_xlabel("time [s]")
    grid[0, 0].set_xlim(0.0, scenario.duration_s)
    for row in (grid[0], grid[3]):
        style.share_limits(row)
    if reasons := endings(runs.values()):
        grid[0, 0].plot([], [], "x", color="0.25", markeredgewidth=1.4, label=reasons)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), handlelength=3.6)
    explain_events(figure, scenario)
    return figure
