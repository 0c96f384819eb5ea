"""The page's charts as one Bokeh document without data and colours, which the page's own script fills in.

Sources are found by their names, renderers by their tags: "a" and "b" are the two entries compared, "rest" all others.
"""

from __future__ import annotations

from typing import Any

from bokeh.document import Document
from bokeh.models import BoxZoomTool, ColumnDataSource, FixedTicker, HoverTool, Range1d, Span, WheelZoomTool
from bokeh.plotting import figure

from wtg_gym.plotting.page.data import limits

#: Name, title, and whether every WTG group has a line of its own.
PANELS = (
    ("frequency", "frequency [Hz]", False),
    ("rocof", "RoCoF over a control step [Hz/s]", True),
    ("rotor", "rotor speed [p.u.]", True),
    ("ratio", "tip-speed ratio [–]", True),
    ("power", "power [p.u.]", True),
    ("k", "k [p.u.]", True),
    ("tau", "τ [s]", True),
    ("wind", "wind speed [m/s]", True),
)
#: Dashes of the groups' lines; further groups begin again.
GROUP_DASHES: tuple[list[int], ...] = ([], [6, 3], [2, 2], [8, 3, 2, 3])
_MARKERS = {"law": "circle", "feedback": "diamond", "learned": "square"}
_PANEL_HEIGHT, _LAST_AXIS_HEIGHT = 130, 26
#: The two that are compared differ in width too, for those who cannot tell the colours apart.
_WIDTHS = {"a": 2.4, "b": 1.4, "rest": 1.0}


def page_document(n_groups: int, metric_labels: list[str]) -> Document:
    """Return the document: figures "ranking", "profile", "front", "compare", "physical", "grid" and one per panel."""
    document = Document()
    for chart in (_ranking(), _profile(), _front(), _compare(), _physical(metric_labels), _grid(), *_panels(n_groups)):
        document.add_root(chart)
    return document


def _chart(name: str, height: int, **settings: Any) -> Any:
    chart = figure(
        name=name,
        height=height,
        sizing_mode="stretch_width",
        min_width=200,
        toolbar_location=None,
        tools="",
        background_fill_alpha=0.0,
        border_fill_alpha=0.0,
        min_border_left=58,
        min_border_right=14,
        **settings,
    )
    chart.outline_line_color = None
    return chart


def _source(name: str, *columns: str) -> ColumnDataSource:
    return ColumnDataSource({column: [] for column in columns}, name=name)


def _ranking() -> Any:
    ranges = {"x_range": Range1d(0.0, 100.0), "y_range": Range1d(0.0, 1.0)}
    chart = _chart("ranking", 300, x_axis_label="score", **ranges)
    bars = _source("intervals", "y", "low", "high", "colour")
    chart.segment("low", "y", "high", "y", line_width=3, line_color="colour", source=bars)
    dots = {}
    for kind, marker in _MARKERS.items():
        columns = ("x", "y", "name", "colour", "interval")
        source = _source(f"dots-{kind}", *columns)
        dots[kind] = chart.scatter("x", "y", size=9, marker=marker, color="colour", source=source)
    for at, tag in ((0.0, "zero"), (100.0, "hundred")):
        chart.add_layout(Span(location=at, dimension="height", line_dash=[4, 4], tags=["rule", tag]))
    chart.add_tools(HoverTool(renderers=list(dots.values()), tooltips=[("", "@name"), ("score", "@interval")]))
    chart.ygrid.visible = False
    chart.yaxis.ticker = FixedTicker(ticks=[])
    return chart


def _profile() -> Any:
    ranges = {"x_range": Range1d(-50.0, 120.0), "y_range": Range1d(-0.02, 1.02)}
    chart = _chart("profile", 320, x_axis_label="score s", y_axis_label="share of scenarios above s", **ranges)
    lines = _lines(chart, "profile")
    chart.add_tools(HoverTool(renderers=lines, tooltips=[("", "@name")], line_policy="none"))
    return chart


def _front() -> Any:
    """Return the entries by energy and support; a line joins those that no other one beats in both."""
    ranges = {"x_range": Range1d(90.0, 100.0), "y_range": Range1d(-100.0, 100.0)}
    labels = {"x_axis_label": "captured energy [%]", "y_axis_label": "frequency and RoCoF [points]"}
    chart = _chart("front", 360, **labels, **ranges)
    line = _source("front-line", "x", "y")
    chart.line("x", "y", source=line, line_width=1.5, line_dash=[5, 4], tags=["axis"])
    chart.add_layout(Span(location=0.0, dimension="width", line_dash=[4, 4], tags=["rule"]))
    dots = []
    for kind, marker in _MARKERS.items():
        source = _source(f"front-{kind}", "x", "y", "name", "colour", "fill", "values")
        look = {"marker": marker, "color": "colour", "fill_alpha": "fill", "line_width": 1.5}
        dots.append(chart.scatter("x", "y", size=10, source=source, **look))
    names = _source("front-names", "x", "y", "text", "align", "dx")
    _write(chart, "x", "y", "text", names, "ink", text_align="align", x_offset="dx", y_offset=-6)
    chart.add_tools(HoverTool(renderers=dots, tooltips=[("", "@name"), ("points, energy", "@values")]))
    return chart


def _compare() -> Any:
    """Return the differences of two entries' scores, one bar per scenario; dots are those with traces, one is shown."""
    ranges = {"x_range": Range1d(0.0, 1.0), "y_range": Range1d(-1.0, 1.0)}
    labels = {"x_axis_label": "scenarios, sorted", "y_axis_label": "score of A − score of B"}
    chart = _chart("compare", 320, **labels, **ranges)
    columns = ("x", "y", "seed", "scores")
    for tag in "ab":
        source = _source(f"gains-{tag}", *columns)
        chart.vbar("x", top="y", width=0.8, source=source, fill_alpha=0.7, line_alpha=0.0, tags=[tag, "filled"])
    traced, shown = _source("gains-traced", *columns), _source("gains-shown", *columns)
    dots = chart.scatter("x", "y", size=8, source=traced, line_width=1.5, tags=["ink", "hollow"])
    chart.scatter("x", "y", size=13, source=shown, line_width=3.0, fill_alpha=0.0, tags=["event"])
    chart.add_layout(Span(location=0.0, dimension="width", tags=["rule"]))
    chart.add_tools(HoverTool(renderers=[dots], tooltips=[("scenario", "@seed"), ("A, B", "@scores")]))
    chart.xgrid.visible = False
    chart.xaxis.ticker.desired_num_ticks = 5
    return chart


def _physical(labels: list[str]) -> Any:
    places = list(range(len(labels)))
    chart = _chart("physical", 320, x_range=Range1d(-0.5, len(labels) - 0.5), y_range=Range1d(-0.15, 1.15))
    axes = _source("axes", "x", "best", "worst")
    axes.data = {"x": places, "best": [""] * len(labels), "worst": [""] * len(labels)}
    chart.segment("x", 0.0, "x", 1.0, source=axes, tags=["axis"])
    lines = _lines(chart, "physical")
    for column, y, side in (("best", 1.03, "bottom"), ("worst", -0.03, "top")):
        _write(chart, "x", y, column, axes, "ink", text_align="center", text_baseline=side)
    chart.xaxis.ticker = FixedTicker(ticks=places)
    chart.xaxis.major_label_overrides = dict(zip(places, labels, strict=True))
    chart.yaxis.visible = False
    chart.grid.visible = False
    chart.min_border_left = 8
    chart.add_tools(HoverTool(renderers=lines, tooltips=[("", "@name")], line_policy="nearest"))
    return chart


def _write(
    chart: Any, x: str, y: str | float, text: str, source: ColumnDataSource, tag: str, *, px: int = 11, **style: Any
) -> None:
    """Write a column of texts."""
    chart.text(x, y, text=text, source=source, text_font_size=f"{px}px", tags=[tag], **style)


def _lines(chart: Any, name: str) -> list[Any]:
    """Add the lines of all entries, those that are compared on top."""
    drawn = []
    for tag in ("rest", "b", "a"):
        source = _source(f"{name}-{tag}", "xs", "ys", "name")
        drawn.append(chart.multi_line("xs", "ys", source=source, line_width=_WIDTHS[tag], tags=[tag]))
    return drawn


def _grid() -> Any:
    """Return the single-line diagram: lines, buses as bars, machines, WTG groups, and where the events strike."""
    chart = _chart("grid", 300, x_range=Range1d(-0.6, 9.8), y_range=Range1d(-0.9, 6.5))
    lines = _source("branches", "x0", "y0", "x1", "y1")
    opened = _source("opened", "x0", "y0", "x1", "y1")
    bars = _source("buses", "x0", "x1", "y", "x", "number")
    units = _source("units", "x", "y", "y0", "text", "kind")
    groups = _source("groups", "x", "y", "y0", "text")
    struck = _source("struck", "x", "y", "text")
    chart.segment("x0", "y0", "x1", "y1", source=lines, line_width=1.2, tags=["axis"])
    chart.segment("x0", "y0", "x1", "y1", source=opened, line_width=3, line_dash=[4, 3], tags=["event"])
    for source, tag in ((units, "ink"), (groups, "wind")):
        chart.segment("x", "y0", "x", "y", source=source, line_width=1.2, tags=[tag])
        chart.scatter("x", "y", size=19, source=source, line_width=1.5, tags=[tag, "hollow"])
        _write(chart, "x", "y", "text", source, tag, px=10, text_align="center", text_baseline="middle")
    chart.segment("x0", "y", "x1", "y", source=bars, line_width=4, tags=["ink"])
    _write(chart, "x1", "y", "number", bars, "ink", x_offset=3, y_offset=-3, text_baseline="bottom")
    chart.scatter("x", "y", size=24, marker="circle", source=struck, line_width=2.5, tags=["event", "hollow"])
    beside: dict[str, Any] = {"x_offset": -11, "y_offset": -9, "text_align": "right", "text_baseline": "bottom"}
    _write(chart, "x", "y", "text", struck, "event", text_font_style="bold", **beside)
    chart.axis.visible = False
    chart.grid.visible = False
    chart.min_border_left = chart.min_border_right = 2
    return chart


def _panels(n_groups: int) -> list[Any]:
    """Return the panels of the traces, over one time axis and one source, with one cursor."""
    columns = [f"{side}-{name}-{j}" for side in "ab" for name, _, own in PANELS for j in range(n_groups if own else 1)]
    source = _source("traces", "t", *columns)
    # The page moves them to the limits of the suite that it shows.
    lines = limits("standard")
    events = _source("events", "x")
    time = Range1d(0.0, 60.0, name="time")
    cursor = Span(location=0.0, dimension="height", name="cursor", tags=["cursor"])
    charts = []
    for place, (name, title, own) in enumerate(PANELS):
        last = place == len(PANELS) - 1
        chart = _chart(
            f"panel-{name}",
            _PANEL_HEIGHT + _LAST_AXIS_HEIGHT * last,
            x_range=time,
            y_range=Range1d(0.0, 1.0),
            title=title,
            lod_threshold=None,
        )
        chart.min_border_top, chart.min_border_bottom = 0, 4
        chart.title.text_font_size = "12px"
        chart.title.text_font_style = "normal"
        chart.yaxis.ticker.desired_num_ticks = 4
        chart.vspan("x", source=events, line_dash=[3, 3], line_width=1.2, tags=["event"])
        # Both entries meet the same wind.
        for side in ("b", "a") if name != "wind" else ("a",):
            for j in range(n_groups if own else 1):
                chart.line(
                    "t",
                    f"{side}-{name}-{j}",
                    source=source,
                    line_width=_WIDTHS[side],
                    line_dash=GROUP_DASHES[j % len(GROUP_DASHES)],
                    tags=["wind" if name == "wind" else side],
                )
        for i, value in enumerate(lines.get(name, {}).values()):
            span = Span(location=value, dimension="width", line_dash=[2, 4], name=f"limit-{i}", tags=["rule"])
            chart.add_layout(span)
        chart.add_layout(cursor)
        zoom = BoxZoomTool(dimensions="width", name="drag")
        chart.add_tools(zoom, WheelZoomTool(dimensions="width", modifiers={"ctrl": True}))
        if last:
            chart.xaxis.axis_label = "time [s]"
        else:
            chart.xaxis.major_label_text_font_size = "0px"
            chart.xaxis.major_tick_line_color = None
        charts.append(chart)
    return charts
