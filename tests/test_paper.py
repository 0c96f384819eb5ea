"""The paper reproduced: steady states and loops of one WTG, claims that hold, figures drawn without a warning."""

import json
from pathlib import Path

import numpy as np
import paper
import pytest

from wtg_gym.physics.parameters import PitchParameters
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import STRATEGIES, TrackingLaw
from wtg_gym.physics.trajectory import simulate

ROOT = Path(__file__).resolve().parent.parent
#: Claims whose numbers are rounding.
LAST_DIGITS = {"coordination", "compatible", "stays-stable"}


@pytest.mark.parametrize(
    ("strategy", "frequency_pu"), [("mppt", 0.99787), ("deloaded-5", 0.99698), ("deloaded-10", 0.99662)]
)
def test_fixed_strategies_lose_their_equilibrium_where_theory_says(strategy, frequency_pu):
    assert paper.critical_frequency_pu(STRATEGIES[strategy], 8.0) == pytest.approx(frequency_pu, abs=5e-6)


@pytest.mark.parametrize("wind", [3.0, 8.0, 11.4, 25.0])
def test_coordinated_laws_keep_theirs_at_every_wind(wind):
    assert paper.critical_frequency_pu(STRATEGIES["coordinated-piecewise"], wind) is None


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


@pytest.fixture(scope="module")
def written(tmp_path_factory):
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
