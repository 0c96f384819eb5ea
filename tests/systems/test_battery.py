"""A kind of unit of one's own is a file: a battery, its equations, its start, its cost, and what is seen of it."""

from __future__ import annotations

import copy
import dataclasses
import math
import pickle
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.physics.extended import largest_rate, scenario
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.gradients import check_by_differences
from wtg_gym.gradients.tape import Tape
from wtg_gym.physics.devices import Devices
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.scenario import LoadStep
from wtg_gym.physics.units import LANE, UNITS, Connection, Phasor, Terminal, quotient
from wtg_gym.systems.elementary import clip, select, sine_cosine
from wtg_gym.systems.systems import Kind, system
from wtg_gym.tasks.cost import COST, CostTerms


class Battery(NamedTuple):
    """Constants."""

    inv_rating: float  # on the base of the system
    inv_energy_time: float  # 1/(time from full to empty at rated power) [1/s]
    efficiency: float  # of charging, and of discharging
    droop: float  # [p.u. of frequency per p.u. of power]
    beyond: float  # how many times steeper the droop is beyond the rating


class BatteryState(NamedTuple):
    """States."""

    angle: float  # of its voltage against the first unit's rotor [rad]
    energy: float  # share of the full one


class BatteryOutput(NamedTuple):
    """What is seen of it."""

    power: float  # [p.u. of its rating]
    energy_left: float


BATTERIES = Kind(
    name="batteries",
    # Where `connected` is 0, the network leaves out its admittance.
    rows={"charge": BatteryState, "emf": float, "connected": float, "output": BatteryOutput},
    scratch={"seen": BatteryOutput},
    constants={"battery": Battery},
    sees={"unit": UNITS, "lane": LANE, "cost": COST},
    states=("charge",),
    conditions=("wears",),
)


@system(BATTERIES, "planned_power")
def plan() -> float:
    """Return what it delivers before the first step."""
    return 0.0


@system(BATTERIES, "charge", "emf", "connected")
def settle(start: Terminal, connection: Connection, frame: float) -> tuple[BatteryState, float, float]:
    """Return the equilibrium, half full."""
    drop = quotient(start.current, connection.y)
    re, im = start.voltage.re + drop.re, start.voltage.im + drop.im
    return BatteryState(math.atan2(im, re) - frame, 0.5), math.hypot(re, im), 1.0


@system(BATTERIES, "voltage")
def voltage_of_battery(charge: BatteryState, emf: float) -> Phasor:
    """Return the voltage behind its reactance."""
    sine, cosine = sine_cosine(charge.angle)
    return Phasor(emf * cosine, emf * sine)


@system(BATTERIES, "charge_rates", "output")
def rates(
    charge: BatteryState, voltage: Phasor, current: Phasor, battery: Battery, reference_speed: float, omega_n: float
) -> tuple[BatteryState, BatteryOutput]:
    """Return rates and outputs: a droop on the power, steeper beyond the rating and where it is empty or full."""
    power = battery.inv_rating * (voltage.re * current.re + voltage.im * current.im)
    allowed = clip(power, -clip(5.0 * (1.0 - charge.energy), 0.0, 1.0), clip(5.0 * charge.energy, 0.0, 1.0))
    speed = 1.0 - battery.droop * (power + battery.beyond * (power - allowed))
    taken = select(power > 0.0, power / battery.efficiency, power * battery.efficiency)
    moves = BatteryState(omega_n * (speed - reference_speed), -battery.inv_energy_time * taken)
    return moves, BatteryOutput(power, charge.energy)


def limited(charge: BatteryState, _: Battery) -> BatteryState:
    return BatteryState(charge.angle, clip(charge.energy, 0.0, 1.0))


@system(BATTERIES, "term_rates", when="wears")
def charge_for_wear(term_rates: CostTerms, output: BatteryOutput) -> CostTerms:
    """Add the wear to the effort."""
    return term_rates._replace(effort=term_rates.effort + 0.1 * output.power * output.power)


@system(BATTERIES, "seen")
def observe(output: BatteryOutput) -> BatteryOutput:
    """Show its outputs."""
    return output


def batteries(*buses: int, energy_time_s: float = 600.0, has: tuple[str, ...] = ("wears",)) -> Devices:
    """Batteries of 20 MVA, with a reactance of 0.2 p.u."""
    n, rating = len(buses), 0.2  # on the system's 100 MVA
    battery = Battery(1.0 / rating, 1.0 / energy_time_s, efficiency=0.95, droop=0.02, beyond=4.0)
    return Devices(
        kind=BATTERIES,
        buses=buses,
        impedances=(0.2j / rating,) * n,
        reactive_weights=(rating,) * n,
        constants={"battery": [battery] * n},
        systems={
            "plan": (plan,),
            "settle": (settle,),
            "voltages": (voltage_of_battery,),
            "move": (moving(rates, limited, constants=["battery"]),),
            "rates": (rates,),
            "charge": (charge_for_wear,),
            "observe": (observe,),
        },
        shown="seen",
        has=has,
    )


STEP = scenario(LoadStep(time_s=1.0, bus=9, power_mw=60.0), duration_s=20.0)


def settings(version: str = "v0", **more: Any) -> EnvSettings:
    own = EnvSettings(version=version, action_mode="k+tau", duration_s=20.0)
    given = Plant(devices=(batteries(9, 14, **more),), control_dt=own.control_dt)
    return dataclasses.replace(own, plant=given)


def played(n_lanes: int, n_steps: int = 60, **more: Any) -> TaskLanes:
    lanes = TaskLanes(settings(**more), n_lanes)
    lanes.start(list(range(n_lanes)), [STEP] * n_lanes)
    for _ in range(n_steps):
        lanes.step(np.zeros((n_lanes, lanes.n_action)))
    return lanes


def test_it_starts_in_equilibrium_and_holds_up_the_frequency() -> None:
    lanes = TaskLanes(settings())
    lanes.start([0], [STEP])
    assert largest_rate(lanes.simulator) < 1e-9
    own, without = played(1), TaskLanes(EnvSettings(version="v0", duration_s=20.0, action_mode="k+tau"))
    without.start([0], [STEP])
    for _ in range(60):
        without.step(np.zeros((1, without.n_action)))
    with_them, alone = (lanes.simulator.lane_values("coi_min")[0] for lanes in (own, without))
    assert 1.0 > with_them > alone + 1e-4
    energy = own.observations[0, [own.observation_names.index(f"batteries{j}.energy_left") for j in range(2)]]
    assert (energy < 0.5).all() and (energy > 0.4).all()
    # Wear is part of the cost of effort, of batteries that wear.
    effort = list(CostTerms._fields).index("effort")
    assert own.cost_sums()[0, effort] > 0.0 == played(1, has=()).cost_sums()[0, effort]


def test_one_lane_and_many_have_the_same_bits() -> None:
    one, many = played(1), played(17)
    assert (many.observations == one.observations).all() and (many.rewards == one.rewards[0]).all()


def test_an_empty_one_gives_no_more() -> None:
    lanes = TaskLanes(settings(energy_time_s=3.0))
    lanes.start([0], [STEP])
    for _ in range(190):
        lanes.step(np.zeros((1, lanes.n_action)))
    names = lanes.observation_names
    power, energy = (lanes.observations[0, names.index(f"batteries0.{name}")] for name in BatteryOutput._fields)
    assert 0.0 <= energy < 0.05 and abs(power) < 0.05


def test_its_gradient_is_that_of_differences() -> None:
    tape = Tape(settings(), 2, 1)
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 2, tape.lanes.n_action))
    (of_actions, *_) = check_by_differences(tape, [STEP, STEP], actions)
    assert of_actions.gradient == pytest.approx(of_actions.central, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (
            {"systems": {"setle": (settle,)}},
            "no list has a place 'setle' for batteries; .*; did you mean 'settle'",
        ),
        ({"systems": {"plan": (plan,)}}, "batteries have no systems for settle, voltages, move, rates"),
        ({"impedances": (0j,)}, "impedances of batteries must be finite and not 0 p.u."),
        ({"reactive_weights": (0.1, 0.2)}, "1 batteries need 1 reactive_weights, got 2"),
        ({"constants": {}}, r"batteries have the constants \['battery'\], got \[\]"),
        ({"shown": "sen"}, "'sen' is no record in scratch of batteries; did you mean 'seen'"),
    ],
)
def test_bad_units_are_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        dataclasses.replace(batteries(9), **changes)


def test_a_kind_that_is_there_already_is_refused() -> None:
    with pytest.raises(ValueError, match="units of a kind 'batteries' already"):
        TaskLanes(dataclasses.replace(EnvSettings(version="v0"), plant=Plant(devices=(batteries(9), batteries(14)))))


def test_a_condition_that_no_kind_has_is_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown conditions \['weares'\].*; did you mean 'wears'"):
        TaskLanes(settings(has=("weares",)))


def test_a_copy_from_another_process_goes_on_with_the_same_bits() -> None:
    lanes = played(2, 20)
    copies = pickle.loads(pickle.dumps(lanes)), copy.deepcopy(lanes)
    for _ in range(10):
        for own in (lanes, *copies):
            own.step(np.zeros((2, own.n_action)))
    assert all((own.observations == lanes.observations).all() for own in copies)
