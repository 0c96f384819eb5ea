"""Controls of machines as units of kinds of their own: what stabilisers, exciters and governors have in common.

Only some machines have them, and a plant without them runs none of their systems. A control says what it does through
rows that its machine has anyway, before the machine is moved: a stabiliser shifts the reference of its machine's
exciter, an exciter sets the field voltage, a governor with its turbine the torque. The copies that the machine keeps of
field voltage and torque follow from states of the control and are no states of the plant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from wtg_gym.physics.machine import Machine, MachineInput, MachineVoltage, terminal_voltage
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.runge_kutta import moving
from wtg_gym.physics.units import LANE, UNITS, Back, Phasor, StartFailure, noted
from wtg_gym.systems.elementary import select
from wtg_gym.systems.records import each
from wtg_gym.systems.systems import Kind, System, system


def _unlimited(model: Any) -> tuple[float, float]:
    return -math.inf, math.inf


@dataclass(frozen=True, eq=False, kw_only=True)
class Control:
    """A model of a control.

    Args:
        kind: what its units keep: "control", the states, and the constants "model", which begin with the number of the
            machine.
        constants: the function of that number and of the parameters that returns them.
        systems: by the places of :mod:`wtg_gym.physics.step` where they join.
        failure: what a start beyond its limits is called; NONE for a control without any.
        limited: the number of "control" that has them.
        limits: from the constants.
    """

    kind: Kind
    constants: Callable[[int, Any], Any]
    systems: Mapping[str, tuple[System, ...]]
    failure: StartFailure = StartFailure.NONE
    limited: str = ""
    limits: Callable[[Any], tuple[float, float]] = _unlimited


def _kind(name: str, state: type, model: type, **rows: Any) -> Kind:
    return Kind(
        name=name,
        rows={"control": state, **rows},
        constants={"model": model},
        sees={"machine": MACHINES, "unit": UNITS, "lane": LANE},
        states=("control",),
    )


def _at(emf: MachineVoltage, current: Phasor, inv_committed: float, machine: Machine) -> float:
    """Return the voltage at a machine's terminal [p.u.]."""
    return terminal_voltage(emf, inv_committed * current.re, inv_committed * current.im, machine)


def _where(condition: bool, new: Any, old: Any) -> Any:
    return each(lambda a, b: select(condition, a, b), new, old)


def _check(kind: Kind, quantity: str, limits: Callable[[Any], tuple[float, float]], failure: StartFailure) -> System:
    """Return the system that notes a control that would start beyond its limits."""

    @system(kind, "start_failure", "failing_unit")
    def check_control(control: Any, model: Any, start_failure: float, failing_unit: float) -> tuple[float, float]:
        low, high = limits(model)
        value = getattr(control, quantity)
        fits = (low <= value) & (value <= high)
        return noted(fits, failure, model.machine, start_failure, failing_unit)

    return check_control


def stabiliser(
    name: str,
    state: type,
    model: type,
    constants: Callable[[int, Any], Any],
    rates: Callable[[Any, float, float, Any], tuple[Any, float]],
    start: Callable[[float, Any], Any],
) -> Control:
    """Return a stabiliser.

    Args:
        name: of its kind.
        state, model: records of its states and constants.
        constants: see :class:`Control`.
        rates: rates and signal [p.u.] at states, speed deviation, terminal voltage [p.u.] and constants.
        start: the equilibrium at a constant speed deviation [p.u.].
    """
    kind = _kind(name, state, model, set_point=float)

    @system(kind, "control", "set_point")
    def start_stabiliser(voltage_reference: float, model: Any) -> tuple[Any, float]:
        return start(0.0, model), voltage_reference

    @system(kind, "control_rates", "voltage_reference")
    def rates_of_stabiliser(
        control: Any,
        set_point: float,
        speed: float,
        given: MachineInput,
        emf: MachineVoltage,
        current: Phasor,
        inv_committed: float,
        machine: Machine,
        model: Any,
    ) -> tuple[Any, float]:
        found, signal = rates(control, speed - 1.0, _at(emf, current, inv_committed, machine), model)
        return each(lambda rate: given.connected * rate, found), set_point + signal

    @system(kind, "control", when="extended")
    def return_stabiliser(control: Any, returns: float, back: Back, model: Any) -> Any:
        return _where(returns > 0.5, start(back.speed - 1.0, model), control)

    systems = {
        "control settle": (start_stabiliser,),
        "control move": (moving(rates_of_stabiliser),),
        "control rates": (rates_of_stabiliser,),
        "control return": (return_stabiliser,),
    }
    return Control(kind=kind, constants=constants, systems=systems)


def exciter(
    name: str,
    state: type,
    model: type,
    constants: Callable[[int, Any], Any],
    rates: Callable[[Any, float, float, Any], Any],
    limit: Callable[[Any, Any], Any],
    start: Callable[[float, float, Any], tuple[Any, float]],
    limited: str,
    limits: Callable[[Any], tuple[float, float]],
) -> Control:
    """Return an exciter; its states have the field voltage as `excitation`.

    Args:
        name: of its kind.
        state, model: records of its states and constants.
        constants, limited, limits: see :class:`Control`.
        rates: at states, reference, terminal voltage [p.u.] and constants.
        limit: the states, held within their limits.
        start: the equilibrium at a field voltage and a terminal voltage [p.u.], and the voltage error that it needs.
    """
    kind = _kind(name, state, model)

    @system(kind, "control", "voltage_reference")
    def start_exciter(field_voltage: float, voltage_reference: float, model: Any) -> tuple[Any, float]:
        # Without an exciter of its own the machine takes the voltage at its terminal for the reference.
        control, error = start(field_voltage, voltage_reference, model)
        return control, voltage_reference + error

    @system(kind, "control_rates", "field_voltage")
    def rates_of_exciter(
        control: Any,
        given: MachineInput,
        emf: MachineVoltage,
        current: Phasor,
        inv_committed: float,
        machine: Machine,
        model: Any,
    ) -> tuple[Any, float]:
        found = rates(control, given.voltage_reference, _at(emf, current, inv_committed, machine), model)
        return each(lambda rate: given.connected * rate, found), control.excitation

    @system(kind, "control", when="extended")
    def return_exciter(control: Any, field_voltage: float, returns: float, back: Back, model: Any) -> Any:
        found, _ = start(field_voltage, back.voltage, model)
        return _where(returns > 0.5, found, control)

    systems = {
        "control settle": (start_exciter,),
        "control move": (moving(rates_of_exciter, limit, constants=["model"]),),
        "control rates": (rates_of_exciter,),
        "control return": (return_exciter,),
        "control start": (_check(kind, limited, limits, StartFailure.EXCITER_LIMIT),),
    }
    return Control(
        kind=kind,
        constants=constants,
        systems=systems,
        failure=StartFailure.EXCITER_LIMIT,
        limited=limited,
        limits=limits,
    )


def governor(
    name: str,
    state: type,
    model: type,
    constants: Callable[[int, Any], Any],
    rates: Callable[[Any, float, float, float, Any], tuple[Any, float]],
    limit: Callable[[Any, Any], Any],
    start: Callable[[float, Any], Any],
    limits: Callable[[Any], tuple[float, float]],
) -> Control:
    """Return a governor with its turbine; its states have what the gate gives as `valve`.

    Args:
        name: of its kind.
        state, model: records of its states and constants.
        constants: see :class:`Control`.
        rates: rates and torque, on the base of the machine, at states, speed, reference [p.u.], 1/R in use and
            constants. Without a droop the governor is lost, and what its gate gives stands still.
        limit: the states, held within their limits.
        start: the equilibrium at a torque [p.u.]; its `valve` is the reference.
        limits: of the valve, from the constants.
    """
    kind = _kind(name, state, model)

    @system(kind, "control", "gate_reference")
    def start_governor(gate_reference: float, model: Any) -> tuple[Any, float]:
        control = start(gate_reference, model)
        return control, control.valve

    @system(kind, "control_rates", "turbine_torque")
    def rates_of_governor(
        control: Any, speed: float, given: MachineInput, machine: Machine, model: Any
    ) -> tuple[Any, float]:
        found, torque = rates(control, speed, given.gate_reference, given.inv_droop, model)
        return each(lambda rate: given.connected * rate, found), machine.rating * torque

    @system(kind, "control", when="extended")
    def return_governor(control: Any, returns: float, model: Any) -> Any:
        return _where(returns > 0.5, start(0.0, model), control)

    systems = {
        "control settle": (start_governor,),
        "control move": (moving(rates_of_governor, limit, constants=["model"]),),
        "control rates": (rates_of_governor,),
        "control return": (return_governor,),
        "control start": (_check(kind, "valve", limits, StartFailure.GOVERNOR_LIMIT),),
    }
    return Control(
        kind=kind,
        constants=constants,
        systems=systems,
        failure=StartFailure.GOVERNOR_LIMIT,
        limited="valve",
        limits=limits,
    )
