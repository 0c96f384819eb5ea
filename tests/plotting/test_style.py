"""Looks, sizes and files of figures."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.plotting import STRATEGY_LOOKS, figure_bytes, save_figure, strategy_looks
from wtg_gym.plotting.style import PALETTE, SINGLE_COLUMN_MM, new_figure, print_style
from wtg_gym.reproduce.figures import plot_power_coefficient

matplotlib = pytest.importorskip("matplotlib")


def test_every_strategy_has_a_look_of_its_own() -> None:
    assert set(STRATEGIES) <= set(STRATEGY_LOOKS)
    assert len({look.colour for look in STRATEGY_LOOKS.values()}) == len(STRATEGY_LOOKS)
    # In greyscale dashes tell the simulated strategies apart.
    assert len({STRATEGY_LOOKS[name].dashes for name in STRATEGIES}) == len(STRATEGIES)


def test_a_strategy_keeps_its_look_whatever_is_drawn_beside_it() -> None:
    forwards, backwards = list(STRATEGIES), list(STRATEGIES)[::-1]
    assert strategy_looks(forwards) == strategy_looks(backwards)
    assert strategy_looks(["my agent", "mppt"])["mppt"] == STRATEGY_LOOKS["mppt"]


def test_other_labels_get_colours_that_no_strategy_beside_them_has() -> None:
    looks = strategy_looks(["mine", *STRATEGIES, "yours"])
    assert len({look.colour for look in looks.values()}) == len(STRATEGIES) + 2
    many = strategy_looks(f"agent {i}" for i in range(20))
    assert {look.colour for look in many.values()} == set(PALETTE)


def test_figure_has_its_printed_size() -> None:
    figure = new_figure(SINGLE_COLUMN_MM, 50.8)
    assert tuple(figure.get_size_inches()) == pytest.approx((3.5, 2.0))


def test_no_setting_of_the_user_is_changed_and_none_shows() -> None:
    expected = hashlib.sha256(figure_bytes(plot_power_coefficient(), "svg")).hexdigest()
    with matplotlib.rc_context({"font.size": 20.0, "axes.grid": False, "lines.linewidth": 5.0}):
        before = dict(matplotlib.rcParams)
        assert hashlib.sha256(figure_bytes(plot_power_coefficient(), "svg")).hexdigest() == expected
        assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize(("suffix", "beginning"), [("png", b"\x89PNG"), (".SVG", b"<?xml"), ("pdf", b"%PDF-")])
def test_a_figure_is_the_same_file_each_time(suffix: str, beginning: bytes) -> None:
    with print_style():
        first, second = (figure_bytes(new_figure(), suffix) for _ in range(2))
    assert first == second and first.startswith(beginning)


def test_a_figure_is_the_same_file_in_another_process() -> None:
    program = (
        "import hashlib, sys; from wtg_gym.plotting import figure_bytes\n"
        "from wtg_gym.reproduce.figures import plot_power_coefficient\n"
        "assert 'matplotlib' not in sys.modules\n"
        "print(hashlib.sha256(figure_bytes(plot_power_coefficient(), 'svg')).hexdigest())"
    )
    other = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == hashlib.sha256(figure_bytes(plot_power_coefficient(), "svg")).hexdigest()


def test_text_in_svg_stays_text_and_has_no_date() -> None:
    text = figure_bytes(plot_power_coefficient(), "svg").decode()
    assert ">(a) power coefficient and reserve</text>" in text
    assert "DejaVu Sans" in text
    assert "<dc:date>" not in text


def test_figures_are_saved_next_to_each_other(tmp_path: Path) -> None:
    with print_style():
        figure = new_figure()
    name = tmp_path / "new" / "figure 1.2"
    paths = save_figure(figure, name, ["svg", ".png"])
    assert paths == [tmp_path / "new" / "figure 1.2.svg", tmp_path / "new" / "figure 1.2.png"]
    assert all(path.read_bytes() for path in paths)
    with pytest.raises(ValueError, match="written as png, svg, pdf, got 'bmp'"):
        save_figure(figure, tmp_path / "other", ["png", "bmp"])
    assert not list(tmp_path.glob("other*"))
