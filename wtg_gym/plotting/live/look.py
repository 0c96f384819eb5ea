"""What the page looks like: charts, tables, texts, and the frame around them."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any

from bokeh.document import Document
from bokeh.models import ColumnDataSource, Div, Range1d, Span
from bokeh.plotting import figure

from wtg_gym.envs.rendering.colours import EVENT, GRID, INK, LINE, SOFT, group_colour

#: Colours of your run and of the reference, those of A and B on the leaderboard's page.
YOURS, OTHER = "#0063a6", "#b84600"
_TEXTS = f"""
    :host {{ font: 14px/1.45 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: {INK}; }}
    .bk-clearfix {{ width: 100%; }}
    p {{ margin: 0.2rem 0; }}
    .big {{ font-size: 1.35rem; font-weight: 600; }}
    .soft {{ color: {SOFT}; }}
    .bad {{ border-left: 4px solid {EVENT}; padding: 0.3rem 0.7rem; background: #f9eef4; }}
    .event {{ color: {EVENT}; }}
    .scroll {{ overflow-x: auto; }}
    table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
    th, td {{ padding: 0.2rem 0.55rem 0.2rem 0; text-align: right; white-space: nowrap; }}
    th, td {{ border-bottom: 1px solid {LINE}; }}
    th:first-child, td:first-child {{ text-align: left; font-weight: 500; }}
    thead th {{ color: {SOFT}; font-weight: 600; vertical-align: bottom; }}
    code {{ font-size: 0.85rem; overflow-wrap: anywhere; }}
"""


def text(name: str, content: str = "") -> Div:
    """Return an empty place for text, a root of the page."""
    return Div(name=name, text=content, sizing_mode="stretch_width", stylesheets=[_TEXTS])


def sentence(content: str) -> str:
    """Return a text safe to show, with one full stop at its end, which a unit may have brought."""
    return html.escape(content.rstrip(".")) + "."


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as HTML; the first column is text."""
    head = "".join(f"<th scope=col>{html.escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<div class=scroll><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"


def chart(name: str, title: str, height: int, duration_s: float, *, time_axis: bool = False) -> Any:
    """Return an empty chart over time, a root of the page."""
    made = plain_chart(name, title, height, x_range=Range1d(0.0, duration_s))
    if time_axis:
        made.xaxis.axis_label = "time [s]"
    return made


def plain_chart(name: str, title: str, height: int, **settings: Any) -> Any:
    """Return an empty chart, a root of the page."""
    made = figure(
        name=name,
        title=title,
        height=height,
        sizing_mode="stretch_width",
        min_width=200,
        toolbar_location=None,
        tools="",
        background_fill_color="#ffffff",
        border_fill_alpha=0.0,
        min_border_left=52,
        min_border_right=12,
        min_border_top=0,
        min_border_bottom=4,
        lod_threshold=None,
        **settings,
    )
    made.outline_line_color = LINE
    made.grid.grid_line_color = GRID
    made.title.text_font_size, made.title.text_font_style, made.title.text_color = "12px", "normal", SOFT
    made.axis.axis_line_color = made.axis.major_tick_line_color = LINE
    made.axis.minor_tick_line_color = None
    made.axis.major_label_text_color = made.axis.axis_label_text_color = SOFT
    made.axis.axis_label_text_font_style = "normal"
    made.yaxis.ticker.desired_num_ticks = 5
    return made


def show_at_least(made: Any, low: float, high: float) -> None:
    """Keep two values in view of a chart whose range follows what it shows."""
    made.scatter([0.0, 0.0], [low, high], alpha=0.0, size=1)


def mark(made: Any, *values: float) -> None:
    """Draw dotted lines at values of the vertical axis."""
    for value in values:
        made.add_layout(Span(location=value, dimension="width", line_dash=[2, 4], line_color=SOFT))


def mark_events(made: Any, source: ColumnDataSource) -> None:
    """Draw lines at the instants in the column "x" of a source."""
    made.vspan("x", source=source, line_color=EVENT, line_dash=[3, 3], line_width=1.2)


def groups_in_colour(n_groups: int) -> str:
    """Return the names of the groups in the colours of their lines, as HTML."""
    return ", ".join(f"<b style='color:{group_colour(j)}'>group {j + 1}</b>" for j in range(n_groups))


def frame(document: Document, page: str, title: str, variables: Mapping[str, Any]) -> None:
    """Put a page's own template, its style and its title around the document's models."""
    document.title = title
    document.template = _read(f"{page}.html")
    document.template_variables.update(style=_read("live.css"), **variables)


def _read(name: str) -> str:
    return resources.files("wtg_gym.plotting.live").joinpath(name).read_text(encoding="utf-8")
