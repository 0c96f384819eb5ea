"""The page put together: template, style, script, charts, data, and the plotting library."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from string import Template
from typing import Any

from wtg_gym import __version__
from wtg_gym.evaluation import Entry, EntrySummary, Results, leaderboard_rows, table_cells
from wtg_gym.evaluation.generalisation import GeneralisationGap, generalisation_gaps
from wtg_gym.evaluation.leaderboard import columns_of, signed_interval
from wtg_gym.evaluation.matrix import Cell, Matrix, changed_sensors, matrix_of, score_text, worst_text
from wtg_gym.plotting.front import MOST_FAILURES_PERCENT
from wtg_gym.plotting.page.data import Progress, page_data
from wtg_gym.scenarios import FRESH

#: Largest size of the file [B]: larger ones open slowly from a mail or over a network.
SIZE_LIMIT = 3_000_000
#: Scenarios with traces of each suite, where the file has room for them.
N_SCENARIOS = 20
_SCRIPTS = ("base.js", "ranking.js", "compare.js", "drill.js", "controls.js")
_GAP = "gap closed [%]"
#: What the page calls the two anchors of a version: in its head, and shortly.
_ANCHORS = {
    "v0": ("maximum power point tracking", "the reference strategy", "MPPT", "the reference"),
    "v1": (
        "the paper's law (coordinated-piecewise)",
        "the same law tuned to this grid (coordinated-tuned)",
        "the paper's law",
        "that law tuned to this grid",
    ),
}
#: Scores from which on a cell of the matrix has its deepest colour, above and below 100.
_DEEPEST_ABOVE, _DEEPEST_BELOW = 120.0, 0.0
#: Columns where there are results on fresh scenarios.
_FRESH = ("fresh score", "excess")


@dataclass(frozen=True, kw_only=True)
class Page:
    """The leaderboard as one HTML file."""

    text: str  # the file's text
    size: int  # its size in UTF-8 [B]
    n_traced: Mapping[str, int]  # scenarios with traces, by suite


def leaderboard_page(
    results: Sequence[Results],
    entries: Sequence[Entry],
    *,
    n_scenarios: int | None = None,
    n_threads: int | None = None,
    on_progress: Progress | None = None,
) -> Page:
    """Return the leaderboard as one HTML file that needs nothing else.

    The same arguments give the same text. No text of an entry is taken as HTML, and the file asks the browser to run
    no other scripts than its own and to load nothing.

    The suites of the latest version come first. Results with other sensors than the suite's own, and those of scenarios
    without a scale, are columns of the matrix alone.

    Args:
        results: one of each suite and each kind of sensors.
        entries: those whose traces are shown, where the results are theirs.
        n_scenarios: scenarios with traces, the first ones of each suite's results; None for as many of the first
            :data:`N_SCENARIOS` as keep the file below :data:`SIZE_LIMIT`.
        on_progress: called with (name of the entry, entries done, entries in all) after every entry.

    Raises:
        ImportError: Bokeh, of the leaderboard extra, is missing.
        ValueError: no results, two of one suite, or traces of results that another source code gave.
        NoScaleError: no suite has a score, see :attr:`Results.summaries`.
    """
    from bokeh.core.json_encoder import serialize_json
    from bokeh.resources import Resources

    from wtg_gym.plotting.page.figures import GROUP_DASHES, PANELS, page_document

    wanted = N_SCENARIOS if n_scenarios is None else n_scenarios
    results = sorted(results, key=lambda each: each.benchmark.version, reverse=True)
    ranked = _ranked(results)
    versions = list(dict.fromkeys(each.benchmark.version for each in results))
    data = page_data(ranked, entries, n_scenarios=wanted, n_threads=n_threads, on_progress=on_progress)
    n_groups = max(len(suite["groups"]) for suite in data["suites"])
    document = page_document(n_groups, [metric["label"] for metric in data["metrics"]])
    data["panels"] = [{"name": name, "title": title, "own": own} for name, title, own in PANELS]
    data["dashes"] = GROUP_DASHES
    library = "\n".join(Resources(mode="inline", components=["bokeh"], minified=True, log_level="error").js_raw)
    script = _script()
    environments = dict.fromkeys(each.benchmark.env_id for each in results)
    fields = {
        "environments": " and ".join(f"<code>{html.escape(name)}</code>" for name in environments),
        "scales": _scales(versions, "0 is\n{0}, 100 {1}"),
        "short_scales": _scales(versions, "0 for {2} and 100 for {3}"),
        "more_columns": "" if versions == ["v0"] else _asset("columns_since_v1.html").removesuffix("\n"),
        "matrix": _matrices(results),
        "most_failures": f"{MOST_FAILURES_PERCENT:g}",
        "policy": html.escape(_policy([library, script])),
        "style": _asset("page.css"),
        "tables": "\n".join(_table(each, _gaps(each, results), hidden=place > 0) for place, each in enumerate(ranked)),
        "version": html.escape(__version__),
        "library": _deflated(library),
        "charts": _deflated(json.dumps(_plain_ids(json.loads(serialize_json(document.to_json()))))),
        "script": script,
    }
    text = _filled(fields, data)
    while n_scenarios is None and len(text.encode()) > SIZE_LIMIT and _drop_scenario(data["suites"]):
        text = _filled(fields, data)
    n_traced = {suite["name"]: len(suite["scenarios"]) for suite in data["suites"]}
    return Page(text=text, size=len(text.encode()), n_traced=n_traced)


def _ranked(results: Sequence[Results]) -> list[Results]:
    """Return the results that have a ranking of their own: with the suite's own sensors and with a scale."""
    own = [each for each in results if not changed_sensors(each)]
    scaled = [each for each in own if each.has_scale]
    # Without any the page says why.
    return scaled or own


def _scales(versions: Sequence[str], text: str) -> str:
    """Return what 0 and 100 are in each version; `text` takes what :data:`_ANCHORS` calls them."""
    texts = {version: text.format(*map(html.escape, _ANCHORS[version])) for version in versions}
    return "; ".join(own if len(texts) == 1 else f"in {version}: {own}" for version, own in texts.items())


def _filled(fields: Mapping[str, str], data: Mapping[str, Any]) -> str:
    return Template(_asset("page.html")).substitute(fields, data=_json(data))


def _drop_scenario(suites: Sequence[Mapping[str, Any]]) -> bool:
    """Leave out the last scenario with traces of the suites that have most of them; return whether there was one."""
    most = max(len(suite["scenarios"]) for suite in suites)
    for suite in suites:
        if suite["scenarios"] and len(suite["scenarios"]) == most:
            suite["scenarios"].pop()
    return most > 0


def _asset(name: str) -> str:
    return resources.files("wtg_gym.plotting.page").joinpath(name).read_text(encoding="utf-8")


def _json(data: Any) -> str:
    """Return JSON that neither ends a script element nor begins a comment in it."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _deflated(text: str) -> str:
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def _script() -> str:
    """Return the page's own script, all of its files in one scope."""
    parts = "\n".join(_asset(name) for name in _SCRIPTS)
    text = f'"use strict";\n(async () => {{\n{parts}\n}})();\n'
    if "</script" in text.lower() or "<!--" in text:
        raise ValueError("a script of the page holds what would end it")
    return text


def _policy(scripts: Sequence[str]) -> str:
    """Return a content security policy under which these scripts run, and nothing is loaded from anywhere."""
    hashes = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts)
    allowed = " ".join(f"'sha256-{value}'" for value in hashes)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def _plain_ids(document: Mapping[str, Any]) -> Any:
    """Return a document whose models are numbered from 1 on, so that the page repeats byte for byte."""
    text = json.dumps(document)
    found: list[str] = []
    stack: list[Any] = [document]
    while stack:
        item = stack.pop()
        if isinstance(item, Mapping):
            if item.get("type") == "object" and "id" in item:
                found.append(item["id"])
            stack += item.values()
        elif isinstance(item, (list, tuple)):
            stack += item
    for number, name in enumerate(dict.fromkeys(found), start=1):
        text = text.replace(json.dumps(name), f'"m{number}"')
    return json.loads(text)


def _gaps(public: Results, results: Sequence[Results]) -> dict[str, GeneralisationGap]:
    """Return the gaps to fresh scenarios, by the entry's name, where there are results on these."""
    if public.split != "test":
        return {}
    fresh = [each for each in results if (each.suite, each.split) == (public.suite, FRESH)]
    return {gap.name: gap for each in fresh for gap in generalisation_gaps(public, each)}


def _table(results: Results, gaps: Mapping[str, GeneralisationGap], *, hidden: bool) -> str:
    """Return the ranking of a suite as a table, in the order of the scores."""
    rows = leaderboard_rows(results)
    heads = list(columns_of(results.benchmark.version).items())
    filled = [i for i, _ in enumerate(heads) if any(cells[i] for cells in table_cells(rows))]
    head = "".join(_head(*heads[i]) for i in filled) + "".join(_head(name, True) for name in _FRESH if gaps)
    body = [
        f'<tr data-name="{html.escape(row.name)}">{"".join(_cell(*heads[i], cells[i], row) for i in filled)}'
        f"{_fresh_cells(gaps.get(row.name)) if gaps else ''}</tr>"
        for row, cells in zip(rows, table_cells(rows), strict=True)
    ]
    suite = html.escape(results.suite)
    drawn = "" if results.draw is None else f" drawn from commit {html.escape(results.draw['commit'][:12])}"
    caption = f"Suite {suite}, {len(results.seeds)} {html.escape(results.split)} scenarios{drawn}"
    return (
        f'<table data-suite="{suite}"{" hidden" if hidden else ""}><caption>{caption}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>\n" + "\n".join(body) + "\n</tbody></table>"
    )


def _matrices(results: Sequence[Results]) -> str:
    """Return the section with the matrix of each version that has several columns, "" where none has."""
    by_version: dict[str, list[Results]] = {}
    for each in results:
        by_version.setdefault(each.benchmark.env_id, []).append(each)
    matrices = [_matrix(matrix_of(own)) for own in by_version.values() if len(own) > 1]
    if not matrices:
        return ""
    return Template(_asset("matrix.html")).substitute(
        matrices="\n".join(matrices), above=f"{_DEEPEST_ABOVE:g}", below=f"{_DEEPEST_BELOW:g}"
    )


def _matrix(matrix: Matrix) -> str:
    heads = "".join(_head(text, i > 0) for i, text in enumerate(matrix.header()))
    body = [
        f'<tr data-name="{html.escape(row.name)}"><th scope="row">{html.escape(row.label)}</th>'
        f"{''.join(map(_matrix_cell, row.cells))}</tr>"
        for row in matrix.rows
    ]
    environment = html.escape(matrix.benchmark.env_id)
    return (
        f'<div data-environment="{environment}"><p class="note">{environment}: {html.escape(matrix.describe())}</p>\n'
        f'<div class="scroll" tabindex="0" role="region" aria-label="Generalisation in {environment}">'
        f'<table class="matrix"><thead><tr>{heads}</tr></thead><tbody>\n' + "\n".join(body) + "\n"
        "</tbody></table></div></div>"
    )


def _matrix_cell(cell: Cell | None) -> str:
    if cell is None:
        return "<td></td>"
    small = f"<small>{worst_text(cell)}</small>"
    if cell.score is None:
        return f'<td class="number">{small}</td>'
    above = cell.score.value - 100.0
    shade = min(1.0, above / ((_DEEPEST_ABOVE if above > 0.0 else _DEEPEST_BELOW) - 100.0))
    side = "more" if above > 0.0 else "less"
    return f'<td class="number {side}" style="--shade: {shade:.2f}">{score_text(cell)} {small}</td>'


def _head(name: str, is_number: bool) -> str:
    # A long word may break, or it would make its column wide.
    text = html.escape(name).replace("(improvement)", "(<wbr>improve<wbr>ment)")
    return f'<th scope="col"{" class=number" if is_number else ""}>{text}</th>'


def _cell(name: str, is_number: bool, text: str, row: EntrySummary) -> str:
    if name == "entry":
        return f'<th scope="row">{html.escape(text)}</th>'
    if name == _GAP and row.gap_closed_percent is not None:
        share = min(row.gap_closed_percent.value, 100.0)
        return f'<td class="number share" style="--share: {share:.1f}%">{_number(text)}</td>'
    return f'<td class="number">{_number(text)}</td>' if is_number else f"<td>{html.escape(text)}</td>"


def _number(text: str) -> str:
    """Return a number, with its interval in brackets in an element of its own."""
    value, space, brackets = text.partition(" ")
    return value if not space else f"{value} <small>{html.escape(brackets)}</small>"


def _fresh_cells(gap: GeneralisationGap | None) -> str:
    fresh = "" if gap is None else f"{gap.fresh.value:.1f}"
    excess = "" if gap is None or gap.excess is None else signed_interval(gap.excess)
    return f'<td class="number">{fresh}</td><td class="number">{_number(excess)}</td>'
