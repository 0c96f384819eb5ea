"""The leaderboard as one HTML file that needs nothing but a browser: tables and charts by Bokeh, written into it.

Bokeh is of the `leaderboard` extra and is imported only when a page is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from wtg_gym.envs.rendering.colours import GROUPS, LINE
from wtg_gym.evaluation import Results, leaderboard_rows, table_cells
from wtg_gym.evaluation.table import columns_of

#: A colour per kind of entry.
_COLOURS = {"law": GROUPS[1], "feedback": GROUPS[2], "learned": GROUPS[0]}
#: Compares texts that begin with numbers; empty ones and words come last.
_BY_NUMBER = """
const number = (text) => { const value = parseFloat(text); return Number.isNaN(value) ? Infinity : value; };
return Math.sign(number(x) - number(y)) || 0;
"""
#: Which rows the filters leave, of the table and of the charts.
_IS_SHOWN = """
const kinds = kind.active.map((place) => kind.labels[place]);
const wanted = name.value_input.toLowerCase();
const {name: names, kind: own} = source.data;
return names.map((text, row) => text.toLowerCase().includes(wanted) && kinds.includes(own[row]));
"""
#: Sizes [pixels].
_CHARACTER_WIDTH, _ROW_HEIGHT, _CHART_HEIGHT = 6, 26, 420
#: Least score that is shown at first.
_LEAST_SHOWN = -100.0


def leaderboard_page(results: Sequence[Results]) -> str:
    """Return the leaderboard as one HTML file: a tab per ranking, the suites of the latest version first.

    Results of scenarios without a scale are left out. A ValueError says that none is left, that scenarios are given
    twice, or that a suite was another one when it was played.
    """
    from bokeh.embed import file_html
    from bokeh.models import TabPanel, Tabs
    from bokeh.resources import INLINE

    for each in results:
        each.check_suite()
    ranked = [each for each in results if each.has_scale]
    if not ranked:
        raise ValueError("the page needs results with a score")
    ranked.sort(key=lambda each: each.task.version, reverse=True)
    names = [each.name for each in ranked]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"results of the same scenarios were given twice: {', '.join(twice)}")
    panels = [TabPanel(title=each.name, child=_ranking(each)) for each in ranked]
    text: str = file_html(Tabs(tabs=panels), INLINE, title="wtg_gym: leaderboard")
    return text


def _ranking(results: Results) -> Any:
    """Return filters, table and charts of one ranking."""
    from bokeh.layouts import column, row
    from bokeh.models import CDSView, CheckboxButtonGroup, ColumnDataSource, CustomJS, CustomJSFilter, Div, TextInput

    rows = leaderboard_rows(results)
    heads, scores = columns_of("whole", rows), [results.scores[each.name] for each in rows]
    cells = dict(zip(heads, zip(*table_cells(rows), strict=True), strict=True))
    source = ColumnDataSource(
        {
            **{head: list(own) for head, own in cells.items()},
            "name": [each.name for each in rows],
            "kind": [each.kind for each in rows],
            "colour": [_COLOURS[each.kind] for each in rows],
            "score_value": [each.value for each in scores],
            "score_low": [each.low for each in scores],
            "score_high": [each.high for each in scores],
            "deviation": [each.median_deviation_mhz for each in rows],
            "lost_or_beyond": [each.lost_or_beyond_percent for each in rows],
        },
        name=results.name,
    )
    kinds = [kind for kind in _COLOURS if kind in source.data["kind"]]
    kind = CheckboxButtonGroup(labels=kinds, active=list(range(len(kinds))))
    name = TextInput(placeholder="part of a name")
    view = CDSView(filter=CustomJSFilter(args={"kind": kind, "name": name}, code=_IS_SHOWN))
    filtered = CustomJS(args={"source": source}, code="source.change.emit()")
    kind.js_on_change("active", filtered)
    name.js_on_change("value_input", filtered)
    zero, hundred = results.task.anchors
    words = Div(
        text=f"<b>{escape(results.environment['id'])}</b>, suite {escape(results.suite)}: {len(results.seeds)} "
        f"{escape(results.split)} scenarios. Score 0 is {zero}, 100 is {hundred}; in brackets are 95 % intervals. "
        "Points say which terms of the cost a score above or below 100 comes from. A click on a heading sorts; rows "
        f"that are chosen stand out in the charts. {escape('. '.join(results.notes))}",
        width=1200,
    )
    charts = row(_score_chart(source, view), _deviation_chart(source, view))
    return column(words, row(kind, name), _table(source, heads, view), charts)


def _table(source: Any, heads: Sequence[str], view: Any) -> Any:
    from bokeh.models import CustomJSCompare, DataTable, HTMLTemplateFormatter, TableColumn

    # Texts of entries are shown, never taken as HTML.
    plain = HTMLTemplateFormatter(template="<%- value %>")
    columns = []
    for head in heads:
        sorter = {} if head in ("entry", "kind") else {"sorter": CustomJSCompare(code=_BY_NUMBER)}
        width = 18 + _CHARACTER_WIDTH * max(map(len, [head, *source.data[head]]))
        columns.append(TableColumn(field=head, title=escape(head), width=width, formatter=plain, **sorter))
    return DataTable(
        source=source,
        view=view,
        columns=columns,
        index_position=None,
        autosize_mode="none",
        reorderable=False,
        row_height=_ROW_HEIGHT,
        width=20 + sum(each.width for each in columns),
        # A row more for the headings.
        height=min(10 + _ROW_HEIGHT * (1 + len(source.data[heads[0]])), 600),
    )


def _chart(title: str, x: str, y: str, **settings: Any) -> Any:
    from bokeh.models import HoverTool
    from bokeh.plotting import figure

    made = figure(title=title, x_axis_label=x, y_axis_label=y, width=640, tools="pan,box_zoom,tap,reset", **settings)
    made.toolbar.logo = None
    made.add_tools(
        HoverTool(tooltips=[("", "@name"), ("score", "@score"), ("lost or beyond 0.8 Hz", "@lost_or_beyond{0.0} %")])
    )
    return made


def _score_chart(source: Any, view: Any) -> Any:
    from bokeh.models import FactorRange, Range1d

    names = list(source.data["name"])
    height = max(_CHART_HEIGHT, 60 + 16 * len(names))
    low, high = min([0.0, *source.data["score_low"]]), max([100.0, *source.data["score_high"]])
    # A law that stalls would make one point of all others: the chart can be moved to it.
    across = Range1d(max(low, _LEAST_SHOWN) - 5.0, high + 5.0)
    made = _chart(
        "Scores with 95 % intervals", "score", "", x_range=across, y_range=FactorRange(*reversed(names)), height=height
    )
    made.vspan([0.0, 100.0], line_color=LINE)
    made.segment("score_low", "name", "score_high", "name", source=source, view=view, color="colour", line_width=2)
    made.scatter("score_value", "name", source=source, view=view, color="colour", size=8)
    return made


def _deviation_chart(source: Any, view: Any) -> Any:
    y = "median of the largest deviations [mHz]"
    made = _chart(
        "Typical and large deviations", "runs lost or beyond 0.8 Hz [%]", y, y_axis_type="log", height=_CHART_HEIGHT
    )
    made.scatter("lost_or_beyond", "deviation", source=source, view=view, color="colour", size=9, legend_group="kind")
    return made
