"""`wtg-gym analyse margins` and `wtg-gym analyse modes` as a user calls them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli.calls import error_of, json_of
from wtg_gym.cli import main


def test_margins_of_the_paper_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", "margins", "--law", "deloaded-5", "coordinated-linear", "coordinated-piecewise"]) == 0
    lines = capsys.readouterr().out.splitlines()
    cells = {tuple(line.split()[:3]): line.split()[3] for line in lines[2:]}
    assert cells["ideal-source", "–", "–"] == "48.8"
    assert cells["deloaded-5", "11.4", "–"] == "46.7"
    assert cells["coordinated-linear", "11.4", "–"] == "55.4"
    assert ("coordinated-piecewise", "11.4", "under") in cells and ("coordinated-piecewise", "11.4", "over") in cells


def test_margins_as_json_hold_the_transfer_function(capsys: pytest.CaptureFixture[str]) -> None:
    loops = json_of(capsys, "analyse", "margins", "--law", "mppt", "--kp", "2", "--json")["loops"]
    assert [loop["law"] for loop in loops] == ["ideal-source", "mppt"]
    poles = np.array([complex(*pole) for pole in loops[1]["closed_loop_poles"]])
    characteristic = np.polynomial.Polynomial(loops[1]["numerator"]) + np.polynomial.Polynomial(loops[1]["denominator"])
    assert np.abs(characteristic(poles)).max() < 1e-6


def test_bode_plot_is_written(tmp_path: Path) -> None:
    path = tmp_path / "bode.svg"
    assert main(["analyse", "margins", "--law", "coordinated-piecewise", "--plot", str(path)]) == 0
    assert "coordinated-piecewise, under-frequency" in path.read_text(encoding="utf-8")


def test_modes_are_printed_with_groups_counted_from_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyse", "modes"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("coordinated-piecewise\n")
    assert "wtg2.rotor_speed" in said and "wtg0" not in said and "bus8." in said


def test_modes_as_json_are_the_eigenvalues_of_the_matrix(capsys: pytest.CaptureFixture[str]) -> None:
    data = json_of(capsys, "analyse", "modes", "--law", "mppt", "--wind", "9", "--machine-model", "classical", "--json")
    (law,) = data["laws"]
    matrix = np.array(law["matrix"])
    assert matrix.shape == (len(law["state_names"]),) * 2
    found = [complex(mode["real_1_s"], mode["imaginary_rad_s"]) for mode in law["modes"]]
    expected = [value for value in np.linalg.eigvals(matrix) if value.imag >= 0.0]
    assert sorted(found, key=lambda z: (z.real, z.imag)) == pytest.approx(
        sorted(map(complex, expected), key=lambda z: (z.real, z.imag)), abs=1e-9
    )
    assert np.array(law["synchronising_coefficients"]).shape == (1, 1)


def test_unstable_equilibrium_is_exit_code_1(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A law whose k rises with the frequency: the more frequency, the more power."""
    law = tmp_path / "wrong.toml"
    law.write_text("k_min = 0.4\nk_nominal = 0.67\nk_max = 1.0\ntau_s = 0\n")
    assert main(["analyse", "modes", "--law", str(law), "--plot", str(tmp_path / "modes.png")]) == 1
    assert "\n0." in capsys.readouterr().out or (tmp_path / "modes.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("analyse", "margins", "--kp", "0"),
            "synchronising coefficient = 0 p.u./rad is outside the allowed range 0.01 … 100",
        ),
        (("analyse", "margins", "--wind", "30"), "wind = 30 m/s is outside the allowed range 3 … 25 m/s"),
        (("analyse", "margins", "--wind", "8", "9", "--plot", "x.png"), "--plot draws one wind speed, 2 are given"),
        (("analyse", "modes", "--wind", "30"), "outside the allowed range 3 … 25 m/s"),
        (("analyse", "modes", "--load-level", "9"), "load_level = 9 is outside the allowed range 0.3 … 1.5"),
        (("analyse", "modes", "--side", "left"), "invalid choice"),
    ],
)
def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str) -> None:
    assert said in error_of(capsys, *arguments)
