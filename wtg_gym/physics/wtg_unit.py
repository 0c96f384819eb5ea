"""Groups of wind turbine generators as units, and what extended ones have besides: the limits of their currents."""

import math
from collections.abc import Callable
from typing import NamedTuple

from wtg_gym.physics import converter as gfm
from wtg_gym.physics import units
from wtg_gym.physics import wind_turbine as equations
from wtg_gym.physics.aerodynamics import power_coefficient_at
from wtg_gym.physics.rotor_table import tabulated_power_coefficient
from wtg_gym.physics.units import ENV, UNITS, Connection, Failure, Phasor
from wtg_gym.physics.wind_turbine import Extension, ExtensionState, Turbine, WtgInput, WtgState
from wtg_gym.systems import expressions as ex
from wtg_gym.systems.elementary import fma, select
from wtg_gym.systems.systems import Kind, each, system

#: Phases of a search: both ends, the rotor speed between them, pitch steps at the limit, the pitch angle between two.
_LOW, _HIGH, _ROTOR, _NO_PITCH, _PITCH_STEPS, _PITCH, _SOLVED, _UNSOLVABLE = map(float, range(8))
_PITCH_STEP = 0.02  # [deg]


class Search(NamedTuple):
    """A search for the state at which a turbine's captured power equals k ω_m³, and falls faster."""

    phase: float
    low: float  # rotor speed [p.u.], then pitch angle [deg]
    high: float
    before: float  # power captured at `low`, in pitch steps [p.u.]


GROUPS = Kind(
    name="WTG groups",
    rows={
        "state": WtgState,
        "inputs": WtgInput,
        "output": equations.WtgOutput,
        "extremes": equations.WtgExtremes,
        "trip_cause": float,  # of units.TripCause
    },
    scratch={
        "captured": float,  # power from the wind, connected or not [p.u.]
        "search": Search,  # for the equilibrium
    },
    # The share is the rating on the base of the system.
    constants={"turbine": Turbine, "cells": ex.Cells, "share": float, "inv_share": float},
    sees={"unit": UNITS, "island": units.ISLANDS, "env": ENV},
    states=("state",),
)


@system(GROUPS, "search", "rotor_speed", "pitch")
def start_search(inputs: WtgInput, turbine: Turbine) -> tuple[Search, float, float]:
    """Begin to look for the equilibrium of the turbine at a tip-speed ratio of 3.5 … 20 outside the stall."""
    scale = inputs.wind_start / turbine.rotor.tip_speed
    low = max(3.5, turbine.limits.stall_tip_speed_ratio) * scale
    return Search(_LOW, low, 20.0 * scale, 0.0), low, 0.0


@system(GROUPS, "search", "rotor_speed", "pitch", "searching")
def advance_search(
    search: Search,
    rotor_speed: float,
    pitch: float,
    own_captured: float,
    k_nominal: float,
    curtailment: float,
    turbine: Turbine,
    searching: float,
) -> tuple[Search, float, float, float]:
    """Judge the state that was tried by the power that it captures, and choose the next.

    The search ends at the root of p_w(ω_m) = k ω_m³ at β = 0, unless captured power or rotor speed would exceed the
    pitch protection's limits: then at the limit, and at the smallest pitch angle that holds it on a falling branch of
    C_p.
    """
    k = curtailment * k_nominal
    target = k * (rotor_speed * (rotor_speed * rotor_speed))
    above, falls = own_captured > target, own_captured <= target
    limit = min((turbine.pitch.power_limit / k) ** (1.0 / 3.0), turbine.pitch.rotor_speed_limit)
    tries_rotor, steps, tries_pitch = search.phase == _ROTOR, search.phase == _PITCH_STEPS, search.phase == _PITCH
    # The power falls through the target between the last pitch angle and this one.
    crossed = steps & (search.before > target) & falls
    trial = select(tries_rotor, rotor_speed, pitch)
    halves = tries_rotor | tries_pitch
    low = select(crossed, search.low, select((halves & above) | steps, trial, search.low))
    high = select((halves & falls) | crossed, trial, search.high)
    middle = 0.5 * (low + high)
    settled = (middle == low) | (middle == high)
    # Each phase in its turn; a phase that goes on keeps its number.
    phase = select(search.phase == _LOW, select(above, _HIGH, _UNSOLVABLE), search.phase)
    enters_rotor = (search.phase == _HIGH) & (own_captured < target)
    phase = select(search.phase == _HIGH, select(enters_rotor, _ROTOR, _UNSOLVABLE), phase)
    ends_rotor = (tries_rotor | enters_rotor) & settled
    phase = select(ends_rotor, select(middle <= limit, _SOLVED, _NO_PITCH), phase)
    phase = select(search.phase == _NO_PITCH, _PITCH_STEPS, phase)
    phase = select(crossed, _PITCH, select(steps & (low >= turbine.pitch.largest_angle), _UNSOLVABLE, phase))
    phase = select((phase == _PITCH) & settled, _SOLVED, phase)
    low = select(phase == _NO_PITCH, 0.0, low)
    rotor = select((phase == _ROTOR) | ((phase == _SOLVED) & ends_rotor), middle, rotor_speed)
    rotor = select(phase == _HIGH, high, select(phase == _NO_PITCH, limit, rotor))
    angle = select((phase == _PITCH) | ((phase == _SOLVED) & (search.phase == _PITCH)), middle, pitch)
    angle = select(phase == _PITCH_STEPS, low + _PITCH_STEP, angle)
    unsettled = searching + select(phase < _SOLVED, 1.0, 0.0)
    return Search(phase, low, high, own_captured), rotor, angle, unsettled


@system(GROUPS, "planned_power", "failure")
def plan_group(
    search: Search,
    rotor_speed: float,
    k_nominal: float,
    curtailment: float,
    share: float,
    connection: Connection,
    failure: Failure,
) -> tuple[float, Failure]:
    """Return what a group feeds in before any policy has acted, and note one without an equilibrium."""
    power = share * (curtailment * k_nominal) * (rotor_speed * (rotor_speed * rotor_speed))
    return power, units.noted(
        search.phase == _SOLVED, units.StartFailure.NO_TURBINE_EQUILIBRIUM, connection.number, failure
    )


@system(GROUPS, "state", "emf", "connected", "extremes")
def start_group(
    start: units.Terminal, connection: Connection, rotor_speed: float, pitch: float, frame: float
) -> tuple[WtgState, float, float, equations.WtgExtremes]:
    """Return the state of a group in the equilibrium that the search has found, and its internal voltage."""
    emf, angle = units.internal_voltage(start, connection)
    converter = gfm.ConverterState(angle=angle - frame, speed=1.0, filter=0.0)
    state = WtgState(
        converter, rotor_speed, equations.PitchState(pitch, pitch), energy_captured=0.0, energy_delivered=0.0
    )
    return state, emf, 1.0, equations.WtgExtremes(-math.inf, math.inf, -math.inf, 0.0)


@system(GROUPS, "k_min", "k_nominal", "k_max", when="no machine")
def curtail_law(k_min: float, k_nominal: float, k_max: float, curtailment: float) -> tuple[float, float, float]:
    """Return the law with which a group takes its part of the balance."""
    return curtailment * k_min, curtailment * k_nominal, curtailment * k_max


@system(GROUPS, "voltage", when="constant voltage")
def voltage_of_group(state: WtgState, inputs: WtgInput) -> Phasor:
    """Return the voltage behind the reactance."""
    return units.phasor(inputs.emf, state.converter.angle)


@system(GROUPS, "own_captured", when="curve")
def capture_by_curve(state: WtgState, inputs: WtgInput, turbine: Turbine, fraction: float) -> float:
    """Return the power from the wind."""
    wind, c = equations.wind_at(inputs, fraction), turbine.rotor
    tip = c.tip_speed * max(state.rotor_speed, 1e-3)
    return c.wind_power * wind * wind * wind * power_coefficient_at(tip, wind, state.pitch.pitch, c.curve)


@system(GROUPS, "own_captured", when="table")
def capture_by_table(state: WtgState, inputs: WtgInput, turbine: Turbine, cells: ex.Cells, fraction: float) -> float:
    """Return the power from the wind."""
    wind, c = equations.wind_at(inputs, fraction), turbine.rotor
    ratio = c.tip_speed * max(state.rotor_speed, 1e-3) / wind
    return c.wind_power * wind * wind * wind * tabulated_power_coefficient(ratio, state.pitch.pitch, cells, c.grid)


def power_of(voltage: Phasor, current: Phasor, inv_share: float) -> float:
    """Return the power that a group feeds in [p.u. of the group]."""
    return inv_share * (voltage.re * current.re + voltage.im * current.im)


@system(GROUPS, "state_rates", "output", when="constant voltage")
def rates_of_group(
    state: WtgState,
    voltage: Phasor,
    current: Phasor,
    inputs: WtgInput,
    own_captured: float,
    turbine: Turbine,
    inv_share: float,
    reference_speed: float,
    omega_n: float,
    fraction: float,
) -> tuple[WtgState, equations.WtgOutput]:
    """Return rates and outputs of a group that is not extended."""
    power = power_of(voltage, current, inv_share)
    return equations.wtg_rates(
        state, power, own_captured, equations.wind_at(inputs, fraction), inputs, turbine, reference_speed, omega_n
    )


stage_of_group = units.moving(rates_of_group, equations.wtg_limited, constants=["turbine"])
#: A voltage that moves by less than this in a sweep has settled [p.u.]; the squares are compared.
_SETTLED = 1e-12 * 1e-12
EXTENSIONS = Kind(
    name="extensions",
    rows={
        "extension_state": ExtensionState,
        "references": gfm.VoltageInput,
        "terminal": equations.ExtensionOutput,
        "heat": float,  # of the chopper [p.u. s]
        "over_voltage": gfm.OverVoltage,
        "largest_voltage": float,  # at the terminal while connected, as protections sample it [p.u.]
    },
    scratch={
        "reactance": float,  # X_v that limits the current [p.u. of the system]
        "source": Phasor,  # voltage behind X_g before its current is limited [p.u.]
        "change": Phasor,  # of the voltage behind X_g in the latest sweep [p.u.]
    },
    constants={"extension": Extension},
    sees={"group": GROUPS, "unit": UNITS, "bus_": units.BUSES, "diagonal_": units.PAIRS, "env": ENV},
    states=("extension_state",),
)
#: The column of each extended group in the admittance matrix: one entry for every unit.
COLUMNS = Kind(name="columns", sees={"entry": units.PAIRS, "unit": UNITS, "group": EXTENSIONS})


@system(EXTENSIONS, "extension_state", "references", "heat", "over_voltage", "largest_voltage")
def start_extension(
    start: units.Terminal, emf: float, share: float
) -> tuple[ExtensionState, gfm.VoltageInput, float, gfm.OverVoltage, float]:
    """Return the equilibrium of the internal voltage, the references that keep it, and a cold chopper."""
    extension_state = ExtensionState(gfm.LimitState(0.0, 0.0, 0.0), emf)
    references = gfm.VoltageInput(start.magnitude, start.reactive / share)
    return extension_state, references, 0.0, gfm.OverVoltage(0.0, 0.0, 0.0, 0.0, 0.0), start.magnitude


@system(EXTENSIONS, "failure")
def check_extension(
    extension_state: ExtensionState,
    terminal: equations.ExtensionOutput,
    output: equations.WtgOutput,
    rotor_speed: float,
    extension: Extension,
    connection: Connection,
    failure: Failure,
) -> Failure:
    """Note a group that would start beyond the limits of its converter or of its internal voltage."""
    limits, control, emf = extension.limits, extension.voltage, extension_state.internal_voltage
    fits = (limits.power_min <= output.power) & (output.power <= gfm.most_power(rotor_speed, limits))
    fits = fits & (terminal.limiting_reactance <= 0.0)
    failure = units.noted(fits, units.StartFailure.CONVERTER_LIMIT, connection.number, failure)
    fits = (control.internal_voltage_min <= emf) & (emf <= control.internal_voltage_max)
    return units.noted(fits, units.StartFailure.INTERNAL_VOLTAGE_LIMIT, connection.number, failure)


@system(EXTENSIONS, "voltage")
def voltage_of_extended(state: WtgState, extension_state: ExtensionState) -> Phasor:
    """Return the voltage behind the reactance."""
    return units.phasor(extension_state.internal_voltage, state.converter.angle)


@system(EXTENSIONS, "reactance", "source", "exceeded")
def find_exceeded_limits(
    voltage: Phasor, unit_current: Phasor, extension: Extension, share: float, exceeded: float
) -> tuple[float, Phasor, float]:
    """Keep the voltage without a limit, and count groups whose current is too large."""
    largest = (extension.limits.current_max * share) * (extension.limits.current_max * share)
    too_large = fma(unit_current.re, unit_current.re, unit_current.im * unit_current.im) > largest
    return 0.0, voltage, exceeded + select(too_large, 1.0, 0.0)


def _current_limiter(settled: float) -> Callable[..., tuple[float, Phasor, Phasor, float]]:
    """Return the equation in which a squared change of the voltage [p.u.²] up to `settled` is none."""

    def limit_current(
        diagonal_admittance: Phasor,
        source: Phasor,
        voltage: Phasor,
        unit_current: Phasor,
        extension: Extension,
        share: float,
        unsettled: float,
    ) -> tuple[float, Phasor, Phasor, float]:
        """Find the limiting reactance with all other voltages fixed, and the voltage behind it.

        An environment without such a group, or one that has settled, keeps its bits, whatever its neighbours do.
        """
        y, e = diagonal_admittance, voltage
        free = units.plus(unit_current, y, Phasor(source.re - e.re, source.im - e.im))
        reactance = gfm.limiting_reactance(free.re, free.im, y.re, y.im, extension.limits.current_max * share)
        # E' = E - jX_v I, and I = I_0 / (1 + jX_v Y).
        d_re, d_im = 1.0 - reactance * y.im, reactance * y.re
        size = reactance / fma(d_re, d_re, d_im * d_im)
        drop_re = size * fma(free.re, d_re, free.im * d_im)
        drop_im = size * fma(free.im, d_re, -(free.re * d_im))
        change = Phasor(source.re + drop_im - e.re, source.im - drop_re - e.im)
        moves = fma(change.re, change.re, change.im * change.im) > settled
        change = Phasor(select(moves, change.re, 0.0), select(moves, change.im, 0.0))
        moved = Phasor(e.re + change.re, e.im + change.im)
        return reactance, moved, change, unsettled + select(moves, 1.0, 0.0)

    return limit_current


# Where a voltage stands is where the limit holds: derivatives follow it however little it moves.
limit_current = system(EXTENSIONS, "reactance", "voltage", "change", "unsettled", backward=_current_limiter(-1.0))(
    _current_limiter(_SETTLED)
)


@system(COLUMNS, "unit_current")
def follow_change(unit_current: Phasor, admittance: Phasor, change: Phasor) -> Phasor:
    """Return the current of a unit after the voltage of a group has changed."""
    return units.plus(unit_current, admittance, change)


@system(EXTENSIONS, "state_rates", "extension_state_rates", "output", "terminal")
def rates_of_extended(
    state: WtgState,
    extension_state: ExtensionState,
    voltage: Phasor,
    unit_current: Phasor,
    reactance: float,
    bus_magnitude: float,
    inputs: WtgInput,
    references: gfm.VoltageInput,
    group_captured: float,
    turbine: Turbine,
    extension: Extension,
    share: float,
    inv_share: float,
    reference_speed: float,
    omega_n: float,
    fraction: float,
) -> tuple[WtgState, ExtensionState, equations.WtgOutput, equations.ExtensionOutput]:
    """Return the rates of both kinds of state, and the outputs."""
    limits, converter, emf = extension.limits, turbine.converter, extension_state.internal_voltage
    power, most = power_of(voltage, unit_current, inv_share), gfm.most_power(state.rotor_speed, limits)
    limit_rates, shift, drawn = gfm.power_limiter(extension_state.limits, power, most, limits)
    connected, wind, of_frame = inputs.connected, equations.wind_at(inputs, fraction), (reference_speed, omega_n)
    rates, output = equations.wtg_rates(
        state, power, group_captured, wind, inputs, turbine, *of_frame, limiter=(shift, most)
    )
    i_re, i_im = inv_share * unit_current.re, inv_share * unit_current.im
    v_re, v_im = voltage.re + converter.reactance * i_im, voltage.im - converter.reactance * i_re
    size = math.sqrt(i_re * i_re + i_im * i_im)
    # A group that is disconnected measures its bus.
    seen = select(connected > 0.5, math.sqrt(v_re * v_re + v_im * v_im), bus_magnitude)
    terminal = equations.ExtensionOutput(reactance, seen, v_im * i_re - v_re * i_im, size, reactance * (size * share))
    emf_rate = gfm.emf_rate(emf, seen, terminal.reactive, terminal.cut, references, extension.voltage)
    speed = select(extension.conserves_energy > 0.5, max(state.rotor_speed, 0.01), 1.0)
    rotor_speed = turbine.rotor.inv_two_h * (rates.energy_captured - connected * drawn) / speed
    extension_rates = ExtensionState(each(lambda rate: connected * rate, limit_rates), connected * emf_rate)
    return rates._replace(rotor_speed=rotor_speed), extension_rates, output, terminal


stage_of_extended = units.moving(
    rates_of_extended, equations.wtg_limited, equations.extension_limited, constants=["turbine", "extension"]
)


@system(EXTENSIONS, "rotor_speed", "heat")
def keep_energy(
    state: WtgState,
    state_base: WtgState,
    extension_state: ExtensionState,
    extension_state_base: ExtensionState,
    heat: float,
    turbine: Turbine,
    extension: Extension,
    active: float,
) -> tuple[float, float]:
    """Return the rotor speed that follows from H_m ω_m² in a step of a running environment, and the chopper's heat.

    A Runge-Kutta method conserves sums of rates up to rounding, but a square only up to its truncation error. As in the
    rate, a speed below 0.01 p.u. counts as 0.01.
    """
    chopped, runs = extension_state.limits.energy_chopped - extension_state_base.limits.energy_chopped, active > 0.5
    captured = state.energy_captured - state_base.energy_captured
    kept = captured - (state.energy_delivered - state_base.energy_delivered) - chopped
    square = fma(2.0 * turbine.rotor.inv_two_h, kept, state_base.rotor_speed * state_base.rotor_speed)
    speed = select(extension.conserves_energy > 0.5, math.sqrt(max(square, 1e-4)), state.rotor_speed)
    return select(runs, speed, state.rotor_speed), select(runs, fma(extension.limits.heat_kept, heat, chopped), heat)


@system(EXTENSIONS, "connected", "next_change", "trip_cause")
def judge_chopper(
    heat: float,
    inputs: WtgInput,
    extension: Extension,
    next_change: float,
    trip_cause: float,
    step: float,
    active: float,
) -> tuple[float, float, float]:
    """Disconnect a group whose chopper is full: its DC voltage would rise without an end."""
    full = (heat > extension.limits.chopper_energy) & (inputs.connected > 0.5) & (active > 0.5)
    cause = select(full, float(units.TripCause.CHOPPER), trip_cause)
    return select(full, 0.0, inputs.connected), select(full, step, next_change), cause


@system(EXTENSIONS, "connected", "next_change", "trip_cause", "over_voltage", "largest_voltage")
def judge_over_voltage(
    terminal_voltage: float,
    inputs: WtgInput,
    over_voltage: gfm.OverVoltage,
    largest_voltage: float,
    next_change: float,
    trip_cause: float,
    step: float,
    active: float,
    simulation_dt: float,
) -> tuple[float, float, float, gfm.OverVoltage, float]:
    """Disconnect a group whose voltage has been above one of `OVER_VOLTAGES` for longer than it has to stay."""
    watched, trips = (inputs.connected > 0.5) & (active > 0.5), inputs.connected < 0.0
    steps = []
    for (level, time_s), last in zip(gfm.OVER_VOLTAGES, over_voltage, strict=True):
        last_below = select((terminal_voltage > level) & watched, last, step)
        trips = trips | ((step - last_below) * simulation_dt > time_s)
        steps.append(last_below)
    return (
        select(trips, 0.0, inputs.connected),
        select(trips, step, next_change),
        select(trips, float(units.TripCause.OVER_VOLTAGE), trip_cause),
        gfm.OverVoltage(*steps),
        select(watched, max(largest_voltage, terminal_voltage), largest_voltage),
    )
