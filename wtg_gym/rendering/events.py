"""Events in words."""

from __future__ import annotations

from wtg_gym.physics.scenario import Event, LineTrip, LoadRamp, LoadTrip


def describe_event(event: Event) -> str:
    """Return an event in words, with its units, without its instant."""
    if isinstance(event, LineTrip):
        return f"line {event.from_bus}–{event.to_bus} opens"
    if isinstance(event, LoadTrip):
        return f"load of bus {event.bus} lost"
    text = f"{event.power_mw:+g} MW"
    if event.reactive_mvar:
        text += f", {event.reactive_mvar:+g} Mvar"
    text = text.replace("-", "−")
    text += f" at bus {event.bus}"
    if isinstance(event, LoadRamp):
        text += f" over {event.duration_s:g} s"
    return text


__all__ = ["describe_event"]
