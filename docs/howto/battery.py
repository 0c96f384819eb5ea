"""A grid-forming battery with a droop, limited power and limited energy, as a device of the grid."""

import math
from typing import NamedTuple

from wtg_gym.physics.devices import Devices
from wtg_gym.physics.units import ENV, UNITS, Connection, Phasor, Terminal, moving, quotient
from wtg_gym.systems.elementary import clip, select, sine_cosine
from wtg_gym.systems.systems import Kind, setting, system
from wtg_gym.tasks.cost import COST, CostTerms


class Battery(NamedTuple):
    """Constants."""

    inv_rating: float  # on the base of the system
    inv_energy_time: float  # 1/(time from full to empty at rated power) [1/s]
    efficiency: float  # of charging, and of discharging
    droop: float  # [p.u. of frequency per p.u. of power]
    gain: float  # of the limiter of its power [p.u. of frequency per p.u. of power]
    integral_gain: float  # likewise, per second


class BatteryState(NamedTuple):
    """States."""

    angle: float  # of its voltage against the first unit's rotor [rad]
    energy: float  # share of the full one
    lowered: float  # frequency that the limiter takes from it [p.u.]
    raised: float  # frequency that the limiter adds


class BatteryOutput(NamedTuple):
    """Outputs."""

    power: float  # [p.u. of its rating]
    energy_left: float


BATTERIES = Kind(
    name="batteries",
    # Where `connected` is 0, the network leaves out its admittance.
    rows={"charge": BatteryState, "emf": float, "connected": float, "output": BatteryOutput},
    scratch={"seen": BatteryOutput},
    constants={"battery": Battery},
    sees={"unit": UNITS, "env": ENV, "cost": COST},
    states=("charge",),
)


@system(BATTERIES, "charge", "emf", "connected")
def settle(start: Terminal, connection: Connection, frame: float) -> tuple[BatteryState, float, float]:
    """The equilibrium, half full."""
    drop = quotient(start.current, connection.y)
    re, im = start.voltage.re + drop.re, start.voltage.im + drop.im
    return BatteryState(math.atan2(im, re) - frame, 0.5, 0.0, 0.0), math.hypot(re, im), 1.0


@system(BATTERIES, "voltage")
def voltage_of_battery(charge: BatteryState, emf: float) -> Phasor:
    """The voltage behind its reactance."""
    sine, cosine = sine_cosine(charge.angle)
    return Phasor(emf * cosine, emf * sine)


@system(BATTERIES, "charge_rates", "output")
def rates(
    charge: BatteryState, voltage: Phasor, current: Phasor, battery: Battery, reference_speed: float, omega_n: float
) -> tuple[BatteryState, BatteryOutput]:
    """A droop on the power; a limiter brings that back to the rating, or less where the battery is empty or full."""
    power = battery.inv_rating * (voltage.re * current.re + voltage.im * current.im)
    too_much = power - clip(5.0 * charge.energy, 0.0, 1.0)
    too_little = -power - clip(5.0 * (1.0 - charge.energy), 0.0, 1.0)
    lowered = max(charge.lowered, 0.0) + battery.gain * max(too_much, 0.0)
    raised = max(charge.raised, 0.0) + battery.gain * max(too_little, 0.0)
    speed = 1.0 - battery.droop * power - lowered + raised
    taken = select(power > 0.0, power / battery.efficiency, power * battery.efficiency)
    moves = BatteryState(
        angle=omega_n * (speed - reference_speed),
        energy=-battery.inv_energy_time * taken,
        lowered=select((charge.lowered > 0.0) | (too_much > 0.0), battery.integral_gain * too_much, 0.0),
        raised=select((charge.raised > 0.0) | (too_little > 0.0), battery.integral_gain * too_little, 0.0),
    )
    return moves, BatteryOutput(power, charge.energy)


def limited(charge: BatteryState, _: Battery) -> BatteryState:
    """After a step a limiter that is not needed rests at 0."""
    return BatteryState(charge.angle, clip(charge.energy, 0.0, 1.0), max(charge.lowered, 0.0), max(charge.raised, 0.0))


@system(BATTERIES, "term_rates")
def charge_for_wear(term_rates: CostTerms, output: BatteryOutput) -> CostTerms:
    """Add the wear to the effort."""
    return term_rates._replace(effort=term_rates.effort + 0.1 * output.power * output.power)


@system(BATTERIES, "seen")
def observe(output: BatteryOutput) -> BatteryOutput:
    """What the observation ends with."""
    return output


def batteries(*buses: int, energy_time_s: float = 600.0, droop: float = 0.02) -> Devices:
    """Batteries of 20 MVA and 0.2 p.u. of reactance; how long they last at rated power [s], and their droop [p.u.]."""
    n, rating = len(buses), 0.2  # on the system's 100 MVA
    battery = Battery(1.0 / rating, 1.0 / energy_time_s, 0.95, droop, gain=0.01, integral_gain=0.1)
    return Devices(
        kind=BATTERIES,
        buses=buses,
        impedances=(0.2j / rating,) * n,
        reactive_weights=(rating,) * n,
        constants={"battery": [battery] * n},
        systems={
            "plan": (setting(BATTERIES, planned_power=0.0),),  # before the first step
            "settle": (settle,),
            "voltages": (voltage_of_battery,),
            "move": (moving(rates, limited, constants=["battery"]),),
            "rates": (rates,),
            "charge": (charge_for_wear,),
            "observe": (observe,),
        },
        shown="seen",
    )
