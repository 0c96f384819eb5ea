"""The leaderboard's page as a text: its content, and nothing that could run or load."""

from __future__ import annotations

import base64
import dataclasses
import functools
import json
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.calls import error_of
from tests.plotting.pages import (
    DURATION_S,
    HOSTILE,
    OTHER_SENSORS,
    SEEDS,
    TRACED,
    both_page,
    both_results,
    results_of_v1,
    small_page,
    small_results,
)
from wtg_gym.cli import main
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, NoScaleError, evaluate, leaderboard_rows, load_entries
from wtg_gym.evaluation.matrix import matrix_of
from wtg_gym.evaluation.recording import record
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.tracking_law import get_law
from wtg_gym.plotting.page import figures, leaderboard_page, untraced
from wtg_gym.plotting.page.data import SCORE_RESOLUTION
from wtg_gym.plotting.page.packing import MISSING, RESOLUTIONS, packed, quantised
from wtg_gym.scenarios import draw_seeds, get_suite
from wtg_gym.scenarios.benchmark import V1

pytest.importorskip("bokeh", reason="the page's charts are Bokeh's")
#: Attributes that a browser loads from.
_LOADING = ("action", "background", "data", "formaction", "href", "poster", "src", "srcset", "xlink:href")


class _Tags(HTMLParser):
    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, str] = {}
        self._inside: str | None = None
        self.feed(page)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attributes)))
        self._inside = dict(attributes).get("id") if tag == "script" else None

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.texts[self._inside] = self.texts.get(self._inside, "") + data


@functools.cache
def _charts_made_once() -> Any:
    made = functools.cache(figures.page_document)
    return lambda n_groups, metric_labels: made(n_groups, tuple(metric_labels))


@pytest.fixture(autouse=True)
def _same_charts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the empty charts, which take most of a page's time, once for all pages but those that are compared."""
    if request.function is not test_the_same_page_twice:
        monkeypatch.setattr(figures, "page_document", _charts_made_once())


def _unpacked(text: str, n_rows: int) -> Any:
    """Return the rows that `packed` packed, as the script of the page does."""
    low, high = np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8).reshape(2, n_rows, -1)
    folded = low.astype(np.uint16) | (high.astype(np.uint16) << 8)
    differences = (folded >> 1) ^ -(folded & 1)
    table: Any = np.cumsum(differences, axis=1, dtype=np.uint16).view(np.int16)
    return table


def _data(page: str) -> Any:
    return json.loads(_Tags(page).texts["data"])


def test_numbers_survive_packing() -> None:
    rng = np.random.default_rng(1)
    table = rng.integers(-32768, 32768, size=(7, 31)).astype(np.int16)
    assert (_unpacked(packed(table), 7) == table).all()
    steps = quantised(np.array([0.0, 0.26, -1.0, np.nan, np.inf, 1e9, -1e9]), 0.5)
    assert steps.tolist() == [0, 1, -2, MISSING, MISSING, 32767, -32767]


def test_ranking_is_that_of_the_leaderboard() -> None:
    _, results = small_results()
    for suite, each in zip(_data(small_page())["suites"], results, strict=True):
        rows = leaderboard_rows(each)
        assert [entry["score"][0] for entry in suite["entries"]] == [round(row.score.value, 2) + 0.0 for row in rows]
        assert [entry["kind"] for entry in suite["entries"]] == [row.kind for row in rows]
        assert [entry["rank"] for entry in suite["entries"]] == list(range(1, len(rows) + 1))


def test_scores_are_those_of_every_run_and_scenario() -> None:
    _, results = small_results()
    suite, rows = _data(small_page())["suites"][0], leaderboard_rows(results[0])
    scores = _unpacked(suite["scores"], len(rows)) * SCORE_RESOLUTION
    assert scores.shape == (len(rows), len(SEEDS)) and suite["seeds"] == list(SEEDS)
    for own, row in zip(scores, rows, strict=True):
        assert own.mean() == pytest.approx(row.score.value, abs=SCORE_RESOLUTION)


def test_differences_have_the_interval_of_the_score_where_the_reference_is_subtracted() -> None:
    # The reference has 100 in every scenario, so that only the score varies.
    _, results = small_results()
    rows = leaderboard_rows(results[0])
    lower = _unpacked(_data(small_page())["suites"][0]["differences"], len(rows)) * SCORE_RESOLUTION
    reference = [row.name for row in rows].index("coordinated-piecewise")
    for place, row in enumerate(rows):
        low, high = lower[place, reference], -lower[reference, place]
        assert (low, high) == pytest.approx((row.difference.low, row.difference.high), abs=SCORE_RESOLUTION)
        assert lower[place, place] == 0.0


def test_equal_scores_share_a_rank() -> None:
    entries, (_, paper) = small_results()
    twin = dataclasses.replace(
        paper,
        entries=(*paper.entries, *({**data, "name": "twin"} for data in paper.entries if data["name"] == "mppt")),
        episodes=(*paper.episodes, *(dataclasses.replace(e, entry="twin") for e in paper.episodes_of("mppt"))),
    )
    page = leaderboard_page([twin], entries, n_scenarios=0)
    rank = {entry["name"]: entry["rank"] for entry in _data(page.text)["suites"][0]["entries"]}
    assert rank["mppt"] == rank["twin"] and page.n_traced == {"paper": 0}


def test_traces_are_the_recordings_to_their_resolution() -> None:
    data = _data(small_page())
    suite = data["suites"][0]
    assert sorted(suite["traced"]) == sorted(TRACED)
    scenarios = get_suite("standard").scenarios([20_001], n_turbines=[10.0, 10.0], duration_s=DURATION_S)
    own = record(
        Entry(name="deloaded-10", strategy="deloaded-10"), EnvSettings(duration_s=DURATION_S, version="v0"), scenarios
    )
    shown = suite["scenarios"][1]
    n_rows = 2 + len(suite["traced"]) * (1 + 2 * (len(RESOLUTIONS) - 1))
    rows = _unpacked(shown["packed"], n_rows)
    assert rows.shape[1] == shown["n"] == round(DURATION_S / shown["step"]) + 1
    first = 2 + suite["traced"].index("deloaded-10") * (n_rows - 2) // len(suite["traced"])
    expected = own.frequency_hz[0, ::2] - data["nominal"]
    assert np.abs(rows[first] * RESOLUTIONS["frequency"] - expected).max() <= RESOLUTIONS["frequency"]
    rotor = rows[first + 3 : first + 5] * RESOLUTIONS["rotor"]
    assert np.abs(rotor.T - own.rotor_speed_pu[0, ::2]).max() <= RESOLUTIONS["rotor"]
    assert data["tip_speed"] == TurbineParameters().tip_speed_ratio_per_speed_m_s


def test_hostile_texts_stay_texts() -> None:
    tags = _Tags(small_page())
    assert "img" not in {tag for tag, _ in tags.tags}
    assert sum(tag == "script" for tag, _ in tags.tags) == small_page().count("<script")
    assert HOSTILE not in small_page()
    assert HOSTILE in [entry["name"] for entry in _data(small_page())["suites"][0]["entries"]]
    assert HOSTILE in [attributes.get("data-name") for _, attributes in tags.tags]


def test_nothing_is_loaded() -> None:
    for tag, attributes in _Tags(small_page()).tags:
        loaded = {key: value for key, value in attributes.items() if key in _LOADING}
        assert tag != "link" and (not loaded or loaded == {"href": "#drill"})
    assert not re.search(r"@import|url\(", small_page().split("</style>")[0])
    policy = next(a["content"] for _, a in _Tags(small_page()).tags if a.get("http-equiv"))
    assert policy is not None and "default-src 'none'" in policy and "http" not in policy
    assert "unsafe" not in policy.split("style-src")[0]


def test_the_same_page_twice() -> None:
    entries, (_, paper) = small_results()
    pages = [leaderboard_page([paper], entries, n_scenarios=1) for _ in range(2)]
    assert pages[0] == pages[1]
    assert pages[0].size == len(pages[0].text.encode()) < 1_500_000


def test_a_page_without_traces_holds_the_scores_all_the_same() -> None:
    _, (standard, _) = small_results()
    suite = _data(leaderboard_page([standard], [], n_scenarios=0).text)["suites"][0]
    assert suite["scenarios"] == [] and _unpacked(suite["scores"], len(suite["entries"])).shape[1] == len(SEEDS)


def test_traces_are_left_out_of_a_file_that_would_grow_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    entries, (standard, _) = small_results()
    full = leaderboard_page([standard], entries)
    assert full.n_traced == {"standard": len(SEEDS)}
    monkeypatch.setattr("wtg_gym.plotting.page.html.SIZE_LIMIT", full.size - 1)
    less = leaderboard_page([standard], entries)
    assert less.n_traced == {"standard": len(SEEDS) - 1} and less.size < full.size
    assert leaderboard_page([standard], entries, n_scenarios=len(SEEDS)) == full


def test_results_of_another_source_code_get_no_traces() -> None:
    entries, (_, paper) = small_results()
    old = dataclasses.replace(paper, source_hash="0" * 64)
    with pytest.raises(ValueError, match="of another source code"):
        leaderboard_page([old], entries)
    assert _data(leaderboard_page([old], [], n_scenarios=0).text)["suites"][0]["scenarios"] == []
    with pytest.raises(ValueError, match="one of each suite"):
        leaderboard_page([paper, paper], entries)


def test_entries_that_have_changed_are_not_traced() -> None:
    entries, results = small_results()
    assert untraced(results, entries) == []
    other = Entry(name="deloaded-10", strategy="deloaded-5")
    assert untraced(results, [other]) == ["deloaded-10", "full"]


def test_commands_write_the_page(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    laws = ("--entries", "mppt", "deloaded-5")
    page, again = tmp_path / "leaderboard.html", tmp_path / "again.html"
    assert main(["leaderboard", "--suite", "paper", *laws, "--results", str(tmp_path), "--html", str(page)]) == 0
    said = capsys.readouterr().err
    assert f"wrote {page}" in said and "MB; scenarios with traces: paper 2" in said
    assert main(["results", "page", str(tmp_path / "paper-test.json"), *laws, "--output", str(again)]) == 0
    assert again.read_bytes() == page.read_bytes()
    assert (
        main(["results", "page", str(tmp_path / "paper-test.json"), "--entries", "mppt", "--output", str(again)]) == 0
    )
    assert "no traces of deloaded-5" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("results", "page", "none.json", "--output", "page.html"), "none.json"),
        (("results", "page", "none.json", "--output", "page.pdf"), "it must end in .html, .htm"),
        (("results", "page", "none.json"), "--output"),
        (("leaderboard", "--suite", "paper", "--html", "missing/page.html"), "there is no folder missing"),
    ],
)
def test_commands_refuse_bad_input(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: Any, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in error_of(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


def _luminance(colour: str) -> float:
    parts = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_have_the_contrast_of_wcag_aa(scheme: str) -> None:
    light, dark = small_page().split("@media (prefers-color-scheme: dark)")
    inks = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", light if scheme == "light" else dark))

    def contrast(one: str, other: str) -> float:
        low, high = sorted((_luminance(inks[one]), _luminance(inks[other])))
        return (high + 0.05) / (low + 0.05)

    for ink in ("ink", "soft", "a", "b", "event", "wind"):
        assert min(contrast(ink, "page"), contrast(ink, "card")) >= 4.5, ink
    assert contrast("ink", "bar") >= 4.5
    # The deepest colours of the matrix, as its rules mix them.
    share = float(re.findall(r"rgb\(var\(--more\) / calc\(([\d.]+) \* var\(--shade\)\)\)", small_page())[0])
    triples = dict(re.findall(r"--(more|less): (\d+ \d+ \d+);", light if scheme == "light" else dark))
    page = [int(inks["page"][place : place + 2], 16) for place in (1, 3, 5)]
    for side in ("more", "less"):
        mixed = zip(map(int, triples[side].split()), page, strict=True)
        inks[side] = "#" + "".join(f"{round(share * one + (1 - share) * other):02x}" for one, other in mixed)
        assert contrast("ink", side) >= 4.5, side
    for ink in ("rest", "edge", "focus"):
        assert contrast(ink, "page") >= 3.0, ink


def test_results_on_fresh_scenarios_are_a_suite_of_their_own_and_columns_of_the_public_ones() -> None:
    entries = [Entry(name=name, strategy=name) for name in ("mppt", "coordinated-linear", "coordinated-piecewise")]
    draw = draw_seeds("standard", "a" * 40, b"a secret for this test", 3)
    public = evaluate(entries, "standard", "test", seeds=SEEDS, duration_s=DURATION_S)
    fresh = evaluate(entries, "standard", "fresh", draw=draw, duration_s=DURATION_S)
    text = leaderboard_page([public, fresh], [], n_scenarios=1).text
    suites = _data(text)["suites"]
    assert [suite["name"] for suite in suites] == ["standard", "standard, fresh"]
    assert suites[1]["seeds"] == list(draw.seeds)
    tables = re.findall(r"<table data-suite.*?</table>", text, flags=re.DOTALL)
    assert ["fresh score" in table for table in tables] == [True, False]
    scores = {row.name: f"{row.score.value:.1f}" for row in leaderboard_rows(fresh)}
    assert f'<td class="number">{scores["coordinated-linear"]}</td><td class="number"></td></tr>' in tables[0]


def test_page_of_v1_names_its_environment_anchors_and_columns() -> None:
    results = results_of_v1()
    page = leaderboard_page([results], load_entries("baselines", benchmark=V1), n_scenarios=1)
    head = page.text[page.text.index("<header>") : page.text.index("</header>")]
    assert "GFMWTG-14bus-v1" in head and "coordinated-tuned" in head and "maximum power" not in head
    assert all(
        f">{name}</th>" in page.text for name in ("failures by kind [%]", "worst decile", "median deviation [mHz]")
    )
    (suite,) = _data(page.text)["suites"]
    assert (suite["zero"], suite["hundred"]) == ("coordinated-piecewise", "coordinated-tuned")
    assert suite["limits"]["power"] == {"the converter's limit": 1.05}
    assert suite["limits"]["tau"] == {
        "the τ of coordinated-tuned": get_law("coordinated-tuned").damping_time_constant_s
    }
    assert sorted(suite["traced"]) == sorted(row.name for row in leaderboard_rows(results))
    assert untraced([results], load_entries("baselines", benchmark=V1)) == []


def test_page_of_two_versions_has_the_later_one_first_each_with_its_own_anchors_and_limits() -> None:
    head = both_page()[both_page().index("<header>") : both_page().index("</header>")]
    assert "<code>GFMWTG-14bus-v1</code> and <code>GFMWTG-14bus-v0</code>" in head
    assert head.index("in v1: 0 is\nthe paper") < head.index("in v0: 0 is\nmaximum power point tracking")
    suites = _data(both_page())["suites"]
    assert [(suite["name"], suite["environment"], suite["zero"], suite["hundred"]) for suite in suites] == [
        ("standard-v1, validation", "GFMWTG-14bus-v1", "coordinated-piecewise", "coordinated-tuned"),
        ("paper", "GFMWTG-14bus-v0", "mppt", "coordinated-piecewise"),
        ("standard", "GFMWTG-14bus-v0", "mppt", "coordinated-piecewise"),
    ]
    limits = [suite["limits"]["power"]["the converter's limit"] for suite in suites]
    assert limits == [1.05, 1.1, 1.1]
    assert "fast-droop" in suites[0]["traced"] and "fast-droop" not in suites[1]["traced"]


def test_matrix_holds_every_column_and_the_ranking_those_with_own_sensors_and_a_scale() -> None:
    tables = dict(re.findall(r'<div data-environment="([^"]*)">(.*?)</table>', both_page(), flags=re.DOTALL))
    heads = {name: re.findall(r'<th scope="col"[^>]*>([^<]*)</th>', table) for name, table in tables.items()}
    assert heads == {
        "GFMWTG-14bus-v1": ["entry", "standard", "paper", *(f"standard, {text}" for text in OTHER_SENSORS)],
        "GFMWTG-14bus-v0": ["entry", "standard", "paper"],
    }
    text = tables["GFMWTG-14bus-v1"]
    assert "No score on paper, where coordinated-tuned (100) is no better than coordinated-piecewise (0)." in text
    cells = re.findall(r"<td.*?</td>", text[text.index('data-name="fast-droop"') :])[:3]
    matrix = matrix_of([each for each in both_results() if each.benchmark is V1])
    (row,) = [row for row in matrix.rows if row.name == "fast-droop"]
    own = [cell for cell in row.cells if cell is not None]
    shade = 1.0 - own[0].score.value / 100.0
    assert cells[0] == (
        f'<td class="number less" style="--shade: {shade:.2f}">{own[0].score.value:.1f} '
        f"<small>{own[0].worst_decile_cost:.0f}</small></td>"
    )
    assert cells[1] == f'<td class="number"><small>{own[1].worst_decile_cost:.0f}</small></td>'
    # One suite alone makes no matrix.
    assert "h-matrix" not in leaderboard_page([both_results()[-4]], [], n_scenarios=0).text
    with pytest.raises(ValueError, match=r"needs results with the suites' own sensors, .* got none"):
        leaderboard_page([both_results()[-1]], [], n_scenarios=0)


def test_results_without_a_scale_alone_say_so() -> None:
    (paper,) = [each for each in both_results() if each.suite == "paper-v1"]
    with pytest.raises(NoScaleError, match="is not worse than coordinated-tuned"):
        leaderboard_page([paper], [], n_scenarios=0)


def test_v0_is_described_as_maximum_power_point_tracking_and_the_reference() -> None:
    assert "Score 0 is\nmaximum power point tracking, 100 the reference strategy; more is better." in small_page()
    assert "worst decile" not in small_page()
