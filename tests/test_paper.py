"""The paper reproduced: steady states and loops of one WTG, claims that hold, figures drawn without a warning."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import paper
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from wtg_gym.physics.aerodynamics import power_coefficient
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, PitchParameters, TurbineParameters
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.physics.trajectory import simulate

ROOT = Path(__file__).resolve().parent.parent
#: Claims whose numbers are rounding.
LAST_DIGITS = {"coordination", "compatible", "stays-stable"}
LAWS = st.builds(
    lambda k_min, k_nominal, k_max, tau: TrackingLaw(
        name="x", k_min=k_min, k_nominal=k_nominal, k_max=k_max, damping_time_constant_s=tau
    ),
    st.floats(0.05, 3.0),
    st.floats(0.05, 3.0),
    st.floats(0.05, 3.0),
    st.sampled_from([0.0, 0.8, math.inf]),
)


def surplus_pu(frequency: float, law: TrackingLaw, wind: float, rotor: Floats) -> Floats:
    """Captured minus delivered power at rotor speeds [p.u.], written down from the paper."""
    turbine, control = TurbineParameters(), GridFormingParameters()
    corners = control.frequency_min_pu, control.frequency_setpoint_pu, control.frequency_max_pu
    k = np.interp(frequency, corners, (law.k_min, law.k_nominal, law.k_max))
    droop = control.droop_gain_pu * (frequency - 1.0) if math.isinf(law.damping_time_constant_s) else 0.0
    ratio = turbine.tip_speed_ratio_per_speed_m_s * rotor / wind
    captured = turbine.wind_power_pu_per_cubic_wind * wind**3 * power_coefficient(ratio)
    return np.asarray(captured - k * rotor**3 + droop)


def margin_pu(frequency: float, law: TrackingLaw, wind: float) -> float:
    """The largest surplus on a fine grid: at most 1e-5 below the true one."""
    fastest = 60.0 * wind / TurbineParameters().tip_speed_ratio_per_speed_m_s
    return float(surplus_pu(frequency, law, wind, np.linspace(fastest / 60.0, fastest, 6000)).max())


@pytest.mark.parametrize(
    ("strategy", "frequency_pu"), [("mppt", 0.99787), ("deloaded-5", 0.99698), ("deloaded-10", 0.99662)]
)
def test_fixed_strategies_lose_their_equilibrium_where_theory_says(strategy, frequency_pu):
    assert paper.critical_frequency_pu(STRATEGIES[strategy], 8.0) == pytest.approx(frequency_pu, abs=5e-6)


@pytest.mark.parametrize("wind", [3.0, 8.0, 11.4, 25.0])
def test_coordinated_laws_keep_theirs_at_every_wind(wind):
    assert paper.critical_frequency_pu(STRATEGIES["coordinated-piecewise"], wind) is None


@given(LAWS, st.floats(3.0, 25.0), st.floats(0.98, 1.02))
@example(TrackingLaw(name="x", k_min=1.0, k_nominal=1.0, k_max=0.25), 3.0, 1.015625)
def test_every_equilibrium_balances_and_stable_and_unstable_ones_take_turns(law, wind, frequency):
    found = paper.equilibria(frequency, law, wind)
    for point in found:
        assert float(surplus_pu(frequency, law, wind, np.array(point.rotor_speed_pu))) == pytest.approx(0.0, abs=1e-6)
        # A stable rotor that turns too fast has a deficit.
        step = 1e-5 * point.rotor_speed_pu
        ends = surplus_pu(frequency, law, wind, point.rotor_speed_pu + np.array([-step, step]))
        assert (ends[1] < ends[0]) == point.stable or abs(ends[1] - ends[0]) < 1e-9
    # From the fastest on, every second one is stable, the fastest one always.
    assert [point.stable for point in reversed(found)] == [i % 2 == 0 for i in range(len(found))]
    if abs(margin_pu(frequency, law, wind)) > 1e-4:
        assert any(point.stable for point in found) == (margin_pu(frequency, law, wind) > 0.0)


@pytest.mark.parametrize("wind", [8.0, 13.0, 20.0])
@pytest.mark.parametrize("strategy", ["mppt", "coordinated-piecewise"])
def test_simulation_starts_in_the_stable_equilibrium(wind, strategy):
    """At 13 and 20 m/s the pitch protection holds the rotor where captured power or rotor speed reaches its limit."""
    run = simulate(Scenario(name="x", wind_speed=np.array([[wind], [8.0]]), duration_s=5.0), STRATEGIES[strategy])
    pitch, k = PitchParameters(), STRATEGIES[strategy].k_nominal
    limits = pitch.rotor_speed_limit_pu, (pitch.captured_power_limit_pu / k) ** (1.0 / 3.0)
    speed = min(paper.equilibria(1.0, STRATEGIES[strategy], wind)[-1].rotor_speed_pu, *limits)
    assert run.rotor_speed_pu[-1, 0] == pytest.approx(speed, abs=1e-8)
    assert run.power_pu[-1, 0] == pytest.approx(k * speed**3, abs=1e-8)


def test_a_law_without_an_equilibrium_is_named():
    greedy = TrackingLaw(name="greedy", k_min=3.0, k_nominal=3.0, k_max=3.0, damping_time_constant_s=0.8)
    with pytest.raises(ValueError, match=r"'greedy' has no equilibrium at 8 m/s at the set-point either"):
        paper.critical_frequency_pu(greedy, 8.0)


@pytest.mark.parametrize(
    ("loop", "margin_deg"),
    [
        (paper.ideal_source_loop(), 48.8),
        (paper.single_machine(STRATEGIES["deloaded-5"], 11.4), 46.7),
        (paper.single_machine(STRATEGIES["deloaded-10"], 11.4), 46.9),
        (paper.single_machine(paper.UNDAMPED, 11.4), 29.1),
        (paper.single_machine(paper.LINEAR, 11.4), 55.4),
        (paper.single_machine(paper.UNDAMPED, 8.0), 10.1),
    ],
    ids=["ideal", "deloaded-5", "deloaded-10", "undamped", "damped", "undamped at 8 m/s"],
)
def test_phase_margins_are_those_of_the_paper(loop, margin_deg):
    assert loop.margins().phase_margin_deg == pytest.approx(margin_deg, abs=0.05)


@given(st.floats(4.0, 11.0), st.floats(0.2, 5.0), st.floats(0.05, 20.0), st.sampled_from(["under", "over"]))
def test_margins_agree_with_a_fine_sweep_and_with_the_poles(wind, k_p, tau, side):
    law = dataclasses.replace(STRATEGIES["coordinated-piecewise"], name="x", damping_time_constant_s=tau)
    loop = paper.single_machine(law, wind, k_p, side=side)
    found = loop.margins()
    sweep = np.logspace(-4, 3, 20_001)
    gain = np.abs(loop.response(sweep))
    crossings = np.flatnonzero((gain[:-1] - 1.0) * (gain[1:] - 1.0) <= 0.0)
    margins = [180.0 + np.degrees(np.unwrap(np.angle(loop.response(sweep))))[i] for i in crossings]
    margins = [(margin + 180.0) % 360.0 - 180.0 for margin in margins]
    if not found.stable:
        assert math.isnan(found.phase_margin_deg) and loop.closed_loop_poles().real.max() >= 0.0
        return
    assert found.phase_margin_deg == pytest.approx(min(margins), abs=0.5)
    assert abs(loop.response(found.crossover_rad_s)) == pytest.approx(1.0, abs=1e-9)
    # One crossover and a rolling-off loop: Nyquist says the sign of the margin decides.
    assert found.phase_margin_deg > 0.0


# --- claims and figures ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The folder that the study has written into."""
    folder = tmp_path_factory.mktemp("docs")
    paper.main(folder)
    return folder / "validation"


def test_every_claim_holds_but_the_one_that_the_paper_drew_schematically(written):
    text = (written / "claims.json").read_text(encoding="utf-8")
    claims = {claim["key"]: claim for claim in json.loads(text)["claims"]}
    assert len(claims) == 30
    assert {key for key, claim in claims.items() if not claim["holds"]} == {"high-deloading-high-wind"}
    assert all(claim["values"] and claim["measured"] for claim in claims.values())
    assert claims["high-deloading-high-wind"]["remark"]


def test_claims_are_measured_not_written():
    """Exchange the runs of two strategies: the claims about them fall."""
    runs = paper.run_case(0)
    exchanged = {"coordinated-piecewise": runs["deloaded-5"], "deloaded-5": runs["coordinated-piecewise"]}
    fallen = {claim["key"] for claim in paper.load_increase(runs | exchanged) if not claim["holds"]}
    assert fallen >= {"stays-stable", "stalls", "larger-step", "faster-rotor", "rocof", "nadir", "narrow-range"}


def test_the_pages_claims_and_figures_are_the_studys(written):
    claims = json.loads((written / "claims.json").read_text(encoding="utf-8"))["claims"]
    page = (ROOT / "docs/validation.md").read_text(encoding="utf-8")
    assert all(claim["measured"] in page for claim in claims if claim["key"] not in LAST_DIGITS)
    figures = {path.name for path in (written / "figures").iterdir()}
    assert len(figures) == 2 and all(f"validation/figures/{name}" in page for name in figures)
