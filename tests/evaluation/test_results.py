"""Facts about results and their files: the same bytes again, nothing damaged is read, and whose environment it was."""

import json
import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.changes import changed, read_or_refused
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Interval, Results
from wtg_gym.evaluation.circumstances import environment_fingerprint
from wtg_gym.evaluation.evaluator import departures
from wtg_gym.evaluation.results import markdown_section
from wtg_gym.files import sha256, to_json

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
    paths = tuple(tmp_path / path.name for path in written)
    for source, target in zip(written, paths, strict=True):
        target.write_bytes(source.read_bytes())
    return paths[0], paths[1]


def test_files_that_are_read_and_written_again_are_the_same(written, results, tmp_path):
    assert sorted(path.name for path in written[0].parent.iterdir()) == ["standard-test.csv", "standard-test.json"]
    read = Results.read(written[0])
    assert read == results
    for one, other in zip(read.write(tmp_path), written, strict=True):
        assert one.read_bytes() == other.read_bytes()
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
    damaged = data.draw(
        st.one_of(
            st.just(original[:position]),
            st.integers(1, 255).map(
                lambda bits: original[:position] + bytes([original[position] ^ bits]) + original[position + 1 :]
            ),
            st.binary(min_size=1, max_size=8).map(lambda more: original[:position] + more + original[position:]),
        )
    )
    path.write_bytes(damaged)
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
    "name that is markup": (
        lambda d: d["entries"][0].update(name="[me](https://example.org)\n"),
        "the entry's name must be 1 … 60 characters",
    ),
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
    description = data.draw(changed(json.loads(written[0].read_text(encoding="utf-8"))))
    # Numbers that are not finite have no hash.
    _sign((path, path.with_suffix(".csv")), json.loads(json.dumps(description), parse_constant=lambda _: None))
    read_or_refused(path, _shown)


def _shown(path: Path) -> None:
    results = Results.read(path)
    departures(results)
    markdown_section(results, details=True)


@pytest.mark.parametrize("column", CELLS)
def test_forged_table_names_line_and_column(copies, column):
    value, text = CELLS[column]
    lines = copies[1].read_text(encoding="utf-8").split("\n")
    cells = lines[2].split(",")
    cells[lines[0].split(",").index(column)] = value
    copies[1].write_text("\n".join([*lines[:2], ",".join(cells), *lines[3:]]), encoding="utf-8")
    _sign(copies, json.loads(copies[0].read_text(encoding="utf-8")))
    with pytest.raises(ValueError, match=rf"standard-test.csv, line 3: {text}"):
        Results.read(copies[0])
    copies[1].write_text("\n".join([*lines[:2], *lines[3:]]), encoding="utf-8")
    _sign(copies, json.loads(copies[0].read_text(encoding="utf-8")))
    with pytest.raises(ValueError, match=r"expected one row per entry and seed.*9 rows.*got 8"):
        Results.read(copies[0])


def fingerprint(**settings) -> str:
    return environment_fingerprint(EnvSettings(**{**BASE, **settings}))


def test_the_fingerprint_is_another_for_another_environment_and_the_same_whatever_an_entry_chooses():
    of_entries = (
        {"strategy": "mppt"},
        {"action_mode": "k"},
        {"observation_mode": "privileged"},
        {"split": "validation"},
    )
    assert {fingerprint(**change) for change in of_entries} == {fingerprint()}
    v1 = {"suite": "standard-v1"}
    changes = (
        *({}, {"suite": "gust"}, {"suite": "paper"}, {"weights": {"duty": 2.000001}}, {"control_dt": 0.2}),
        *({"plant": {"simulation_dt": 0.02}}, {"plant": {"machine_model": "classical"}}, {"duration_s": 9.0}),
        *(v1, {**v1, "sensors": "exact"}, {**v1, "sensors": {"wind_sensor": False}}, {"suite": "low-share-v1"}),
    )
    assert len({fingerprint(**change) for change in changes}) == len(changes)
