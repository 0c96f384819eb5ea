"""Facts about the ranking; about results and their files: the same bytes again, and nothing damaged is read."""

import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests import changes
from wtg_gym import evaluation, get_suite
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Interval, Results, summary
from wtg_gym.evaluation.adjusted import Adjusted, known_means
from wtg_gym.evaluation.circumstances import environment_fingerprint
from wtg_gym.evaluation.evaluator import departures
from wtg_gym.evaluation.results import markdown_section
from wtg_gym.evaluation.table import columns_of
from wtg_gym.files import sha256, to_json
from wtg_gym.tasks import V0, V1


def test_table_has_the_best_first_and_equal_scores_share_a_rank(results):
    first, second, third = rows = evaluation.leaderboard_rows(results)
    assert first.score.value > second.score.value > third.score.value
    equal = [first, dataclasses.replace(first, name="other"), second, third]
    assert [cells[0] for cells in evaluation.table_cells(equal)] == ["1", "1", "3", "4"]
    lines = evaluation.markdown_table(rows).split("\n")
    assert len(lines) == 2 + 3
    assert [head.strip() for head in lines[0].strip("|").split("|")] == columns_of("v0", rows)
    assert lines[2].startswith("| 1 | coordinated-piecewise | 100.0 | 0.0 | 0.0 | 0.0 | 0.0 | 0.0 | 49.")
    assert "-0.0" not in "".join(lines)


def changed(results: evaluation.Results, changes):
    """Return results in which fast-droop fails only as `changes` of its episodes say, and its row."""
    own = results.episodes_of("fast-droop")
    others = [e for e in results.episodes if e not in own]
    replaced = [dataclasses.replace(e, **{"failure": "", **changes.get(e.seed - 10_000, {})}) for e in own]
    result = dataclasses.replace(results, episodes=(*others, *replaced))
    return result, next(row for row in result.summaries if row.name == "fast-droop")


def test_table_shows_failures_the_worst_tenth_and_deviations(results_v1):
    reasons = ("stall", "frequency limit", "under-speed", "loss of synchronism")
    failed, row = changed(results_v1, {i: {"failure": reason} for i, reason in enumerate(reasons)})
    own = failed.episodes_of("fast-droop")
    assert row.worst_decile_cost == pytest.approx(np.mean(sorted(e.metrics["cost"] for e in own)[-2:]))
    deviations = [1e3 * max(50.0 - e.metrics["nadir_hz"], e.metrics["zenith_hz"] - 50.0) for e in own]
    assert row.median_deviation_mhz == pytest.approx(np.median(deviations))
    local = [1e3 * max(50.0 - e.metrics["worst_nadir_hz"], e.metrics["worst_zenith_hz"] - 50.0) for e in own]
    assert row.median_worst_deviation_mhz == pytest.approx(np.median(local))
    assert all(worst > own for worst, own in zip(local, deviations, strict=True))
    median = f"{np.median(deviations):.0f}"
    for table, column, text in (("details", "failures [%]", "33.3"), ("v1", "median deviation [mHz]", median)):
        columns = columns_of(table, [row])
        assert evaluation.table_cells([row], columns)[0][columns.index(column)] == text


def test_runs_beyond_0_8_hz_count_with_the_lost_and_a_run_counts_once(results_v1):
    extremes = [(49.2, 50.0), (49.199, 50.0), (49.1, 50.0), (49.9, 50.801), *[(49.9, 50.0)] * 8]
    changes = {
        i: {"metrics": {**e.metrics, "nadir_hz": low, "zenith_hz": high}}
        for i, (e, (low, high)) in enumerate(zip(results_v1.episodes_of("fast-droop"), extremes, strict=True))
    }
    for lost in (2, 4):
        changes[lost]["failure"] = "stall"
    _, row = changed(results_v1, changes)
    # 49.199 and 50.801 Hz, the lost one at 49.1 Hz, and the other lost one.
    assert row.n_lost == 2 and row.lost_or_beyond_percent == pytest.approx(100.0 * 4 / 12)


def survived(results: evaluation.Results, **metrics: float):
    """Episodes of the law at 100 without a failure and with other metrics."""
    own = results.episodes_of(V1.hundred)
    return [dataclasses.replace(e, failure="", metrics={**e.metrics, **metrics}) for e in own]


def summaries_of(runs, costs, groups, with_scores: bool):
    entries = [{"name": name, "kind": "law", "observation_mode": "measured"} for name in runs]
    arguments = entries, runs, costs, get_suite("standard-v1"), groups, Adjusted(0.3, groups)
    return summary.summaries(*arguments, with_scores=with_scores)


def test_entries_that_leave_0_8_hz_more_often_than_the_anchor_rank_behind_it(results_v1):
    groups = {"ample": np.arange(0, 12, 2), "short": np.arange(1, 12, 2)}
    quiet = survived(results_v1, nadir_hz=49.9, zenith_hz=50.1)
    lost = [dataclasses.replace(e, failure="frequency limit") for e in quiet]
    # Four scenarios of four may be chance, p = 1 / 16; five are not.
    runs = {V1.zero: [quiet], V1.hundred: [quiet], "wild": [[*lost[:5], *quiet[5:]]], "fine": [[*lost[:4], *quiet[4:]]]}
    base = np.arange(10.0, 22.0)
    factors = {V1.zero: 2.0, V1.hundred: 1.0, "wild": 0.5, "fine": 1.1}
    costs = {name: base[np.newaxis] * factor for name, factor in factors.items()}
    offsets = np.where(np.arange(12) % 2, *(dict(V1.cost_offsets)[name] for name in ("short", "ample")))
    rows = summary.ranked(summaries_of(runs, costs, groups, with_scores=True))
    assert [row.name for row in rows] == [V1.hundred, "fine", V1.zero, "wild"]
    assert [row.marked for row in rows] == [True, True, True, False]
    logs = {name: np.log(own[0] + offsets) for name, own in costs.items()}
    for row in rows:
        gained = logs[V1.hundred] - logs[row.name]
        expected = [100.0 + 100.0 / 0.3 * gained[at].mean() for at in groups.values()]
        assert row.score.value == pytest.approx(np.mean(expected))
        assert list(row.strata) == list(groups)
        assert [own.value for own in row.strata.values()] == pytest.approx(expected)
        assert sum(row.points_by_term.values()) == pytest.approx(row.score.value - 100.0)
    anchor, fine, _, last = rows
    nought = evaluation.Interval(0.0, 0.0, 0.0)
    assert anchor.lost_or_beyond_to_hundred == anchor.worst_decile_to_hundred == nought
    assert fine.worst_decile_to_hundred.value == pytest.approx(10.0)
    assert last.lost_or_beyond_to_hundred.value == pytest.approx(100.0 * 5 / 12)
    heads = columns_of("details", rows)
    assert heads[2:5] == ["score", *groups]
    text = evaluation.markdown_table(rows, heads)
    assert "| 0.0 ✓ | 0.0 | 0.0 |" in text and "| 41.7 | +41.7 (+2.2 … +81.2)" in text
    assert [cells[0] for cells in evaluation.table_cells(rows)] == ["1", "2", "3", "4"]


def test_entries_that_lose_grids_that_the_anchor_only_bends_have_no_mark(results_v1):
    bent = survived(results_v1, nadir_hz=49.1, zenith_hz=50.1)
    lost = [dataclasses.replace(e, failure="frequency limit") for e in bent]
    runs = {V1.hundred: [bent], "loses": [lost], "loses one": [[*lost[:1], *bent[1:]]]}
    costs = {name: np.full((1, 12), 10.0) for name in runs}
    groups = {"ordinary": np.arange(6), "large": np.arange(6, 12)}
    rows = summaries_of(runs, costs, groups, with_scores=False)
    assert [row.lost_or_beyond_to_hundred.value for row in rows] == [0.0, 0.0, 0.0]
    assert [row.marked for row in rows] == [True, False, True]


def test_scores_that_are_not_adjusted_say_why(results_v1):
    few = evaluation.evaluate("fast-droop", "standard-v1", seeds=[10_000, 10_002], duration_s=1.0)
    assert "their mean gains are not known for this suite with these settings" in few.unadjusted
    assert list(few.summaries[0].strata) == ["ample", "tight"] and not few.no_score
    whole = get_suite("standard-v1").duration_s
    own = dataclasses.replace(results_v1, settings={**results_v1.settings, "duration_s": whole})
    assert "they need 30 scenarios of each stratum" in own.unadjusted
    assert f"{own.unadjusted[0].upper()}{own.unadjusted[1:]}." in markdown_section(own)
    assert own.unadjusted in own._repr_markdown_()


def test_scores_of_many_scenarios_are_adjusted(results_v1):
    """Results of the same episodes over and over, as if they were of 96 scenarios of whole length."""
    seeds = range(10_000, 10_096)
    episodes = [
        dataclasses.replace(e, seed=seed)
        for entry in results_v1.entries
        for i, seed in enumerate(seeds)
        for e in [results_v1.episodes_of(entry["name"])[i % 12]]
    ]
    settings = {**results_v1.settings, "duration_s": get_suite("standard-v1").duration_s}
    many = dataclasses.replace(results_v1, seeds=tuple(seeds), episodes=tuple(episodes), settings=settings)
    assert many.unadjusted == "" and many.scores[V1.hundred] == evaluation.Interval(100.0, 100.0, 100.0)
    # A control variate has its known score, and the interval of that.
    known = known_means("standard-v1", many.suite_hash, settings, V1.variates)
    for i, name in enumerate(V1.variates):
        score = many.scores[name]
        mean = np.mean([each.mean[i] for each in known.values()])
        assert score.value == pytest.approx(100.0 + 100.0 / V1.scale * mean)
        error = np.sqrt(sum(each.covariance[i][i] / each.n for each in known.values())) / len(known)
        assert score.high - score.value == pytest.approx(1.96 * 100.0 / V1.scale * error, rel=1e-3)


def test_without_a_score_the_mean_pinned_cost_ranks(tmp_path):
    right, other = evaluation.evaluate("deloaded-10", "paper", "test"), {V0.zero: V0.hundred, V0.hundred: V0.zero}
    # The anchors change places.
    metrics = {(e.entry, e.seed): e.metrics for e in right.episodes}
    episodes = [dataclasses.replace(e, metrics=metrics[other.get(e.entry, e.entry), e.seed]) for e in right.episodes]
    results = dataclasses.replace(right, episodes=tuple(episodes))
    rows = results.ranking
    columns = columns_of("terminal", rows)
    assert results.no_score and len(rows) == 3
    with pytest.raises(evaluation.NoScaleError, match=r"mppt \(mean cost .*\) is not worse than coordinated-piecewise"):
        evaluation.leaderboard_rows(results)
    assert evaluation.Results.read(results.write(tmp_path)[0]) == results
    costs = {name: float(np.mean(costs)) for name, costs in results.pinned_costs.items()}
    assert [row.name for row in rows] == sorted(costs, key=lambda name: costs[name])
    cells = [dict(zip(columns, each, strict=True)) for each in evaluation.table_cells(rows, columns)]
    assert [each["rank"] for each in cells] == ["1", "2", "3"] and {each["score"] for each in cells} == {"none"}
    assert [each["mean cost"] for each in cells] == [f"{costs[row.name]:.1f}" for row in rows]
    for text in (markdown_section(results), results._repr_markdown_()):
        assert "anked by mean cost, as there is no score: on these 2 scenarios mppt" in text
        assert "[points]" not in text and f"{costs[rows[0].name]:.1f}" in text
    assert results.to_dict()["summary"]["deloaded-10"]["mean_pinned_cost"] == pytest.approx(costs["deloaded-10"])


CELLS = {
    "cost": ("cheap", r"cost must be a number in -1e\+12 … 1e\+12 \[-\]"),
    "nadir_hz": ("nan", r"nadir_hz must be a number in .* \[Hz\]"),
    "seed": ("-1", "seed must be a whole number"),
    "failure": ("bored", "failure must be empty or one of stall"),
}
BASE = {"suite": "standard", "duration_s": 10.0}


@pytest.fixture(scope="session")
def written(results, tmp_path_factory):
    return results.write(tmp_path_factory.mktemp("written"))


@pytest.fixture
def copies(written, tmp_path):
    return tuple(Path(shutil.copy(path, tmp_path)) for path in written)


def test_files_that_are_read_and_written_again_are_the_same(written, results, tmp_path):
    assert sorted(path.name for path in written[0].parent.iterdir()) == ["standard-test.csv", "standard-test.json"]
    read = Results.read(written[0])
    assert read == results
    assert all(one.read_bytes() == other.read_bytes() for one, other in zip(read.write(tmp_path), written, strict=True))
    text = written[0].read_text(encoding="utf-8")
    assert str(Path.home()) not in text and not re.search(r"20\d\d-\d\d-\d\dT", text)


def test_anchors_of_v0_score_exactly_0_and_100_and_the_hundred_of_v1_100(results, results_v1):
    zero, hundred = (Interval(value, value, value) for value in (0.0, 100.0))
    assert [results.scores[name] for name in ("mppt", "coordinated-piecewise")] == [zero, hundred]
    assert results_v1.scores["coordinated-tuned"] == hundred


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(which=st.integers(0, 1), data=st.data())
def test_damaged_file_never_passes(copies, which, data):
    path = copies[which]
    original = path.read_bytes()
    position = data.draw(st.integers(0, len(original) - 1))
    before, after = original[:position], original[position:]
    another = st.integers(1, 255).map(lambda bits: before + bytes([after[0] ^ bits]) + after[1:])
    longer = st.binary(min_size=1, max_size=8).map(lambda more: before + more + after)
    path.write_bytes(data.draw(st.just(before) | another | longer))
    try:
        with pytest.raises(ValueError, match=re.escape(path.stem)):
            Results.read(copies[0])
    finally:
        path.write_bytes(original)


def _sign(paths: tuple[Path, Path], data) -> None:
    """Write a description whose hashes fit, as somebody with bad intentions would."""
    data["csv_sha256"] = sha256(paths[1].read_bytes())
    data.pop("sha256", None)
    text = to_json({**data, "sha256": sha256(to_json(data).encode("utf-8", "surrogatepass"))})
    paths[0].write_text(text, encoding="utf-8", errors="surrogatepass")


EDITS = {
    "cap as text": (lambda d: d["settings"]["weights"].update(cap="much"), "could not convert string to float"),
    "missing key": (lambda d: d.pop("seeds"), "it misses 'seeds'"),
    "list as text": (lambda d: d.update(seeds="all"), "seeds must be of the type list, got 'all'"),
    "seed as text": (
        lambda d: d["entries"][1].update(training_seed="0"),
        r"entries\[1\].training_seed must be of the type int . None, got '0'",
    ),
    "no versions": (lambda d: d.update(versions={}), "versions that of wtg_gym"),
    "no environment": (lambda d: d.update(environment={}), "environment must have fingerprint and id"),
    "unknown suite": (lambda d: d.update(suite="easy"), "unknown suite 'easy'"),
    "other format": (lambda d: d.update(format=2), "format must be 8, that of this version, got 2; "),
    "name that is markup": (lambda d: d["entries"][0].update(name="[me](x)\n"), "the entry's name must be 1 … 60 char"),
    "one row of two entries": (
        lambda d: [each.update(name="a", training_seed=i) for i, each in enumerate(d["entries"])],
        "entries named 'a' share a row and must agree on",
    ),
    "no anchors": (lambda d: d.update(entries=[]), "expected one row per entry and seed"),
    "better score": (lambda d: d["summary"]["mppt"]["score"].update(value=200.0), "is 200.0, the table sums up to 0.0"),
}


@pytest.mark.parametrize("case", EDITS)
def test_forged_description_is_refused(copies, case):
    edit, text = EDITS[case]
    data = json.loads(copies[0].read_text(encoding="utf-8"))
    edit(data)
    _sign(copies, data)
    with pytest.raises(ValueError, match=f"standard-test.*{text}"):
        Results.read(copies[0])


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_changed_description_whose_hashes_fit_is_shown_or_refused(written, tmp_path, data):
    path = tmp_path / written[0].name
    path.with_suffix(".csv").write_bytes(written[1].read_bytes())
    description = data.draw(changes.changed(json.loads(written[0].read_text(encoding="utf-8"))))
    # Numbers that are not finite have no hash.
    _sign((path, path.with_suffix(".csv")), json.loads(json.dumps(description), parse_constant=lambda _: None))
    changes.read_or_refused(path, lambda p: [departures(own := Results.read(p)), markdown_section(own, details=True)])


@pytest.mark.parametrize("column", CELLS)
def test_forged_table_names_line_and_column(copies, column):
    value, text = CELLS[column]
    lines = copies[1].read_text(encoding="utf-8").split("\n")
    cells = lines[2].split(",")
    cells[lines[0].split(",").index(column)] = value
    no_row = r"expected one row per entry and seed.*9 rows.*got 8"
    for third, said in (([",".join(cells)], rf"standard-test.csv, line 3: {text}"), ([], no_row)):
        copies[1].write_text("\n".join([*lines[:2], *third, *lines[3:]]), encoding="utf-8")
        _sign(copies, json.loads(copies[0].read_text(encoding="utf-8")))
        with pytest.raises(ValueError, match=said):
            Results.read(copies[0])


def fingerprint(**settings) -> str:
    return environment_fingerprint(EnvSettings(**{**BASE, **settings}))


def test_the_fingerprint_is_another_for_another_environment_and_the_same_whatever_an_entry_chooses():
    of_entries = {"strategy": "mppt", "action_mode": "k", "observation_mode": "privileged", "split": "validation"}
    assert {fingerprint(**{key: value}) for key, value in of_entries.items()} == {fingerprint()}
    v1 = {"suite": "standard-v1"}
    settings = (
        *({}, {"suite": "gust"}, {"suite": "paper"}, {"weights": {"duty": 2.000001}}, {"control_dt": 0.2}),
        *({"plant": {"simulation_dt": 0.02}}, {"plant": {"machine_model": "classical"}}, {"duration_s": 9.0}),
        *(v1, {**v1, "sensors": "exact"}, {**v1, "sensors": {"wind_sensor": False}}, {"suite": "low-share-v1"}),
    )
    assert len({fingerprint(**change) for change in settings}) == len(settings)
