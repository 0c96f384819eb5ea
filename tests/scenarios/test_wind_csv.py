"""Valid forms of a user's wind series, and the errors for invalid ones."""

from pathlib import Path

import numpy as np
import pytest

from wtg_gym.physics.scenario import Scenario
from wtg_gym.scenarios import read_wind_csv

HEADER = "time_s,wind_1_m_s,wind_2_m_s\n"
GOOD = HEADER + "".join(f"{0.5 * i:g},{8 + 0.1 * i:g},{9 - 0.1 * i:g}\n" for i in range(9))


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "site.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_good_file_is_read_with_groups_as_rows(tmp_path: Path):
    wind, dt_s = read_wind_csv(write(tmp_path, GOOD))
    assert dt_s == 0.5
    assert wind.shape == (2, 9)
    assert wind[0] == pytest.approx(8 + 0.1 * np.arange(9))
    assert Scenario(name="mine", wind_speed=wind, wind_dt_s=dt_s, duration_s=4.0).n_wtg == 2


@pytest.mark.parametrize(
    "text",
    [
        b"\xef\xbb\xbf" + GOOD.encode(),
        GOOD.replace("\n", "\r\n"),
        GOOD.rstrip("\n"),
        GOOD + "\n\n",
        GOOD.replace(",", " , "),
        GOOD.replace("wind_1_m_s", "north row"),
    ],
    ids=["byte order mark", "Windows line ends", "no last line end", "empty lines at the end", "blanks", "other names"],
)
def test_harmless_variants_read_the_same(tmp_path: Path, text: str | bytes):
    wind, dt_s = read_wind_csv(write(tmp_path, text))
    assert (dt_s, wind.shape, wind[1, 8]) == (0.5, (2, 9), 8.2)


def test_series_is_cut_to_the_duration(tmp_path: Path):
    wind, _ = read_wind_csv(write(tmp_path, GOOD), duration_s=2.0)
    assert wind.shape == (2, 5)


def test_series_that_starts_late_or_has_rounded_times_is_uniform(tmp_path: Path):
    rows = "".join(f"{100 + i / 30:.3f},8\n" for i in range(31))
    wind, dt_s = read_wind_csv(write(tmp_path, "time_s,w\n" + rows), duration_s=1.0)
    assert dt_s == pytest.approx(1 / 30, rel=1e-6)
    assert wind.shape == (1, 31)


BAD = {
    "missing row": (GOOD.replace("2,8.4,8.6\n", ""), ["line 6", "1.5 to 2.5 s", "0.5 s"]),
    "changed step": (GOOD.replace("\n2,", "\n2.2,"), ["line 6", "1.5 to 2.2 s"]),
    "time goes back": (GOOD.replace("\n2,", "\n1,"), ["line 6", "does not increase", "1.5 to 1 s"]),
    "time stands still": ("time_s,w\n1,8\n1,8\n1,8\n", ["line 3", "does not increase"]),
    "step too small": ("time_s,w\n0,8\n0.0001,8\n0.0002,8\n", ["line 3", "0.001"]),
    "times too far apart": ("time_s,w\n1e308,8\n-1e308,8\n", ["line 3", "does not increase"]),
    "empty wind cell": (GOOD.replace("2,8.4,8.6", "2,,8.6"), ["line 6", "wind_1_m_s", "empty", "3 … 25 m/s"]),
    "empty time cell": (GOOD.replace("2,8.4,8.6", ",8.4,8.6"), ["line 6", "time_s", "empty"]),
    "nan": (GOOD.replace("8.4", "nan"), ["line 6", "wind_1_m_s", "'nan'", "3 … 25 m/s"]),
    "infinite time": (GOOD.replace("\n2,", "\ninf,"), ["line 6", "time_s", "'inf'"]),
    "negative wind": (GOOD.replace("8.4", "-8.4"), ["line 6", "-8.4 m/s", "3 … 25 m/s"]),
    "storm": (GOOD.replace("8.6", "31"), ["line 6", "wind_2_m_s", "31 m/s", "3 … 25 m/s"]),
    "text": (GOOD.replace("8.4", "calm"), ["line 6", "'calm'", "3 … 25 m/s"]),
    "underscore": (GOOD.replace("8.4", "1_0"), ["line 6", "not a number"]),
    "decimal comma": (GOOD.replace("2,8.4,8.6", "2,8,4,8,6"), ["line 6", "5 cells", "3"]),
    "short row": (GOOD.replace("2,8.4,8.6", "2,8.4"), ["line 6", "2 cells", "3"]),
    "empty line inside": (GOOD.replace("2,8.4,8.6\n", "\n2,8.4,8.6\n"), ["line 6", "empty line"]),
    "no header": (GOOD.removeprefix(HEADER), ["line 1", "time_s,wind_1_m_s"]),
    "semicolons": (GOOD.replace(",", ";"), ["line 1", "time_s;wind_1_m_s", "time_s,wind_1_m_s"]),
    "no wind column": ("time_s\n0\n1\n", ["line 1", "time_s,wind_1_m_s"]),
    "open quote": (GOOD.replace("8.4", '"8.4'), ["line", "not CSV"]),
    "header only": (HEADER, ["0 data row", "at least 2"]),
    "one row": (HEADER + "0,8,9\n", ["1 data row", "at least 2"]),
    "empty": ("", ["line 1", "empty"]),
    "not UTF-8": (GOOD.encode().replace(b"8.4", b"8\xb74"), ["line 6", "0xb7", "UTF-8"]),
    "binary": (b"PK\x03\x04" + b"\x00" * 64, ["line 1", "0x00"]),
}


@pytest.mark.parametrize(("text", "words"), BAD.values(), ids=BAD.keys())
def test_bad_file_is_refused_with_file_line_and_value(tmp_path: Path, text: str | bytes, words: list[str]):
    with pytest.raises(ValueError) as error:
        read_wind_csv(write(tmp_path, text))
    for word in ["site.csv", *words]:
        assert word in str(error.value)


def test_too_short_series_is_refused_with_both_lengths(tmp_path: Path):
    with pytest.raises(ValueError, match=r"site\.csv, line 10: .*4 s.*at least 60 s \(121 rows"):
        read_wind_csv(write(tmp_path, GOOD), duration_s=60.0)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_duration_is_refused(tmp_path: Path, duration_s: float):
    with pytest.raises(ValueError, match="duration_s"):
        read_wind_csv(write(tmp_path, GOOD), duration_s=duration_s)
