"""Whether a law could be commissioned in v1's grid: its steady states, and ten minutes after the worst events.

`conditions.py` asks it about the anchor. In a steady state the turbine captures what the law delivers; where that is
beyond what the pitch protection leaves, it leaves that. No law may give less at a lower frequency, ask for more than
K_opt, or exceed what the converter and the generator give for long.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Event, GovernorLoss, GroupTrip, LoadStep, MachineOutage
from wtg_gym.physics.tracking_law import TrackingLaw
from wtg_gym.reproduce.steady_states import equilibria
from wtg_gym.scenarios import get_suite

SUITE = "standard-v1"
WINDS_M_S = tuple(np.arange(6.0, 14.5, 1.0).tolist())
FREQUENCIES_HZ = np.linspace(47.5, 51.5, 41)
#: Rounding of a steady state's power, in a slope [p.u./Hz].
ROUNDING = 1e-6
#: When the event comes, and how long the run lasts [s].
EVENT_S, DURATION_S = 5.0, 600.0
#: Name of the event that leaves no machine.
LAST_MACHINE = "the generator is lost"
N_SCENARIOS = 60
#: Seeds among which the largest load step is looked for.
N_SOUGHT = 300


@dataclasses.dataclass(frozen=True)
class Statics:
    """A law's steady states, over all winds and frequencies."""

    steepest: float  # largest dP/df; infinite where the turbine has no steady state below [p.u./Hz]
    steepest_at: tuple[float, float]  # wind [m/s] and frequency [Hz] of it
    capped: bool  # whether k stays at or below K_opt
    power: float  # largest [p.u.]
    torque: float  # largest [p.u.]
    slowest: float  # rotor speed [p.u.]
    within: bool  # whether the limits of power, torque and rotor speed hold


def settled(law: TrackingLaw, wind_m_s: float, frequency_hz: float, plant: Plant) -> tuple[float, float]:
    """Return power and rotor speed of a turbine where it settles [p.u.], NaN where it does not."""
    of = {"turbine": plant.turbine, "control": plant.control}
    found = equilibria(frequency_hz / plant.case.frequency_hz, law, wind_m_s, **of)
    if not found:
        return math.nan, math.nan
    k, most = _coefficient(law, frequency_hz, plant), plant.pitch.captured_power_limit_pu
    # What the law delivers besides k ω³, by its droop.
    droop = found[-1].power_pu - k * found[-1].rotor_speed_pu ** 3
    speed = min(found[-1].rotor_speed_pu, plant.pitch.rotor_speed_limit_pu)
    if k * speed**3 + droop > most:
        # Where the droop alone asks for more than the pitch leaves, the rotor slows down without an end.
        speed = ((most - droop) / k) ** (1.0 / 3.0) if most > droop else math.nan
    return k * speed**3 + droop, speed


def _coefficient(law: TrackingLaw, frequency_hz: float, plant: Plant) -> float:
    c = plant.control
    corners = (c.frequency_min_pu, c.frequency_setpoint_pu, c.frequency_max_pu)
    return float(np.interp(frequency_hz / plant.case.frequency_hz, corners, (law.k_min, law.k_nominal, law.k_max)))


def statics(law: TrackingLaw, plant: Plant, winds_m_s: Sequence[float] = WINDS_M_S) -> Statics:
    """Return what a law's steady states in a plant with limits are like, at some winds and :data:`FREQUENCIES_HZ`."""
    points = np.array([[settled(law, wind, f, plant) for f in FREQUENCIES_HZ] for wind in winds_m_s])
    power, speed = points[..., 0], points[..., 1]
    slopes = np.diff(power, axis=1) / np.diff(FREQUENCIES_HZ)
    # On the way down from a steady state to none all power is lost.
    slopes = np.where(np.isnan(slopes), np.where(np.isnan(power[:, 1:]), -np.inf, np.inf), slopes)
    wind, place = np.unravel_index(slopes.argmax(), slopes.shape)
    limits, protection = plant.limits, plant.protection
    assert limits is not None
    # Comparisons with NaN are false: a turbine that does not settle keeps no limit.
    within = (
        (power <= limits.power_max_pu)
        & (power <= limits.torque_max_pu * speed)
        & (protection.rotor_speed_min_pu <= speed)
        & (speed <= protection.over_speed_pu)
    )
    best = tracking_point(0.0, plant.turbine).coefficient
    return Statics(
        steepest=float(slopes.max()),
        steepest_at=(float(winds_m_s[wind]), float(FREQUENCIES_HZ[place : place + 2].mean())),
        capped=max(law.k_min, law.k_nominal, law.k_max) <= best,
        power=float(np.nanmax(power)),
        torque=float(np.nanmax(power / speed)),
        slowest=float(np.nanmin(speed)),
        within=bool(within.all()),
    )


@dataclasses.dataclass(frozen=True)
class Aftermath:
    """Ten minutes after an event, over all scenarios."""

    lowest_hz: float  # frequency of the centre of inertia
    final_hz: tuple[float, float]  # least and largest at the end, of the grids that are left
    rotors: int  # groups that a protection disconnected
    grids: int  # grids that were lost


def worst_events() -> dict[str, tuple[Event, ...]]:
    """Return the largest load steps up and down among training scenarios, the trip of a group, and outages.

    The step up comes once the governor is lost too. The group is the largest that scenarios lose.

    Without the last machine the network has what the wind gives, which may be less than the load: no law is asked to
    hold then.
    """
    suite = get_suite(SUITE)
    steps = [e for scenario in suite.scenarios(suite.train[:N_SOUGHT]) for e in scenario.events if type(e) is LoadStep]
    chosen = (max(steps, key=lambda step: step.power_mw), min(steps, key=lambda step: step.power_mw))
    largest, least = (dataclasses.replace(step, time_s=EVENT_S) for step in chosen)
    return {
        largest.words: (largest,),
        least.words: (least,),
        "a group trips": (GroupTrip(time_s=EVENT_S, group=1),),
        f"governor lost, {largest.words}": (GovernorLoss(time_s=0.0, bus=1), largest),
        LAST_MACHINE: (MachineOutage(time_s=EVENT_S, bus=1),),
    }


def aftermath(law: TrackingLaw, events: tuple[Event, ...], duration_s: float = DURATION_S) -> Aftermath:
    """Play events in the grids of training scenarios, each in a wind that stays as it begins."""
    suite = get_suite(SUITE)
    lanes = TaskLanes(EnvSettings(suite=SUITE, strategy=law, sensors="exact", duration_s=duration_s), N_SCENARIOS)
    calm = {"duration_s": duration_s, "events": events, "load_noise_mw": np.zeros(0), "sensors": None}
    lanes.start(
        range(N_SCENARIOS),
        [
            dataclasses.replace(drawn, wind_speed=drawn.wind_speed[:, :1], **calm)
            for drawn in suite.scenarios(suite.train[:N_SCENARIOS])
        ],
    )
    nominal_hz, lowest = lanes.nominal_hz, 1.0
    actions = np.zeros((N_SCENARIOS, lanes.n_action))
    for _ in range(round(duration_s / lanes.settings.control_dt)):
        lanes.step(actions)
        lowest = min(lowest, float(lanes.simulator.lane_values("coi").min()))
    stands = lanes.statuses() == Status.RUNNING
    final_hz = nominal_hz * lanes.simulator.lane_values("coi")[stands]
    tripped = lanes.simulator.wtg_values("connected")[stands] < 0.5
    by_event = sum(isinstance(event, GroupTrip) for event in events) * stands.sum()
    lanes.simulator.close()
    return Aftermath(
        lowest_hz=nominal_hz * lowest,
        final_hz=(float(final_hz.min()), float(final_hz.max())),
        rotors=int(tripped.sum() - by_event),
        grids=int((~stands).sum()),
    )
