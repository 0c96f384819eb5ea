"""Tasks: what an environment acts on, charges and observes; each version of the benchmark is one object.

`task` says what a task is; `versions` has the two. Their equations: `episode`, actions and history; `cost`;
`measured_observation`, the sensors of v1; `observation`, with `info`.
"""

from collections.abc import Mapping
from types import MappingProxyType

from wtg_gym.tasks.task import Task
from wtg_gym.tasks.versions import V0, V1

#: Id of version v1 on other grids.
ANY_GRID = "GFMWTG-v1"
#: The tasks by the id of their environment.
TASKS: Mapping[str, Task] = MappingProxyType({task.env_id: task for task in (V0, V1)})
#: Names of entries that scores depend on in some version; no other entry can have one.
ANCHOR_NAMES = tuple(dict.fromkeys(name for task in TASKS.values() for name in task.references))

__all__ = ["ANCHOR_NAMES", "ANY_GRID", "TASKS", "V0", "V1", "Task"]
