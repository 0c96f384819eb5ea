"""Controls of machines as units of kinds of their own: what stabilisers, exciters and governors have in common.

Only some machines have them, and a plant without them runs none of their systems. Controls act by overwriting inputs of
their machine before its integration step: a stabiliser shifts the reference of its machine's exciter, an exciter sets
the field voltage, a governor with its turbine the torque. The copies that the machine keeps of field voltage and torque
follow from states of the control and are no states of the plant.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from wtg_gym.physics.machine import Machine, MachineInput, MachineVoltage, gate_limits, terminal_voltage
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.units import ENV, UNITS, ControlJoining, Failure, Phasor, StartFailure, moving, noted
from wtg_gym.systems.elementary import clip, limited_rate, select
from wtg_gym.systems.systems import Kind, System, count, each, system


def inverse(time_s: float) -> float:
    """Return 1/T of a time constant [1/s], 0 for none."""
    return 1.0 / time_s if time_s > 0.0 else 0.0


class Constants:
    """What makes the constants of a control: a record of its machine's number and of all parameters by their names.

    With each time constant `x_time_s` comes its inverse `inv_x_time` [1/s], 0 for none; `besides` makes further ones
    from the parameters. Of several classes of parameters, one that lacks a field of the last has 0 for it.
    """

    def __init__(self, *parameters: type[Any], besides: Callable[[Any], Mapping[str, Any]] = lambda _: {}) -> None:
        self.parameters, self._besides = parameters, besides
        named: Callable[..., Any] = NamedTuple  # with fields that are not known before
        usual = self._values(0, parameters[-1]())
        self.record = named(parameters[-1].MODEL, [(name, type(value)) for name, value in usual.items()])

    def __call__(self, machine: int, parameters: Any) -> Any:
        """Return the constants of the control of a machine, given by its index."""
        return self.record(**self._values(machine, parameters))

    def _values(self, machine: int, parameters: Any) -> dict[str, Any]:
        values = dict.fromkeys(vars(self.parameters[-1]()), 0.0) | vars(parameters)
        inverses = {f"inv_{name.removesuffix('_s')}": inverse(values[name]) for name in values if "_time" in name}
        return {"machine": machine, **values, **inverses, **self._besides(parameters)}


# Blocks: state, input and constants give the rate of the state and the output. Where the inverse of a time constant is
# 0 there is none: its state stands still, and its output is its input.


def lag(state: float, signal: float, inv_time: float) -> tuple[float, float]:
    """Return rate and output of 1/(1 + s T)."""
    return inv_time * (signal - state), select(inv_time > 0.0, state, signal)


def lead_lag(state: float, signal: float, lead_time: float, inv_lag_time: float) -> tuple[float, float]:
    """Return rate and output of (1 + s T_lead)/(1 + s T_lag)."""
    rate, output = lag(state, signal, inv_lag_time)
    return rate, output + lead_time * rate


def limited_lag(state: float, signal: float, inv_time: float, low: float, high: float) -> tuple[float, float]:
    """Return rate and output of 1/(1 + s T) with non-windup limits."""
    rate = limited_rate(inv_time * (signal - state), state, low, high)
    return rate, clip(select(inv_time > 0.0, state, signal), low, high)


class StartLimits(NamedTuple):
    """Limits beyond which a control cannot start."""

    failure: StartFailure  # what such a start is called
    state: str  # that has them
    of: Callable[[Any], tuple[float, float]]  # limits of that state at rest, from the parameters or the constants


class ControlKind(Kind):
    """The kind of a control; :mod:`wtg_gym.physics.machine_models` finds it by its name."""


class Control(NamedTuple):
    """A model of a control."""

    kind: Kind  # what its units keep: "control", the states, and the constants "model"
    constants: Constants  # what makes those of its parameters
    systems: Mapping[str, tuple[System, ...]]  # by where they join the lists of `wtg_gym.physics.step`
    start_limits: StartLimits | None


def _kind(control: str, constants: Constants, state: type, **rows: Any) -> Kind:
    return ControlKind(
        name=f"{control} {constants.parameters[-1].MODEL}",
        rows={"control": state, **rows},
        constants={"model": constants.record},
        sees={"machine": MACHINES, "unit": UNITS, "env": ENV},
        states=("control",),
    )


def _control(
    kind: Kind,
    constants: Constants,
    start: System,
    rates: System,
    limit: Callable[[Any, Any], Any] | None = None,
    start_limits: StartLimits | None = None,
) -> Control:
    """Return a control: its start, its rates, and what follows from them; `limit` holds states within their limits."""
    systems: dict[str, tuple[System, ...]] = {
        ControlJoining.SETTLE: (start,),
        ControlJoining.MOVE: (moving(rates, limit, constants=["model"]),),
        ControlJoining.RATES: (rates,),
    }
    if start_limits is not None:
        failure, limited, limits_of = start_limits

        @system(kind, "env_failure")
        def check_control(control: Any, model: Any, env_failure: Failure) -> Failure:
            low, high = limits_of(model)
            value = getattr(control, limited)
            return noted((low <= value) & (value <= high), failure, model.machine, env_failure)

        systems[ControlJoining.START] = (check_control,)
    return Control(kind, constants, systems, start_limits)


def stabiliser(
    constants: Constants, state: type, rates: Callable[[Any, float, float, Any], tuple[Any, float]]
) -> Control:
    """Return a stabiliser, whose states are 0 at nominal speed.

    `rates` gives rates and signal [p.u.] at states, speed deviation, terminal voltage [p.u.] and constants.
    """
    kind = _kind("stabilisers", constants, state, set_point=float)

    @system(kind, "control", "set_point")
    def start_stabiliser(voltage_reference: float) -> tuple[Any, float]:
        return state(*(0.0,) * count(state)), voltage_reference

    @system(kind, "control_rates", "voltage_reference")
    def rates_of_stabiliser(
        control: Any,
        set_point: float,
        speed: float,
        inputs: MachineInput,
        emf: MachineVoltage,
        current: Phasor,
        inv_committed: float,
        machine: Machine,
        model: Any,
    ) -> tuple[Any, float]:
        voltage = terminal_voltage(emf, inv_committed * current.re, inv_committed * current.im, machine)
        state_rates, signal = rates(control, speed - 1.0, voltage, model)
        return each(lambda rate: inputs.connected * rate, state_rates), set_point + signal

    return _control(kind, constants, start_stabiliser, rates_of_stabiliser)


def exciter(
    constants: Constants,
    state: type,
    rates: Callable[[Any, float, float, Any], Any],
    start: Callable[[float, float, Any], tuple[Any, float]],
) -> Control:
    """Return an exciter; its states have the field voltage as `excitation`, and a `regulator` with limits.

    `rates` are those at states, reference, terminal voltage [p.u.] and constants; `start` gives the equilibrium at a
    field voltage and a terminal voltage [p.u.], and the voltage error that it needs.
    """
    kind = _kind("exciters", constants, state)

    @system(kind, "control", "voltage_reference")
    def start_exciter(field_voltage: float, voltage_reference: float, model: Any) -> tuple[Any, float]:
        # Without an exciter of its own the machine takes the voltage at its terminal for the reference.
        control, error = start(field_voltage, voltage_reference, model)
        return control, voltage_reference + error

    @system(kind, "control_rates", "field_voltage")
    def rates_of_exciter(
        control: Any,
        inputs: MachineInput,
        emf: MachineVoltage,
        current: Phasor,
        inv_committed: float,
        machine: Machine,
        model: Any,
    ) -> tuple[Any, float]:
        voltage = terminal_voltage(emf, inv_committed * current.re, inv_committed * current.im, machine)
        state_rates = rates(control, inputs.voltage_reference, voltage, model)
        return each(lambda rate: inputs.connected * rate, state_rates), control.excitation

    def limits(c: Any) -> tuple[float, float]:
        return c.regulator_min_pu, c.regulator_max_pu

    return _control(
        kind,
        constants,
        start_exciter,
        rates_of_exciter,
        lambda s, c: s._replace(regulator=clip(s.regulator, *limits(c))),
        StartLimits(StartFailure.EXCITER_LIMIT, "regulator", limits),
    )


def governor(
    constants: Constants,
    state: type,
    rates: Callable[[Any, float, float, float, Any], tuple[Any, float]],
    start: Callable[[float, Any], Any],
    gate: str = "valve",
    limit: Callable[[Any, Any], Any] = lambda s, c: s._replace(valve=clip(s.valve, c.gate_min_pu, c.gate_max_pu)),
) -> Control:
    """Return a governor with its turbine.

    `rates` gives rates and torque, on the base of the machine, at states, speed, reference [p.u.], 1/R in use and
    constants. Without a droop the governor is lost, and the state `gate`, which is the reference at the start, stands
    still. `start` gives the equilibrium at a torque [p.u.], `limit` the states within their limits.
    """
    kind = _kind("governors", constants, state)

    @system(kind, "control", "gate_reference")
    def start_governor(gate_reference: float, model: Any) -> tuple[Any, float]:
        control = start(gate_reference, model)
        return control, getattr(control, gate)

    @system(kind, "control_rates", "turbine_torque")
    def rates_of_governor(
        control: Any, speed: float, inputs: MachineInput, machine: Machine, model: Any
    ) -> tuple[Any, float]:
        state_rates, torque = rates(control, speed, inputs.gate_reference, inputs.inv_droop, model)
        return each(lambda rate: inputs.connected * rate, state_rates), machine.rating * torque

    start_limits = StartLimits(StartFailure.GOVERNOR_LIMIT, gate, gate_limits)
    return _control(kind, constants, start_governor, rates_of_governor, limit, start_limits)
