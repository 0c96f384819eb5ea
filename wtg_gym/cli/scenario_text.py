"""Scenarios in words and as a summary."""

from __future__ import annotations

from typing import Any

from wtg_gym.physics.scenario import Scenario


def scenario_summary(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario as JSON-ready data, with its series reduced to the mean wind per group [m/s]."""
    data = scenario.to_dict()
    for series in ("wind_speed", "wind_dt_s", "load_noise_mw"):
        del data[series]
    data["mean_wind_m_s"] = [round(float(mean), 6) for mean in scenario.wind_speed.mean(axis=1)]
    return data


def describe_scenario(scenario: Scenario) -> list[str]:
    """Return a scenario in words: wind, grid strength and events, with units."""
    winds = [
        f"{wind.mean():.4g}" + (f" ({wind.min():.3g} … {wind.max():.3g})" if wind.size > 1 else "")
        for wind in scenario.wind_speed[:4]
    ]
    more = f" and {scenario.n_wtg - 4} more" if scenario.n_wtg > 4 else ""
    droop = "of the case" if scenario.governor_droop is None else f"{scenario.governor_droop:.3g} p.u."
    noise = "none"
    if scenario.load_noise_mw.any():
        noise = f"{scenario.load_noise_mw.std():.2g} MW rms at bus {scenario.load_noise_bus}"
    lines = [
        f"scenario {scenario.name}: {scenario.duration_s:g} s",
        f"  mean wind    {', '.join(winds)}{more} m/s",
        f"  grid         governor droop {droop}, {100.0 * scenario.committed:.3g} % of the machines' units on line, "
        f"inertia of each {100.0 * scenario.inertia_scale:.3g} %, load {100.0 * scenario.load_level:.3g} %",
        f"  load noise   {noise}",
    ]
    if scenario.reserve_margin is not None:
        lines.append(f"  reserve      {100.0 * scenario.reserve_margin:.1f} % of the load, at its least")
    events = sorted(scenario.events, key=lambda event: event.time_s)
    for head, event in zip(["events", *[""] * len(events)], events, strict=False):
        late = " (after the end of the run)" if event.time_s >= scenario.duration_s else ""
        lines.append(f"  {head:<12} {event.time_s:g} s: {event.words}{late}")
    return lines if events else [*lines, "  events       none"]
