"""The governor IEESGO with its steam turbine: a lag, a lead-lag, a limit, three stages of steam.

    T_1 ẋ = Δω/R - x,    T_3 ż = x - z,    y = z + (T_2/T_3)(x - z)
    T_4 ṡ_1 = clip(g_ref - y, P_min, P_max) - s_1,    T_5 ṡ_2 = s_1 - s_2,    T_6 ṡ_3 = s_2 - s_3
    T_m = (1 - K_2) s_1 + K_2 (1 - K_3) s_2 + K_2 K_3 s_3

Δω is the speed's deviation ω - 1 beyond the dead band, and 1/R is K_1. A lost governor keeps what its inlet gives, s_1.
Source: the standard model IEESGO of PSS/E, as ANDES defines it.
"""

from __future__ import annotations

from typing import NamedTuple

from wtg_gym.physics.control_blocks import inverse, lag, lead_lag
from wtg_gym.physics.control_parameters import ReheatGovernorParameters
from wtg_gym.physics.governor import beyond_dead_band
from wtg_gym.physics.machine_controls import governor
from wtg_gym.systems.elementary import clip, select


class Ieesgo(NamedTuple):
    """Constants, on the base of the machine."""

    machine: int  # whose governor it is
    inv_lag_time: float  # 1/T_1 [1/s]
    lead_time: float  # T_2 [s]
    inv_governor_time: float  # 1/T_3 [1/s]
    inv_inlet_time: float  # 1/T_4 [1/s]
    inv_reheat_time: float  # 1/T_5
    inv_crossover_time: float  # 1/T_6
    fraction_2: float  # K_2
    fraction_3: float  # K_3
    gate_min: float  # P_min [p.u.]
    gate_max: float  # P_max [p.u.]
    dead_band: float  # [p.u.]


class IeesgoState(NamedTuple):
    """States."""

    controlling: float  # x [p.u.]
    governing: float  # z [p.u.]
    valve: float  # s_1 [p.u.]
    reheated: float  # s_2 [p.u.]
    crossed: float  # s_3 [p.u.]


def ieesgo_constants(machine: int, p: ReheatGovernorParameters) -> Ieesgo:
    """Return the constants of the governor of a machine, given by its index."""
    return Ieesgo(
        machine=machine,
        inv_lag_time=inverse(p.lag_time_s),
        lead_time=p.lead_time_s,
        inv_governor_time=inverse(p.governor_time_s),
        inv_inlet_time=1.0 / p.inlet_time_s,
        inv_reheat_time=inverse(p.reheat_time_s),
        inv_crossover_time=inverse(p.crossover_time_s),
        fraction_2=p.fraction_2,
        fraction_3=p.fraction_3,
        gate_min=p.gate_min_pu,
        gate_max=p.gate_max_pu,
        dead_band=p.dead_band_pu,
    )


def ieesgo_rates(
    s: IeesgoState, speed: float, reference: float, inv_droop: float, c: Ieesgo
) -> tuple[IeesgoState, float]:
    """Return the rates and the torque [p.u.]; speed ω [p.u.], reference g_ref [p.u.], 1/R in use."""
    acts = select(inv_droop > 0.0, 1.0, 0.0)
    demand = inv_droop * beyond_dead_band(speed - 1.0, c.dead_band)
    controlling, lagged = lag(s.controlling, demand, c.inv_lag_time)
    governing, led = lead_lag(s.governing, lagged, c.lead_time, c.inv_governor_time)
    valve, steam = lag(s.valve, clip(reference - led, c.gate_min, c.gate_max), c.inv_inlet_time)
    reheating, reheated = lag(s.reheated, steam, c.inv_reheat_time)
    crossing, crossed = lag(s.crossed, reheated, c.inv_crossover_time)
    rates = IeesgoState(acts * controlling, acts * governing, acts * valve, reheating, crossing)
    behind = reheated + c.fraction_3 * (crossed - reheated)
    return rates, steam + c.fraction_2 * (behind - steam)


def ieesgo_start(torque: float, c: Ieesgo) -> IeesgoState:
    """Return the equilibrium at a torque [p.u.]."""
    return IeesgoState(0.0, 0.0, torque, torque, torque)


def _free(s: IeesgoState, c: Ieesgo) -> IeesgoState:
    """Return the states, none of which has a limit of its own."""
    return s


def _limits(c: Ieesgo) -> tuple[float, float]:
    return c.gate_min, c.gate_max


IEESGO = governor("governors IEESGO", IeesgoState, Ieesgo, ieesgo_constants, ieesgo_rates, _free, ieesgo_start, _limits)
