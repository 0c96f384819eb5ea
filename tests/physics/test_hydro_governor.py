"""The hydro governor and its turbine by themselves, against their transfer functions and closed solutions."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from wtg_gym.physics.layout import Floats
from wtg_gym.physics.machine_models import HydroState, hydro_constants, hydro_limited, hydro_rates, hydro_start
from wtg_gym.physics.machine_parameters import HydroGovernorParameters

P = HydroGovernorParameters()
C = hydro_constants(0, P)
INV_DROOP = 1.0 / P.droop_pu


def orders(speed: Callable[[float], float], torque: float, seconds: float) -> Floats:
    """The gate's order every 10 ms for a given speed, from the equilibrium at a torque."""
    start = hydro_start(torque, C)

    def rates(t: float, x: Floats) -> tuple[float, ...]:
        return tuple(hydro_rates(HydroState(*x), speed(t), start.hydro_gate, INV_DROOP, C)[0])

    # Short steps: the speed may jump.
    how = {"t_eval": np.arange(0.0, seconds + 1e-9, 0.01), "max_step": 0.05, "rtol": 1e-9, "atol": 1e-11}
    return np.asarray(solve_ivp(rates, (0.0, seconds), tuple(start), method="Radau", **how).y[1])


def test_the_order_keeps_within_its_rate_and_its_limits():
    order = orders(lambda _t: 0.95, 0.5, 60.0)
    slope = np.diff(order) / 0.01
    assert slope.max() == pytest.approx(P.gate_rate_limit_pu_s, rel=1e-3)
    assert order.max() == pytest.approx(P.gate_max_pu, abs=1e-5)


def test_it_leaves_a_limit_at_once():
    """Non-windup: the order turns round when its wanted rate does, however long the limit has held it."""
    order = orders(lambda t: 0.95 if t < 30.0 else 1.02, 0.8, 31.0)
    assert order[3000] == pytest.approx(P.gate_max_pu, abs=1e-5)
    assert 0.01 * np.flatnonzero(order[3000:] < P.gate_max_pu - 1e-3)[0] < 0.2
    assert hydro_limited(HydroState(0.0, 1.3, 0.9, 0.9), C).gate_order == P.gate_max_pu
