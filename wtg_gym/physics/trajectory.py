"""One run, recorded: what `wtg-gym simulate` plots and the paper's claims are read from."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.physics import plant, protection
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import TrackingLaw, group_laws
from wtg_gym.physics.units import BUSES, TripCause


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """A recorded run, one sample per control interval and one at the start."""

    time_s: Floats  # (n,) [s]
    frequency_hz: Floats  # centre of inertia (n,) [Hz]
    wtg_frequency_hz: Floats  # of each group's voltage (n, n_wtg) [Hz]
    machine_frequency_hz: Floats  # of each synchronous machine (n, n_sync) [Hz]
    bus_frequency_hz: Floats  # local (n, n_bus); (n, 0) where the physics is the paper's [Hz]
    bus_voltage_pu: Floats  # magnitude (n, n_bus) [p.u.]
    machine_power_pu: Floats  # electrical, of the air gap, on the base of the system (n, n_sync) [p.u.]
    machine_torque_pu: Floats  # mechanical, on the base of the system (n, n_sync) [p.u.]
    rotor_speed_pu: Floats  # (n, n_wtg) [p.u.]
    tip_speed_ratio: Floats  # (n, n_wtg) [-]
    power_pu: Floats  # delivered, on each group's base (n, n_wtg) [p.u.]
    reactive_power_pu: Floats  # delivered at the bus, on each group's base (n, n_wtg) [p.u.]
    current_pu: Floats  # of the converter, on each group's base (n, n_wtg) [p.u.]
    limited: npt.NDArray[np.bool_]  # whether the current limiter takes voltage away (n, n_wtg)
    connected: npt.NDArray[np.bool_]  # (n, n_wtg); the power of a trip's sample is that before it
    captured_power_pu: Floats  # (n, n_wtg) [p.u.]
    coefficient_pu: Floats  # tracking coefficient k (n, n_wtg) [p.u.]
    filter_pu: Floats  # state x of the transient damping, 0 where τ is 0 or infinite (n, n_wtg) [p.u.]
    pitch_deg: Floats  # (n, n_wtg) [deg]
    wind_m_s: Floats  # (n, n_wtg) [m/s]
    shed_energy_mws: Floats  # load not served since the start, at 1 p.u. of voltage (n,) [MW s]
    #: Every state of the simulator by its name, such as "sync0.gate", those of user-defined devices among them (n,).
    states: Mapping[str, Floats]
    trip_causes: tuple[TripCause | None, ...]  # why each group tripped, None where it did not
    status: protection.Status  # why the run ended before its time, or RUNNING
    nominal_frequency_hz: float  # [Hz]

    @property
    def local_frequency_hz(self) -> Floats:
        """Frequencies of all groups, machines and buses (n, any) [Hz]; after its loss a unit's stands still."""
        return np.concatenate([self.wtg_frequency_hz, self.machine_frequency_hz, self.bus_frequency_hz], axis=1)

    def rocof_hz_s(self, window_s: float = 0.5) -> Floats:
        """Return the rate of change of the frequency over a sliding window [s], (n,) [Hz/s]; zero before the first."""
        frequency, time_s = self.frequency_hz, self.time_s
        steps = max(1, round(window_s / (time_s[1] - time_s[0]))) if time_s.size > 1 else 1
        change = np.zeros_like(frequency)
        if time_s.size > steps:
            change[steps:] = (frequency[steps:] - frequency[:-steps]) / (time_s[steps:] - time_s[:-steps])
        return change


def simulate(
    scenario: Scenario, laws: str | TrackingLaw | Sequence[str | TrackingLaw], settings: plant.Plant | None = None
) -> Trajectory:
    """Run a scenario and record it; if a protection ends it, the last sample is of that instant.

    There is one law or its name for all WTG groups, or one per group; a name is the law of the plant's turbine.
    The plant is the paper's by default. A ValueError says that scenario, laws and plant do not fit, or the run cannot
    start.
    """
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario must be a Scenario, got {type(scenario).__name__}")
    settings = settings or plant.Plant()
    simulator = Simulator(settings, duration_s=scenario.duration_s)
    groups_laws = group_laws(laws, settings.turbines, settings.control)
    simulator.start(0, simulator.prepare([scenario], groups_laws, turning=True))
    return Trajectory(**record(simulator, lambda _: simulator.advance()))


def record(simulator: Simulator, advance: Callable[[int], Any]) -> dict[str, Any]:
    """Record the run of the first environment of a simulator, as the arguments of a :class:`Trajectory`.

    Args:
        simulator: has started a run.
        advance: advances it by the control interval of a number.
    """
    samples, settings = [_sample(simulator)], simulator.settings
    for interval in range(simulator.n_intervals):
        if simulator.env_values("active")[0] < 0.5:
            break
        advance(interval)
        samples.append(_sample(simulator))
    grid, groups, machines, buses, states, terminals, voltages = (
        np.array(column) for column in zip(*samples, strict=True)
    )
    nominal, time = settings.case.frequency_hz, np.arange(len(grid), dtype=np.float64) * settings.interval_s
    status = protection.Status(int(simulator.env_values("status")[0]))
    if status != protection.Status.RUNNING:
        # A protection may act within a control interval.
        time[-1] = min(time[-1], simulator.env_values("step")[0] * settings.simulation_dt)
    of_group = dict(zip(_OF_GROUPS, groups.swapaxes(0, 1), strict=True))
    tip_speed = np.array([turbine.tip_speed_ratio_per_speed_m_s for turbine in settings.turbines])
    reactive, current, cut, connected = terminals.swapaxes(0, 1)
    trips = zip(connected[-1] < 0.5, simulator.wtg_values("trip_cause")[0], strict=True)
    return dict(
        time_s=time,
        frequency_hz=nominal * grid[:, 0],
        wtg_frequency_hz=nominal * (of_group["speed"] + of_group["shift"]),
        machine_frequency_hz=nominal * machines[:, 0],
        bus_frequency_hz=nominal * buses,
        bus_voltage_pu=voltages,
        machine_power_pu=machines[:, 1],
        machine_torque_pu=machines[:, 2],
        rotor_speed_pu=of_group["rotor_speed"],
        tip_speed_ratio=tip_speed * of_group["rotor_speed"] / of_group["wind"],
        power_pu=of_group["power"],
        reactive_power_pu=reactive,
        current_pu=current,
        limited=cut > 1e-9,
        connected=connected > 0.5,
        captured_power_pu=of_group["captured"],
        coefficient_pu=of_group["coefficient"],
        filter_pu=of_group["filter"],
        pitch_deg=of_group["pitch"],
        wind_m_s=of_group["wind"],
        shed_energy_mws=settings.case.base_mva * grid[:, 1],
        states=dict(zip(simulator.layout.state_names, states.T, strict=True)),
        trip_causes=tuple(TripCause(int(cause)) if tripped else None for tripped, cause in trips),
        status=status,
        nominal_frequency_hz=nominal,
    )


#: What is recorded of a WTG group.
_OF_GROUPS = ("speed", "rotor_speed", "power", "captured", "coefficient", "filter", "pitch", "wind", "shift")


def _sample(simulator: Simulator) -> tuple[Any, ...]:
    """Return what is recorded of grid, WTG groups, machines, buses and states."""
    n_bus = simulator.plant.buses.size if simulator.settings.extended else 0
    return (
        [simulator.env_values(name)[0] for name in ("coi", "shed_energy")],
        [simulator.wtg_values(name)[0] for name in _OF_GROUPS],
        [simulator.machine_values(name)[0] for name in ("speed", "power", "torque")],
        simulator.blocks[0, simulator.layout.rows_of(BUSES, "frequency")[:n_bus], 0],
        simulator.state(),
        *_electrical(simulator),
    )


def _electrical(simulator: Simulator) -> tuple[Floats, Floats]:
    """Return reactive power, current, what its limiter takes, and connection of groups (4, n_wtg); voltages of buses.

    Extended physics has them, voltages as protections sample them; else they follow from the network.
    """
    layout, network = simulator.layout, simulator.plant.network
    if layout.n_extended:
        of_groups = [simulator.wtg_values(name)[0] for name in ("reactive", "current", "cut", "connected")]
        return np.array(of_groups), simulator.blocks[0, layout.rows_of(BUSES, "magnitude"), 0]
    voltages, units = simulator.bus_voltages(), slice(layout.n_sync, layout.n_sync + layout.n_wtg)
    emf, angle, connected = (simulator.wtg_values(name)[0] for name in ("emf", "angle", "connected"))
    at_groups = voltages[network.unit_bus[units]]
    current = connected * network.unit_y[units] / simulator.plant.share * (emf * np.exp(1j * angle) - at_groups)
    reactive = (at_groups * current.conj()).imag
    return np.array([reactive, np.abs(current), np.zeros_like(reactive), connected]), np.abs(voltages)
