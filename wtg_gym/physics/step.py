"""The step of the simulation: what happens, in its order.

A control interval (:mod:`wtg_gym.physics.integration`):

    enter → admittances → n × (events → 4 × (find → move) → finish, and protect every 0.1 s) → find → rates

The start of a run (:mod:`wtg_gym.physics.equilibrium`):

    plan → power flow, balance, release until none → settle → reduction → admittances → find → rates → start

Each name is a list of systems over all units of a kind, and of operations that are not maps over units. Kinds of
unit that a plant has besides (:mod:`wtg_gym.physics.devices`), and controls that only some machines have
(:mod:`wtg_gym.physics.machine_models`), join where it says `Here`.
"""

import math

from wtg_gym.physics import machine_unit as machine
from wtg_gym.physics import protection, starting, units
from wtg_gym.physics import wtg_unit as wtg
from wtg_gym.physics.units import ENV, ISLANDS, PAIRS, UNITS, ControlJoining, Joining
from wtg_gym.physics.wtg_unit import GROUPS
from wtg_gym.systems.programs import Each, Here, Product, Repeat, When
from wtg_gym.systems.systems import setting

#: Gauss-Seidel sweeps over the groups whose current is limited, at most: a few, but some thirty for large groups at a
#: weak bus. They end once no voltage moves.
_SWEEPS = 100

VOLTAGES = (
    setting(ENV, "no machine", reference_speed=1.0),
    machine.reference,
    machine.voltage_of_machine,
    machine.saturate_machine,
    wtg.voltage_of_group,
    wtg.voltage_of_extended,
    Here(Joining.VOLTAGES),
)

ADMITTANCES = (units.load_noise, units.admittance_with_noise)

#: Currents without a limit, and which of them are too large.
FREE_CURRENTS = (
    Product(PAIRS, "admittance", UNITS, "voltage", "current"),
    setting(ENV, exceeded=0.0),
    wtg.find_exceeded_limits,
)

#: A sweep over the groups: each finds its voltage with all others fixed, and all currents follow.
SWEEP = (setting(ENV, unsettled=0.0), Each(wtg.limit_current, wtg.follow_change))

LIMITS = (When(ENV, "exceeded", (Repeat(ENV, "unsettled", SWEEP, most=_SWEEPS),)),)

FLOWS = (*VOLTAGES, *FREE_CURRENTS)

CAPTURE = (wtg.capture_by_curve, wtg.capture_by_table)

#: What every evaluation begins with: voltages and currents, then the power from the wind.
FIND = (*FLOWS, *LIMITS, *CAPTURE)

#: One stage of the Runge-Kutta method, after `FIND`: it finds the rates of every unit and moves its states.
MOVE = (
    Here(ControlJoining.MOVE),
    machine.stage_of_machine,
    wtg.stage_of_group,
    wtg.stage_of_extended,
    Here(Joining.MOVE),
    units.reference_stage,
)

#: Rates and outputs, without moving any state, after `FIND`.
RATES = (
    Here(ControlJoining.RATES),
    machine.rates_of_machine,
    wtg.rates_of_group,
    wtg.rates_of_extended,
    Here(Joining.RATES),
    units.reference_rate,
)

COI = (
    setting(ISLANDS, sums=units.Sums(0.0, 0.0)),
    protection.add_machine,
    protection.add_group,
    When(ENV, "split", (protection.add_member,)),
    protection.centre_of_inertia,
    protection.centre_of_grid,
)

#: After a simulation step. The part with a way back comes first.
MOVED = (wtg.keep_energy, units.count_step, machine.restore_frequency, *COI)
WATCH = (
    protection.track_extremes,
    protection.count_shed_energy,
    protection.reset_alarm,
    protection.alarm_island,
    When(ENV, "alarm", (protection.shed_load,)),
)
FINISH = (*MOVED, *WATCH)

PROTECT = (
    *protection.LOCAL,
    setting(ISLANDS, spread=units.Spread(math.inf, -math.inf, math.inf)),
    protection.sample_machine,
    protection.sample_group,
    Here(Joining.SAMPLE),
    protection.compare_unit,
    When(ENV, "split", (protection.compare_member,)),
    protection.judge_island,
    protection.judge_grid,
    When(ENV, "split", (protection.fall_member, protection.trip_machine)),
    protection.judge_rotor,
    wtg.judge_chopper,
    wtg.judge_over_voltage,
    protection.end_run,
    protection.freeze_wind,
)

#: Trials of the search for a turbine's equilibrium, at most: pitch steps of 0.02°, and bisections.
_TRIALS = 10_000

#: What buses and units bring to the power flow.
PLAN = (
    setting(ENV, failure=units.Failure(0.0, 0.0)),
    starting.plan_bus,
    wtg.start_search,
    Repeat(ENV, "searching", (*CAPTURE, setting(ENV, searching=0.0), wtg.advance_search), most=_TRIALS),
    wtg.plan_group,
    setting(ENV, needed=0.0),
    starting.add_needed_load,
    starting.subtract_group_power,
    machine.subtract_machine_power,
    machine.plan_machine,
    Here(Joining.PLAN),
    starting.plan_unit,
)

#: After a power flow: machines share what the slack bus lacks.
BALANCE = (setting(ENV, lacking=0.0), starting.find_slack_mismatch, starting.balance_unit)

#: After a power flow: buses whose groups cannot hold the voltage let go of it.
RELEASE = (setting(ENV, released=0.0), starting.release_voltage)

#: After the last one: every unit finds its equilibrium, from what it delivers.
SETTLE = (
    starting.load_at_bus,
    starting.share_flow,
    machine.start_machine,
    Here(ControlJoining.SETTLE),
    setting(ENV, "no machine", frame=0.0),
    machine.find_frame,
    machine.turn_machine,
    wtg.start_group,
    wtg.curtail_law,
    wtg.start_extension,
    Here(Joining.SETTLE),
    starting.start_angle,
    # An event at t = 0 strikes in the first step, not before.
    setting(ENV, active=1.0, status=0.0, noise_y=0.0, step=-1.0, last_change=-2.0, split=0.0),
    setting(ENV, coi_min=math.inf, coi_max=-math.inf, shed_energy=0.0, was_low=0.0),
    setting(ENV, worst=1.0, worst_min=1.0, worst_max=1.0, sampled_step=0.0),
    setting(ISLANDS, healthy_step=0.0, centre=1.0, turned=0.0),
    setting(UNITS, own_island=0.0),
)

#: After the first evaluation of a run: its first outputs, and what is beyond its limits then.
START = (
    setting(ENV, step=0.0),
    *protection.BUS_VOLTAGES,
    protection.start_bus,
    *COI,
    protection.track_extremes,
    setting(GROUPS, overload_time=0.0),
    machine.check_machine,
    Here(ControlJoining.START),
    wtg.check_extension,
    Here(Joining.START),
)
