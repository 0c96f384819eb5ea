"""What all tests share."""

import gc
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from wtg_gym import Plant
from wtg_gym.physics.simulator import Simulator
from wtg_gym.scenarios import FROZEN_HASHES, SUITES

# A deadline for an example would fail on a busy machine.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# A shell makes what it puts into the background deaf to an interrupt; so would be the commands that tests interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Nor is there a search while the tests are imported; see :func:`pytest_collection_finish`.
gc.disable()

#: Tests that need no machine code of the usual plant: of none, of other numbers of machines, or in processes that
#: compile for themselves.
_WITHOUT_THE_USUAL_PLANT = ("golden/", "physics/test_machine_code", "scenarios/")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the second of two processes, which begins in the middle, not compile what the first one is compiling."""

    def waits(item: pytest.Item) -> bool:
        return not item.path.relative_to(Path(__file__).parent).as_posix().startswith(_WITHOUT_THE_USUAL_PLANT)

    others = [item for item in items if waits(item)]
    middle = len(items) // 2
    items[:] = [*others[:middle], *(item for item in items if not waits(item)), *others[middle:]]


def pytest_collection_finish() -> None:
    """Let no search for garbage look at what the imports have left: half a million objects that stay."""
    gc.enable()
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _hashes():
    """The hashes of the suites, each of which takes seconds of drawing: tests/scenarios/test_suites.py draws them."""
    for name, known in FROZEN_HASHES.items():
        vars(SUITES[name])["hash"] = known


@pytest.fixture(scope="session")
def simulator():
    return Simulator(Plant(), duration_s=120.0)


@pytest.fixture
def few_scenarios(monkeypatch):
    """The gate plays few scenarios, since each needs a session; tests/submissions tests what it finds in all."""
    monkeypatch.setattr("wtg_gym.policies.gate._ROLLOUT_ENVS", 8)
    monkeypatch.setattr("wtg_gym.policies.gate._TIMED_ENVS", 16)


@pytest.fixture
def one_thread():
    """Torch on one thread; the number of before is taken back."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
