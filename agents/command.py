"""What the commands of this folder share: how bad input and an interruption end."""

from __future__ import annotations

from collections.abc import Callable

from wtg_gym.cli.output import note, one_line


def run_command(work: Callable[[], None], after_interrupt: str | None = None) -> int:
    """Do the work of a command and return its exit code: 0 fine, 2 bad input, 130 interrupted.

    Args:
        work: raises ValueError or OSError for bad input; the message is shown.
        after_interrupt: what to say of an interruption; None: it is passed on.
    """
    try:
        work()
    except (ValueError, OSError) as error:
        note(f"error: {one_line(error)}")
        return 2
    except KeyboardInterrupt:
        if after_interrupt is None:
            raise
        note(f"interrupted; {after_interrupt}")
        return 130
    return 0


__all__ = ["run_command"]
