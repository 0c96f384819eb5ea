"""Progress of long work, on stderr."""

import sys
import time
from typing import Any

from wtg_gym.files import printable

#: Lines of progress come this far apart, the first one after as long [s].
_PROGRESS_INTERVAL_S = 5.0


class Progress:
    """Progress on stderr, in `unit`s: a bar with the remaining time in a terminal, a line now and then elsewhere."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._bar: Any = None
        self._task: Any = None
        self._last_line = time.monotonic()

    def __enter__(self) -> "Progress":
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            count = TextColumn("{task.fields[count]}")
            columns = (TextColumn("{task.description}"), BarColumn(), count, TimeRemainingColumn())
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=None, count="")
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, name: str, done: float, total: int) -> None:
        """Say that `done` of `total` are done, and the name of what is under way."""
        count = f"{round(done, 1):g} of {total} {self._unit}"
        if self._bar is not None:
            from rich.markup import escape

            self._bar.update(self._task, description=escape(printable(name)), completed=done, total=total, count=count)
            return
        now = time.monotonic()
        if now - self._last_line >= _PROGRESS_INTERVAL_S:
            self._last_line = now
            print(printable(f"{name}: {count}"), file=sys.stderr)
