"""What suites, distributions, sensors and wind files refuse: one row for each rule."""

import dataclasses
import math

import pytest

from wtg_gym.scenarios import ScenarioDistribution, Suite, draws, get_suite, read_wind_csv
from wtg_gym.scenarios.draws import SensorDistribution

STANDARD, SHARED = get_suite("standard"), get_suite("standard-v1").distributions[0]
WIND = draws.Wind()


def drawn(*records: draws.Record, **settings) -> ScenarioDistribution:
    return ScenarioDistribution(name="mine", records=records, **settings)


def sensors(**changes):
    return lambda: SensorDistribution().replaced(changes)


BAD = [
    (lambda: draws.Wind(mean_m_s=(2.0, 9.0)), "mean_m_s = 2 m/s.*4 … 20 m/s"),
    (lambda: draws.LoadEvents(size_mw=(75.0, 15.0)), r"size_mw.*low <= high.*\(75, 15\) MW"),
    (lambda: draws.OperatingPoint(load_level=1.0), "load_level must be a pair"),
    (lambda: draws.Wind(gust_probability=0.7, ramp_probability=0.7), "1.4.*at most 1"),
    (lambda: draws.LoadEvents(number=(0.5, 2)), "number must be two whole numbers"),
    (lambda: draws.LoadEvents(trip_buses=(7,)), r"trip_buses must be.*\(7,\)"),
    (lambda: draws.LoadEvents(buses=[[5, 1.0]]), r"LoadEvents.buses must be tuple.* decrease .*\[MW\]\)"),
    (lambda: draws.LoadEvents(buses=[(5, 1.0, -2.0)]), "load change at bus 5 = -2 MW"),
    (lambda: draws.LoadNoise(standard_deviation_mw="loud"), "standard_deviation_mw must be a number.*'loud'"),
    (lambda: draws.Faults(probability=0.1), "Faults.lines must not be empty"),
    (lambda: draws.MachineOutages(probability=0.1), "MachineOutages.buses must not be empty"),
    (lambda: draws.Faults(probability=0.1, lines=((1, 2),), clearing_s=(0.05, 0.2)), "clearing_s = 0.05 s.*0.1 … 1 s"),
    (lambda: drawn(draws.LineTrips(lines=((7, 8),)), WIND), r"LineTrips.lines must be.*\(7, 8\)"),
    (lambda: drawn(draws.LoadNoise(), WIND), "records must be a Wind, .* LoadNoise, in this order"),
    (lambda: drawn(WIND, WIND), "at most one each of .*, got Wind, Wind"),
    (lambda: drawn(draws.LoadEvents()), "records must be a Wind"),
    (lambda: drawn(WIND, grid="ieee15"), "unknown grid 'ieee15'"),
    (lambda: drawn(WIND, draws.Faults(probability=0.0, lines=((8, 7),))), r"Faults.lines must be.*\(8, 7\)"),
    (lambda: drawn(WIND, draws.LoadNoise(bus=99)), "LoadNoise.bus: there is no bus 99"),
    (lambda: drawn(WIND, draws.MachineOutages(probability=0.1, buses=(5,))), "there is no machine at bus 5"),
    (lambda: drawn(WIND, draws.Islandings(line_sets=[[(5, 6), (9, 10)]])), r"two parts .*.* \(\(5, 6\), \(9, 10\)\)"),
    (lambda: drawn(WIND).changed({draws.Faults: {}}), "unknown records .*; known records: Wind"),
    (lambda: drawn(draws.LineTrips(), WIND, draws.Islandings(line_sets=(((7, 8),),))), "Islandings exclude LineTrips"),
    (lambda: STANDARD.distributions[0].draw(-1), "a seed must be a whole number in 0 … [0-9]*, got -1"),
    (lambda: STANDARD.distributions[0].draw(1, 0), "n_wtg must be a whole number in 1 … 100, got 0"),
    (lambda: STANDARD.distributions[0].draw(1, 2, [1.0]), r"one value per WTG group \(2\), got 1"),
    (lambda: SHARED.check_turbines([5.0, 5.0]), "10 turbines give .* % of a load .* penetration of 40 … 78 %"),
    (lambda: SHARED.draw_many(range(20), 3, [90.0] * 3), "winds of 8.5 … 11 m/s hardly ever give"),
    (sensors(delay_s=(0.1, 0.25)), "whole numbers of 0.1 s"),
    (sensors(wind_bias=math.nan), "wind_bias = nan.*0 … 0.2"),
    (sensors(wind_sensor="no"), "wind_sensor must be bool"),
    (sensors(delay=0.1), "unknown values .*; known values of the sensors: .*, wind_sensor; did you mean 'delay_s'"),
    *(
        (lambda seed=seed: STANDARD.scenario(seed), "train 1000000 … 2147483647, validation 10000 … 10099, test 20000")
        for seed in (9_999, 10_100, 2**31, 20_000.0, True)
    ),
    (lambda: get_suite("paper").scenario(0, n_turbines=[10.0]), r"one value per WTG group \(2\), got 1"),
    (lambda: get_suite("paper").scenario(0, duration_s=-1.0), "duration_s = -1 s"),
    (lambda: dataclasses.replace(STANDARD, validation=range(20_100, 20_300)), "overlap"),
    (lambda: Suite(name="empty", description="", duration_s=60.0), "either distributions or cases"),
    (lambda: dataclasses.replace(STANDARD, drawn_from={"": STANDARD.distributions, "more": ()}), "every stratum"),
    (lambda: dataclasses.replace(STANDARD, drawn_from={"": STANDARD.distributions, "a": (SHARED,)}), "every stratum"),
]


@pytest.mark.parametrize(("call", "message"), BAD)
def test_bad_input_is_refused_with_value_and_range_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refused:
        call()
    assert "\n" not in str(refused.value)


HEADER = "time_s,wind_1_m_s,wind_2_m_s\n"
GOOD = HEADER + "".join(f"{0.5 * i:g},{8 + 0.1 * i:g},{9 - 0.1 * i:g}\n" for i in range(9))
BAD_FILES: list[tuple[str | bytes, str]] = [
    (GOOD.replace("2,8.4,8.6\n", ""), "line 6.*1.5 to 2.5 s"),
    (GOOD.replace("\n2,", "\n1,"), "line 6.*does not increase"),
    (GOOD.replace("2,8.4,8.6", "2,,8.6"), "line 6.*wind_1_m_s.*empty.*3 … 25 m/s"),
    (GOOD.replace("8.4", "nan"), "line 6.*wind_1_m_s.*'nan'"),
    (GOOD.replace("8.6", "31"), "line 6.*wind_2_m_s.*'31'.*3 … 25 m/s"),
    (GOOD.replace("2,8.4,8.6", "2,8,4,8,6"), "line 6.*5 cells.*3"),
    (GOOD.removeprefix(HEADER), "line 1.*time_s,wind_1_m_s"),
    (HEADER + "0,8,9\n", "1 data row.*at least 2"),
    ("", "line 1.*empty"),
    (GOOD.encode().replace(b"8.4", b"8\xb74"), "line 6.*0xb7.*UTF-8"),
    (GOOD, "line 10: .*4 s.*at least 60 s"),
]


@pytest.mark.parametrize(("text", "message"), BAD_FILES)
def test_bad_wind_file_is_refused_with_file_line_and_value(tmp_path, text, message):
    path = tmp_path / "site.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=rf"site\.csv.*{message}"):
        read_wind_csv(path, duration_s=60.0 if text == GOOD else None)


def test_harmless_variants_of_a_wind_file_read_the_same(tmp_path):
    path = tmp_path / "site.csv"
    others = ("\ufeff" + GOOD, GOOD.replace("\n", "\r\n"), GOOD + "\n\n", GOOD.replace(",", " , "))
    for text in (GOOD, *others, GOOD.rstrip("\n").replace("wind_1_m_s", "north row")):
        path.write_bytes(text.encode())
        wind, dt_s = read_wind_csv(path)
        assert dt_s == 0.5 and wind.shape == (2, 9)
        assert wind[0].tolist() == [8 + 0.1 * i for i in range(9)] and wind[1, 8] == 8.2
    assert read_wind_csv(path, duration_s=2.0)[0].shape == (2, 5)
    # One that starts late and has rounded times is uniform.
    path.write_text("time_s,w\n" + "".join(f"{100 + i / 30:.3f},8\n" for i in range(31)))
    wind, dt_s = read_wind_csv(path, duration_s=1.0)
    assert dt_s == pytest.approx(1 / 30, rel=1e-6) and wind.shape == (1, 31)
