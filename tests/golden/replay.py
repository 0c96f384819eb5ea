"""Run a golden case here, and compare it with its trace."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from tests.golden.case import ROW_S, Case, machine_powers
from tests.physics.extended import scenario
from wtg_gym.physics.parameters import ConverterLimitParameters, ProtectionParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Event, LineTrip
from wtg_gym.physics.simulator import Simulator


def replay(case: Case, events: Sequence[Event], time_s: np.ndarray, step_s: float) -> dict[str, np.ndarray]:
    """Run a case and return every column that a trace may hold, each (n,); a value at an event is the one before it.

    Events are at whole steps of `step_s`, which divides ROW_S; the rows' times (n,) rise, multiples of ROW_S. All in s.
    """
    opened = {case.network.branch_index(e.from_bus, e.to_bus) for e in events if isinstance(e, LineTrip)}
    splits = len(case.network.parts_without(tuple(opened))) > 1
    # The other simulators have no protection. Islands need extended physics, which changes no machine.
    limits = ConverterLimitParameters() if splits else None
    given = {"protection": ProtectionParameters(frequency_min_pu=0.5), "limits": limits, "simulation_dt": step_s}
    duration_s, noise_bus = float(time_s[-1]), case.network.bus_numbers[0]
    simulator = Simulator(Plant(case=case.network, groups=(), interval_s=ROW_S, **given), duration_s=duration_s)
    what = scenario(*events, wind=np.zeros((0, 1)), duration_s=duration_s, load_noise_bus=noise_bus)
    simulator.start(0, what, ())
    _require_power_flow(case, simulator)
    table = np.array(sampled(simulator, time_s, _columns))
    return dict(zip(case.columns, table.T, strict=True))


def sampled(simulator: Simulator, time_s: np.ndarray, look: Callable[[Simulator], np.ndarray]) -> list[np.ndarray]:
    """Return what is seen of a running simulator at some multiples of its control interval [s]."""
    seen, interval = [], 0
    for wanted in np.round(time_s / simulator.settings.interval_s).astype(int):
        for _ in range(wanted - interval):
            simulator.advance()
        interval = wanted
        simulator.evaluate()
        seen.append(look(simulator))
    assert simulator.env_values("status")[0] == 0.0
    return seen


def differences(case: Case, trace: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Return the largest difference of each quantity that both hold; angles count modulo a turn."""
    largest: dict[str, float] = {}
    for name, quantity in case.columns.items():
        if name in trace and name in found:
            gap = np.abs(found[name] - trace[name])
            if quantity in ("delta", "th"):
                gap = np.abs(np.remainder(gap + np.pi, 2.0 * np.pi) - np.pi)
            largest[quantity] = max(largest.get(quantity, 0.0), float(gap.max()))
    return largest


def _require_power_flow(case: Case, simulator: Simulator) -> None:
    simulator.evaluate()
    own, given = simulator.bus_voltages(), np.array(list(case.voltage.values()))
    slack = case.network.bus_index(case.network.slack_bus)
    assert np.abs(own / own[slack] - given / given[slack]).max() < 1e-5, f"{case.network.name}: other voltages"
    result = dict(zip(case.columns, _columns(simulator), strict=True))
    for key, power in case.power.items():
        assert abs(complex(result[f"Pe{key}"], result[f"Qe{key}"]) - power) < 1e-4, f"machine {key}: other power"


def _columns(simulator: Simulator) -> np.ndarray:
    reference, power, voltage = simulator.env_values("angle"), machine_powers(simulator), simulator.bus_voltages()
    speed, torque, angle = (simulator.machine_values(name)[0] for name in ("speed", "torque", "angle"))
    of_buses = np.abs(voltage), np.angle(voltage * np.exp(1j * reference))
    return np.concatenate([speed, power.real, power.imag, torque, angle + reference, *of_buses])
