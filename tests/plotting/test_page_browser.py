"""The leaderboard's page as a browser shows it, headless and without a network."""

from __future__ import annotations

import csv
import io
import json
import re
import time
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.plotting.pages import (
    DURATION_S,
    HOSTILE,
    OTHER_SENSORS,
    both_page,
    both_results,
    small_page,
    small_results,
    wide_page,
)
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, leaderboard_rows
from wtg_gym.evaluation.leaderboard import columns_of
from wtg_gym.evaluation.recording import record
from wtg_gym.plotting.front import support_points, undominated
from wtg_gym.scenarios import get_suite

pytest.importorskip("bokeh", reason="the page's charts are Bokeh's")
pytest.importorskip("playwright.sync_api", reason="a browser is driven by playwright")

#: Width of a scroll bar, which a page in a window has less [px].
SCROLL_BAR = 15
LAPTOP, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}


class Opened:
    """The page in a browser, and all that it asked for and complained about."""

    def __init__(self, browser: Any, path: Path, *, state: str = "", **settings: Any) -> None:
        context = browser.new_context(offline=True, **settings)
        self.page = context.new_page()
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._hear)
        self.url = path.as_uri()
        self.page.goto(self.url + state)
        self.page.wait_for_selector("html[data-ready=yes]", state="attached")

    def _hear(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def wait_until(self, condition: str) -> None:
        """Wait for a condition in JavaScript; the page's policy keeps the driver's own way of doing so from it."""
        until = time.monotonic() + 10.0
        while not self.page.evaluate(condition):
            assert time.monotonic() < until, condition
            time.sleep(0.02)

    def middle(self, selector: str) -> tuple[float, float, float]:
        """Bring a chart into view, and return where its middle is and how wide it is."""
        canvas = self.page.locator(f"{selector} canvas").first
        canvas.evaluate("(element) => element.scrollIntoView({block: 'center', behavior: 'instant'})")
        box = canvas.bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, box["width"]

    def column(self, name: str) -> list[float | None]:
        """Return a column of the traces that are drawn, None for "no value"."""
        values: list[float | None] = self.page.evaluate(
            """(name) => {
                for (const root of Bokeh.documents[0].roots())
                    for (const renderer of root.renderers)
                        if (renderer.data_source.name === "traces")
                            return [...renderer.data_source.data[name]].map((x) => (Number.isFinite(x) ? x : null));
            }""",
            name,
        )
        return values

    def state(self) -> dict[str, str]:
        """Return what the address holds, once it is written.

        The page writes it 300 ms after the last change. The wait runs in the page, so that a slow machine delays both.
        """
        self.page.evaluate("new Promise((done) => setTimeout(done, 500))")
        return dict(urllib.parse.parse_qsl(self.page.evaluate("location.hash").removeprefix("#")))

    def line(self, name: str, column: str) -> list[float]:
        """Return the first of a chart's lines."""
        return [float(value) for value in self.source(name, column)[0]]

    def source(self, name: str, column: str) -> list[Any]:
        """Return a column of a chart's data."""
        values: list[Any] = self.page.evaluate(
            """([name, column]) => {
                for (const root of Bokeh.documents[0].roots())
                    for (const renderer of root.renderers)
                        if (renderer.data_source.name === name) return [...renderer.data_source.data[column]]
                                .map((x) => (typeof x === "object" ? [...x] : x));
            }""",
            [name, column],
        )
        return values

    def names(self) -> list[str]:
        """Return the names in the rows of the ranking that are seen, from top to bottom."""
        rows = self.page.locator("table[data-suite]:visible tbody tr:visible")
        found: list[str] = rows.evaluate_all("(rows) => rows.map((row) => row.dataset.name)")
        return found

    def value(self, row: str) -> list[str]:
        """Return the two numbers of a row of the table at the cursor."""
        cells: list[str] = (
            self.page.locator("#values tr", has=self.page.get_by_role("rowheader", name=row))
            .locator("td")
            .all_inner_texts()
        )
        return cells

    def check(self) -> None:
        """Nothing was asked for, nothing went wrong, no text of an entry was run."""
        asked = {url.split("#")[0] for url in self.requests}
        assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {self.url}
        assert self.complaints == []
        assert self.page.evaluate("window.hacked") is None
        assert self.page.locator("img").count() == 0


@pytest.fixture
def open_page(browser: Any, tmp_path: Path) -> Iterator[Any]:
    path = tmp_path / "leaderboard.html"
    path.write_text(small_page(), encoding="utf-8")
    opened: list[Opened] = []

    def opening(**settings: Any) -> Opened:
        opened.append(Opened(browser, path, **{"viewport": LAPTOP, **settings}))
        return opened[-1]

    yield opening
    for each in opened:
        each.check()
        each.page.context.close()


@pytest.mark.parametrize("viewport", [{"width": 320, "height": 640}, PHONE, LAPTOP, {"width": 2560, "height": 1440}])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_fits_and_follows_the_colour_scheme(open_page: Any, viewport: dict[str, int], scheme: str) -> None:
    opened = open_page(viewport=viewport, color_scheme=scheme)
    page = opened.page
    assert page.evaluate("document.documentElement.scrollWidth") == viewport["width"]
    red = int(re.findall(r"\d+", page.evaluate("getComputedStyle(document.body).backgroundColor"))[0])
    assert (red > 200) == (scheme == "light")
    for chart in ("ranking", "profile", "physical", "grid", "panel-frequency", "panel-wind"):
        box = page.locator(f"#{chart} canvas").first.bounding_box()
        assert box["width"] > 0.3 * min(viewport["width"], 1500) and box["height"] > 80
    page.emulate_media(color_scheme="dark" if scheme == "light" else "light")
    opened.wait_until(f"!getComputedStyle(document.body).backgroundColor.startsWith('rgb({red},')")


def test_no_column_of_the_ranking_is_clipped_on_a_small_laptop(browser: Any, tmp_path: Path) -> None:
    # With every column that there can be, those of fresh scenarios too, and names and numbers as long as real ones.
    path = tmp_path / "wide.html"
    path.write_text(wide_page(), encoding="utf-8")
    page = Opened(browser, path, viewport={"width": 1366 - SCROLL_BAR, "height": 768}).page
    heads = page.locator("table[data-suite]:visible thead th")
    assert heads.count() == len(columns_of("v0")) + 2
    edge = heads.last.evaluate("(head) => head.getBoundingClientRect().right")
    assert edge <= page.locator(".scroll:has(table[data-suite])").evaluate("(box) => box.getBoundingClientRect().right")
    page.context.close()


def test_a_phone_shows_name_and_score_without_scrolling_sideways(open_page: Any) -> None:
    page = open_page(viewport=PHONE).page
    heads = page.locator("table[data-suite]:visible thead th")
    seen = heads.evaluate_all(
        "(heads, width) => heads.filter((head) => head.getBoundingClientRect().right <= width)"
        ".map((head) => head.textContent)",
        PHONE["width"],
    )
    assert seen[:3] == ["rank", "entry", "score"]
    scores = page.locator("table[data-suite]:visible tbody tr > :nth-child(3)")
    assert scores.evaluate_all(
        "(cells, width) => cells.every((cell) => cell.scrollWidth <= cell.clientWidth &&"
        " cell.getBoundingClientRect().right <= width)",
        PHONE["width"],
    )


@pytest.fixture
def open_both(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """The page of both versions."""
    path = tmp_path / "both.html"
    path.write_text(both_page(), encoding="utf-8")
    opened: list[Opened] = []

    def opening(**settings: Any) -> Opened:
        opened.append(Opened(browser, path, **{"viewport": LAPTOP, **settings}))
        return opened[-1]

    yield opening
    for each in opened:
        each.check()
        each.page.context.close()


def _span(opened: Opened, chart: str, name: str) -> float:
    """Return where a line across a chart is."""
    place: float = opened.page.evaluate(
        "([chart, name]) => Bokeh.documents[0].get_model_by_name(chart).center.find((each) => each.name === name)"
        ".location",
        [chart, name],
    )
    return place


def test_each_version_has_its_own_scale_matrix_and_limits(open_both: Any) -> None:
    opened = open_both()
    page = opened.page
    label = "Bokeh.documents[0].get_model_by_name('ranking').below[0].axis_label"
    assert page.locator("#suite optgroup").evaluate_all("(groups) => groups.map((group) => group.label)") == [
        "GFMWTG-14bus-v1",
        "GFMWTG-14bus-v0",
    ]
    assert page.evaluate(label) == "score: 0 is coordinated-piecewise, 100 is coordinated-tuned"
    assert page.locator("table.matrix:visible thead th").all_inner_texts() == [
        "entry",
        "standard",
        "paper",
        *(f"standard, {text}" for text in OTHER_SENSORS),
    ]
    assert _span(opened, "panel-power", "limit-0") == 1.05
    # A and B are marked in the matrix as in the ranking.
    b = page.locator("table.matrix:visible tr.b")
    assert b.count() == 1 and b.get_attribute("data-name") == "coordinated-tuned" == page.input_value("#b")
    page.select_option("#suite", label="paper (2 scenarios)")
    opened.wait_until(f"{label} === 'score: 0 is mppt, 100 is coordinated-piecewise'")
    assert page.locator("table.matrix:visible thead th").all_inner_texts() == ["entry", "standard", "paper"]
    assert _span(opened, "panel-power", "limit-0") == 1.1
    assert "the τ of coordinated-piecewise" in page.inner_text("#rules")


def test_front_joins_the_entries_that_no_other_one_beats(open_both: Any) -> None:
    opened = open_both()
    (results,) = [each for each in both_results() if each.name == "standard-v1-validation" and len(each.entries) > 3]
    best = undominated(results.summaries)
    assert 1 < len(best) < len(results.summaries)
    assert opened.source("front-line", "x") == pytest.approx([row.mean_energy_share_percent for row in best], abs=1e-4)
    assert opened.source("front-line", "y") == pytest.approx([support_points(row) for row in best], abs=1e-2)
    drawn = [name for kind in ("law", "feedback") for name in opened.source(f"front-{kind}", "name")]
    filled = [value for kind in ("law", "feedback") for value in opened.source(f"front-{kind}", "fill")]
    assert {name for name, value in zip(drawn, filled, strict=True) if not value} == {
        row.name for row in results.summaries if row.failures_percent > 5.0
    }


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_scrolls_the_matrix_and_not_the_page_and_names_the_scale_below_each_other(
    open_both: Any, scheme: str
) -> None:
    opened = open_both(viewport=PHONE, color_scheme=scheme)
    page = opened.page
    assert page.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
    box = page.locator(".scroll:has(table.matrix:visible)")
    assert box.evaluate("(box) => box.scrollWidth > box.clientWidth")
    # Name and first score are seen at once; the name stays when the rest is scrolled to.
    first = page.locator("table.matrix:visible tbody tr").first
    assert first.locator("td").first.evaluate("(cell) => cell.getBoundingClientRect().right") <= PHONE["width"]
    left = first.locator("th").evaluate("(cell) => cell.getBoundingClientRect().left")
    box.evaluate("(box) => { box.scrollLeft = box.scrollWidth; }")
    assert first.locator("th").evaluate("(cell) => cell.getBoundingClientRect().left") == left
    label = page.evaluate("Bokeh.documents[0].get_model_by_name('ranking').below[0].axis_label")
    assert label.split("\n") == ["score", "0 is coordinated-piecewise", "100 is coordinated-tuned"]


def test_filters_leave_out_entries(open_page: Any) -> None:
    page = open_page().page
    rows = page.locator("table[data-suite=standard] tbody tr:visible")
    assert rows.count() == 4
    page.get_by_label("learned").uncheck()
    assert rows.count() == 3 and page.locator("#shown").inner_text() == "3 of 4 entries shown."
    page.get_by_label("learned").check()
    page.get_by_label("Action").select_option("k+tau")
    assert rows.all_inner_texts()[0].split("\t")[1] == HOSTILE and rows.count() == 1
    page.get_by_label("Action").select_option("tau")
    assert rows.count() == 0
    page.get_by_label("Action").select_option("")
    page.get_by_label("Suite").select_option("1")
    assert page.locator("table[data-suite=paper] tbody tr:visible").count() == 3
    assert page.locator("table[data-suite=standard]").is_hidden()


def test_traces_of_two_entries_side_by_side(open_page: Any) -> None:
    opened = open_page()
    page = opened.page
    page.get_by_label("Compare A").select_option("deloaded-10")
    page.get_by_label("with B").select_option("coordinated-piecewise")
    page.get_by_role("button", name="Next").click()
    opened.wait_until("document.getElementById('facts').textContent.includes('20001')")
    scenarios = get_suite("standard").scenarios([20_001], n_turbines=[10.0, 10.0], duration_s=DURATION_S)
    for side, name in (("a", "deloaded-10"), ("b", "coordinated-piecewise")):
        own = record(Entry(name=name, strategy=name), EnvSettings(duration_s=DURATION_S, version="v0"), scenarios)
        shown = opened.column(f"{side}-frequency-0")
        assert shown == pytest.approx(own.frequency_hz[0, ::2].tolist(), abs=5e-4)
        ratio = opened.column(f"{side}-ratio-1")
        assert ratio == pytest.approx(own.tip_speed_ratio[0, ::2, 1].tolist(), abs=0.02)
    # MPPT and deloading have no damping, so no τ.
    assert set(opened.column("a-tau-0")) == {None}


def test_hovered_names_stay_texts(open_page: Any) -> None:
    opened = open_page()
    x, y, width = opened.middle("#ranking")
    shown: set[str] = set()
    for row in range(-60, 61, 6):
        for column in range(-10, 25):
            opened.page.mouse.move(x + 0.02 * column * width, y + row)
            shown.update(opened.page.locator(".bk-tooltip-content:visible").all_inner_texts())
        if any("onerror" in text for text in shown):
            break
    # check() looks for what the name would have made.
    assert any('<img src="https://example.org/x"' in text for text in shown), shown


def test_cursor_moves_by_keyboard_and_pointer(open_page: Any) -> None:
    opened = open_page()
    page = opened.page
    slider = page.get_by_label("Cursor")
    slider.focus()
    page.keyboard.press("Home")
    assert page.locator("#now").inner_text() == "0.0 s"
    first = opened.value("frequency [Hz]")
    page.keyboard.press("ArrowRight")
    assert page.locator("#now").inner_text() == "0.2 s"
    page.keyboard.press("End")
    assert page.locator("#now").inner_text() == f"{DURATION_S:.1f} s" and opened.value("frequency [Hz]") != first
    x, y, _ = opened.middle("#panel-rotor")
    page.mouse.move(x, y)
    opened.wait_until("Math.abs(Number(document.getElementById('time').value) - 6) < 1.5")


def test_zoom_is_shared_by_all_panels(open_page: Any) -> None:
    opened = open_page()
    page = opened.page
    ends = "Bokeh.documents[0].roots().filter((r) => r.name.startsWith('panel')).map((r) => r.x_range.end)"
    assert set(page.evaluate(ends)) == {DURATION_S}
    x, y, width = opened.middle("#panel-power")
    page.mouse.move(x - 0.2 * width, y)
    page.mouse.down()
    page.mouse.move(x + 0.1 * width, y, steps=4)
    page.mouse.up()
    opened.wait_until(f"{ends}[0] < {DURATION_S}")
    zoomed = page.evaluate(ends)
    assert len(set(zoomed)) == 1 and 4.0 < zoomed[0] < 9.0
    page.get_by_role("button", name="Whole run").click()
    assert set(page.evaluate(ends)) == {DURATION_S}


def test_everything_is_reached_by_keyboard_in_order(open_page: Any) -> None:
    page = open_page().page
    reached = []
    while not reached or reached[-1] != "run":
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id || document.activeElement.textContent.trim()"))
        outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
        assert outline == "solid", reached
        assert len(reached) < 60, reached
    order = ["Skip to the traces", "suite", "find", "action", "a", "b", "Profile as a table", "rank", "score", "csv"]
    order += ["What the columns mean", "Every scenario as a table", "scenario", "previous", "next", "whole", "time"]
    places = [reached.index(name) for name in order]
    assert places == sorted(places)
    names = "[...document.querySelectorAll('select, input, button')].filter((e) => !e.labels?.length && !e.textContent)"
    assert page.evaluate(f"{names}.length") == 0
    assert page.evaluate("[...document.querySelectorAll('[role=img]')].filter((e) => !e.ariaLabel).length") == 0


def test_controls_are_large_enough_to_hit(open_page: Any) -> None:
    page = open_page(viewport=PHONE).page
    small = page.evaluate(
        """[...document.querySelectorAll("a:not(.skip), button, select, input, summary")].filter((e) => e.offsetParent)
            .map((e) => [e.id || e.textContent, (e.labels?.[0] ?? e).getBoundingClientRect()])
            .filter(([, box]) => box.width < 24 || box.height < 24).map(([name]) => name)"""
    )
    assert small == []


def test_skip_link_leads_to_the_traces_and_leaves_the_state_alone(open_page: Any) -> None:
    opened = open_page(state="#suite=standard&a=mppt")
    page = opened.page
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "drill"
    assert page.get_by_label("Compare A").input_value() == "mppt"


def test_address_holds_what_is_seen(open_page: Any) -> None:
    opened = open_page()
    page = opened.page
    page.get_by_label("Compare A").select_option(HOSTILE)
    page.get_by_label("with B").select_option("mppt")
    page.locator("#scenario").select_option("2")
    page.get_by_label("feedback").uncheck()
    page.get_by_label("Action").select_option("k+tau")
    page.get_by_label("Name").fill("script")
    page.get_by_role("button", name="mean pinned cost").click()
    page.get_by_label("Limits in view").check()
    opened.wait_until("document.getElementById('facts').textContent.includes('20002')")
    page.get_by_label("Cursor").fill("7.4")
    state = opened.state()
    expected = {"suite": "standard", "a": HOSTILE, "b": "mppt", "scenario": "20002", "t": "7.4", "limits": "on"}
    assert state == expected | {
        "kind": "law,learned",
        "action": "k+tau",
        "find": "script",
        "sort": "mean pinned cost,down",
    }
    again = open_page(state=f"#{urllib.parse.urlsplit(page.url).fragment}")
    again.wait_until("document.getElementById('facts').textContent.includes('20002')")
    assert again.page.locator("#lost").inner_text() == "" and again.names() == [HOSTILE]
    assert again.page.locator("#now").inner_text() == "7.4 s"
    again.page.get_by_role("button", name="Next").click()
    assert again.state()["scenario"] == "20000"


@pytest.mark.parametrize(
    ("state", "lost"),
    [
        ("#suite=none&a=nobody&t=soon&kind=magic&sort=luck,down&action=hope", "suite “none”, a “nobody”"),
        ("#scenario=<img src=x onerror=hacked>&b=%E0%A4%A", "scenario “<img src=x onerror=hacked>”"),
        ("#t=1e9&limits=maybe", "t “1e9”, limits “maybe”"),
        ("#%%%&&==&suite", "suite “”"),
    ],
)
def test_nonsense_in_the_address_is_said_and_left_aside(open_page: Any, state: str, lost: str) -> None:
    opened = open_page(state=state)
    page = opened.page
    assert lost in page.locator("#lost").inner_text()
    assert len(opened.names()) == 4 and page.locator("#traces").is_visible()
    assert page.get_by_label("with B").input_value() == "coordinated-piecewise"


def test_address_typed_into_an_open_page_is_followed(open_page: Any) -> None:
    opened = open_page()
    opened.page.evaluate("location.hash = '#suite=paper&a=deloaded-10'")
    opened.wait_until("document.getElementById('about').textContent.startsWith('paper')")
    assert opened.page.get_by_label("Compare A").input_value() == "deloaded-10"


def test_table_is_sorted_by_any_column(open_page: Any) -> None:
    opened = open_page()
    page = opened.page
    table = page.locator("table[data-suite=standard]")
    ranked = opened.names()
    for name, is_number in columns_of("v0").items():
        button = table.get_by_role("button", name=name, exact=True)
        if not button.count():
            continue
        cell = 1 + list(table.locator("thead th").all_inner_texts()).index(button.inner_text())
        for press, way in enumerate(("descending", "ascending") if is_number and name != "rank" else ("ascending",)):
            button.focus()
            page.keyboard.press("Enter" if press else "Space")
            assert table.locator("th[aria-sort]").get_attribute("aria-sort") == way
            texts = table.locator(f"tbody tr > :nth-child({cell})").evaluate_all(
                "(all) => all.map((e) => e.textContent)"
            )
            # What is missing comes last in either order.
            there = [text for text in texts if text]
            assert texts[: len(there)] == there, name
            values = [float(text.split()[0]) for text in there] if is_number else [text.lower() for text in there]
            if name != "entry":
                assert values == sorted(values, reverse=way == "descending"), name
    assert sorted(opened.names()) == sorted(ranked)
    assert page.locator("th[aria-sort]").count() == 1


def test_profile_is_the_share_of_scores_above(open_page: Any) -> None:
    opened = open_page()
    rows = {row.name: row for row in leaderboard_rows(small_results()[1][0])}
    x, b = opened.line("profile-b", "xs"), opened.line("profile-b", "ys")
    assert rows["coordinated-piecewise"].score.value == 100.0
    assert [share for s, share in zip(x, b, strict=True) if s < 100.0] == [1.0] * x.index(100.0)
    assert set(b[x.index(100.0) :]) == {0.0}


def test_differences_of_two_entries_are_seen_and_chosen(open_page: Any) -> None:
    opened = open_page(state="#a=mppt&b=deloaded-10")
    page = opened.page
    seeds, gains = opened.source("gains-traced", "seed"), opened.source("gains-traced", "y")
    assert gains == sorted(gains, reverse=True) and sorted(seeds) == ["20000", "20001", "20002"]
    assert opened.source("gains-shown", "seed") == ["20000"]
    better = sum(gain > 0 for gain in gains)
    assert f"A is better in {better} of 3 scenarios" in page.locator("#verdict").inner_text()
    wanted = next(place for place, seed in enumerate(seeds) if seed != "20000")
    x, y, width = opened.middle("#compare")
    # The frame begins after the axis and ends before the border.
    page.mouse.click(x - width / 2 + 58 + (width - 72) * (wanted + 1) / 4, y)
    opened.wait_until(f"document.getElementById('facts').textContent.includes('{seeds[wanted]}')")
    assert opened.source("gains-shown", "seed") == [seeds[wanted]]
    page.get_by_text("Every scenario as a table").click()
    # A browser tells of an opened part a little later.
    opened.wait_until("document.querySelectorAll('#gains tbody tr').length === 3")
    page.get_by_role("button", name="Show scenario 20000").click()
    opened.wait_until("document.getElementById('facts').textContent.includes('20000')")


def test_limits_are_brought_into_view(open_page: Any) -> None:
    opened = open_page()
    top = "Bokeh.documents[0].roots().find((r) => r.name === 'panel-power').y_range.end"
    assert opened.page.evaluate(top) < 1.1
    opened.page.get_by_label("Limits in view").check()
    assert opened.page.evaluate(top) > 1.1
    assert "converter's limit (1.1 p.u.)" in opened.page.locator("#rules").inner_text()


@pytest.mark.parametrize(("link", "kind"), [("CSV", "csv"), ("JSON", "json")])
def test_ranking_is_downloaded(open_page: Any, tmp_path: Path, link: str, kind: str) -> None:
    opened = open_page()
    with opened.page.expect_download() as download:
        opened.page.get_by_role("link", name=link, exact=True).click()
    assert download.value.suggested_filename == f"wtg_gym-standard.{kind}"
    path = tmp_path / "download"
    download.value.save_as(path)
    text = path.read_text(encoding="utf-8")
    rows = list(csv.DictReader(io.StringIO(text))) if kind == "csv" else json.loads(text)["entries"]
    assert [row["name"] for row in rows] == opened.names()
    for row, own in zip(rows, leaderboard_rows(small_results()[1][0]), strict=True):
        assert float(row["score"]) == pytest.approx(own.score.value, abs=0.01)
        assert float(row["mean_pinned_cost"]) == pytest.approx(own.mean_pinned_cost, abs=1e-4)


def test_a_finger_on_a_chart_scrolls_the_page(open_page: Any) -> None:
    page = open_page(viewport=PHONE, has_touch=True, is_mobile=True).page
    assert page.evaluate(
        "Bokeh.documents[0].roots().every((r) => !r.toolbar.active_drag || r.toolbar.active_drag === 'auto')"
    )


def test_without_javascript_the_table_is_there(browser: Any, tmp_path: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    path = tmp_path / "plain.html"
    path.write_text(small_page(), encoding="utf-8")
    page.goto(path.as_uri())
    assert page.locator("table[data-suite=standard] tbody tr").count() == 4
    assert page.locator("table[data-suite=standard]").is_visible()
    context.close()


def test_a_browser_without_what_the_charts_need_shows_the_tables_and_says_so(browser: Any, tmp_path: Path) -> None:
    path = tmp_path / "old.html"
    path.write_text(small_page(), encoding="utf-8")
    context = browser.new_context()
    context.add_init_script("delete window.DecompressionStream")
    page = context.new_page()
    page.goto(path.as_uri())
    assert "too old for the charts" in page.get_by_role("alert").inner_text()
    assert page.locator("table[data-suite]:visible").count() == 2
    assert page.locator("form, .chart").first.is_hidden()
    context.close()
