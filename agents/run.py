"""A training run: its settings and options, its folder, its validations, and the command that begins it or goes on.

A run's folder holds run.json (settings, provenance, curve), checkpoints/, from which it goes on after an interruption
of any kind, and best/, the policy with the best validation score as an entry that `wtg-gym evaluate` plays.
"""

import contextlib
import dataclasses
import functools
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import torch
from cyclopts import App, CycloptsError, Parameter, Token
from filelock import FileLock, Timeout
from torch import nn

from wtg_gym.envs import EnvSettings
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.evaluation import Entry, circumstances, evaluate
from wtg_gym.files import interpreting, one_line, read_json, to_json, trusted_files, write_atomically
from wtg_gym.physics import tracking_law
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies.entry_folder import ENTRY_FILE, POLICY_FILE, check_not_built_in, entry_text
from wtg_gym.policies.torch_export import TorchPolicy, onnx_bytes
from wtg_gym.progress import Progress
from wtg_gym.ranges import Checked, design, require_whole, required
from wtg_gym.scenarios import DEFAULT_SUITE, get_suite
from wtg_gym.systems.compiled import source_hash

H = TypeVar("H")
RUN_FILE = "run.json"
#: In the folder of a run: its last checkpoint and its best policy.
CHECKPOINTS, BEST = "checkpoints", "best"
#: Settings of a run that are arguments of the environment.
_OF_ENVIRONMENT = ("action_mode", "observation_mode", "suite", "strategy")
_PACKAGES = ("gymnasium", "numba", "numpy", "stable-baselines3", "sb3-contrib", "torch")
#: Largest difference between a file's actions and the network's, on random observations, some of them far from any that
#: an episode has: there a single precision leaves this much.
_TOLERANCE = 1e-4


class Learner:
    """What is trained; it saves and loads its `parts` by their state dictionaries."""

    network: nn.Module  # the deterministic policy, in the form of `wtg_gym.export_onnx`
    parts: Mapping[str, Any]

    def save(self, folder: Path) -> None:
        """Write everything that training goes on from into an empty folder."""
        torch.save({name: part.state_dict() for name, part in self.parts.items()}, folder / "state.pt")

    def load(self, folder: Path) -> None:
        """Go back to what :meth:`save` wrote; a ValueError names a folder that is damaged."""
        with loading(folder) as folder:
            state = torch.load(folder / "state.pt", weights_only=True)
            for name, part in self.parts.items():
                part.load_state_dict(state[name])


def _whole(_: Any, tokens: Sequence[Token]) -> int:
    # Without this, 2.5 would be rounded.
    return int(tokens[0].value)


Whole = Annotated[int, Parameter(converter=_whole)]
#: Widths of layers, or none.
Widths = Annotated[tuple[Whole, ...], Parameter(consume_multiple=True, negative="")]


def options(record: type[H]) -> type[H]:
    """Let a dataclass of checked values be options of a command, whose help is the meaning of its fields."""
    own = record.__annotations__
    for each in dataclasses.fields(record):  # type: ignore[arg-type]
        if each.name in own:
            own[each.name] = Annotated[each.type, Parameter(help=each.metadata["doc"])]
    decorated: type[H] = Parameter(name="*")(record)
    return decorated


@options
@dataclass(frozen=True, kw_only=True)
class SharedSettings(Checked):
    """What is both an option of every training and a setting of its run; the first four as for the environment."""

    action_mode: Literal["k", "tau", "k+tau"] = design("k+tau", "-", "what the policy modulates")
    observation_mode: Literal["local", "privileged"] = design("local", "-", "what it sees")
    suite: str = design(DEFAULT_SUITE, "-", "suite to train and validate on")
    strategy: str = design(tracking_law.REFERENCE_LAW, "-", "law that the actions modulate")
    seed: Whole = design(0, "-", "seed of everything random", 0, 2**31 - 1)
    interval: Whole = design(0, "-", "steps between two validations; 0: a 20th of all", 0, 10**12)
    validation_episodes: Whole = design(50, "-", "scenarios of a validation, the first of the split", 1, 10_000)


@dataclass(frozen=True, kw_only=True)
class RunSettings(SharedSettings):
    """Settings of a run; all of them survive JSON; a ValueError if a value is unknown or out of range."""

    algo: str  # name of the algorithm
    hyperparameters: Mapping[str, Any]  # section of a configuration file, as written there
    timesteps: int = required("-", "design", "steps of all environments together", 1, 10**12)
    n_envs: int = required("-", "design", "number of environments", 1, 100_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        EnvSettings(**self.env_arguments)
        suite = get_suite(self.suite)
        if not suite.distributions:
            raise ValueError(f"suite {self.suite!r} is a fixed list of cases, nothing to train on")
        fewest, most = max(1, len(suite.strata)), len(suite.seeds("validation"))
        require_whole("validation_episodes", self.validation_episodes, fewest, most)

    @property
    def env_arguments(self) -> dict[str, Any]:
        """Arguments of the environment."""
        return {name: getattr(self, name) for name in _OF_ENVIRONMENT}

    @property
    def validation_interval(self) -> int:
        """Steps between two validations."""
        return self.interval or max(1, self.timesteps // 20)

    def entry(self, name: str = "", description: str = "") -> dict[str, Any]:
        """Return the keys and values of entry.toml for the run's policy; a ValueError if its name would be refused."""
        values: dict[str, Any] = {
            "name": name or f"{self.algo} {self.action_mode}",
            "description": description or f"Trained with {self.algo}.",
            "action_mode": self.action_mode,
            "observation_mode": self.observation_mode,
            "training_seed": self.seed,
            "environment": get_suite(self.suite).env_id,
        }
        values |= {} if self.strategy == tracking_law.REFERENCE_LAW else {"strategy": self.strategy}
        check_not_built_in("the entry's name", values["name"])
        Entry(**values)
        return values


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep other processes from training in a folder; a ValueError if one does."""
    try:
        lock = FileLock(folder / ".lock").acquire(timeout=0)
    except Timeout as error:
        raise ValueError(f"another process trains in {folder}; wait for it to end, or end it") from error
    with lock:
        yield


def save_folder(parent: Path, timesteps: int, write: Callable[[Path], object]) -> None:
    """Write a folder that is named after a number of timesteps, then remove the older ones beside it."""
    # It gets its name when it is complete, so that a complete one remains after a kill at any moment; only the user can
    # enter it. One of the same name is of the same step, and is kept.
    target = parent / f"{timesteps:012d}"
    if not target.exists():
        parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix="incomplete-", dir=parent))
        write(temporary)
        for file in temporary.iterdir():
            file.chmod(0o600)
        temporary.rename(target)
    for other in (*folders(parent), *parent.glob("incomplete-*")):
        if other != target:
            shutil.rmtree(other)


def folders(parent: Path) -> list[Path]:
    """Return the complete folders in `parent`, the fewest timesteps first."""
    return sorted(path for path in parent.glob("*") if path.name.isdecimal())


@contextlib.contextmanager
def loading(path: Path) -> Iterator[Path]:
    """Return a folder to load from, and turn any error meanwhile into a ValueError that names it."""
    # Damaged pickles and archives raise errors of any kind. They also run code: what another user could have written is
    # refused.
    try:
        yield trusted_files(path)
    except Exception as error:
        raise ValueError(f"{path} is missing, damaged or of another kind: {type(error).__name__}: {error}") from error


@dataclass(kw_only=True)
class Run(Checked):
    """A run as run.json in its folder describes it."""

    MOST = MappingProxyType({"curve": 100_000})

    folder: Path
    settings: RunSettings
    provenance: Mapping[str, Any]  # command, versions, commit and start time of the process that began it
    curve: list[dict[str, Any]] = field(default_factory=list)  # one row per validation
    #: Provenance of the processes that went on, the latest last.
    resumptions: list[Mapping[str, Any]] = field(default_factory=list)
    finished: bool = False  # whether all timesteps are done
    _began: float = field(default=0.0, init=False, repr=False)

    @classmethod
    def new(cls, folder: Path, settings: RunSettings) -> "Run":
        """Return a run that starts now, with this process's provenance."""
        return cls(folder=folder, settings=settings, provenance=_provenance(settings))

    @classmethod
    def read(cls, folder: Path) -> "Run":
        """Read run.json; a ValueError if there is none, or it is damaged."""
        path = folder / RUN_FILE
        data = read_json(path, "description of the run")
        with interpreting(path, "description of the run"):
            return cls(**{**data, "folder": folder, "settings": RunSettings(**data["settings"])})

    def write(self, folder: Path | None = None) -> None:
        """Write run.json into the run's folder, or another, in one go."""
        data = dataclasses.asdict(self)
        del data["folder"], data["_began"]
        write_atomically((folder or self.folder) / RUN_FILE, to_json(data))

    @property
    def best(self) -> dict[str, float]:
        """The row that ranks first: in v1 with the mark, then by its score; the first one of several."""
        return max(self.curve, key=lambda row: (row["marked"], row["score"]))

    @property
    def title(self) -> str:
        """How far the run is, for the line of its progress."""
        return f"{self.settings.algo}, score {self.curve[-1]['score']:.1f}, best {self.best['score']:.1f}"

    @property
    def checkpoint(self) -> Path | None:
        """The folder to go on from; None for a new run. A ValueError if it is gone or of another run."""
        saved = folders(self.folder / CHECKPOINTS)
        if not saved:
            if self.curve:
                raise ValueError(f"{self.folder} has validations, but no checkpoint to go on from; begin anew")
            return None
        run = Run.read(saved[-1])
        step = run.curve[-1]["timesteps"] if run.curve else None
        is_same = run.settings == self.settings and run.provenance["started"] == self.provenance["started"]
        if not is_same or step != int(saved[-1].name):
            raise ValueError(f"{saved[-1]} is a checkpoint of another run or of step {step}; begin anew elsewhere")
        return saved[-1]

    def begin(self, learner: Learner) -> None:
        """Write run.json before the first step, so that the run can go on whenever it is interrupted."""
        if not self.curve:
            # That it cannot be exported is better known now than in the end.
            _exported(learner, self.settings)
        self.write()
        s, done = self.settings, f"from step {self.curve[-1]['timesteps']}, " if self.curve else ""
        intervals = f"validates every {s.validation_interval} steps on {s.validation_episodes} scenarios"
        note(f"{self.folder}: {s.algo} on {s.strategy}, {done}{s.timesteps} steps in all; {intervals}")
        self._began = time.monotonic() - (self.curve[-1]["wall_time_s"] if self.curve else 0.0)

    def take_stock(self, learner: Learner, timesteps: int, *, finished: bool = False) -> dict[str, float] | None:
        """Validate, keep the best policy and write a checkpoint, where it is time for it; return the metrics."""
        self.finished = finished
        interval = self.settings.validation_interval
        last = int(self.curve[-1]["timesteps"]) if self.curve else -interval
        if timesteps // interval <= last // interval and not (finished and last < timesteps):
            if finished:
                self.write()
            return None

        def write_checkpoint(folder: Path) -> None:
            learner.save(folder)
            self.write(folder)

        def write_best(folder: Path) -> None:
            (folder / POLICY_FILE).write_bytes(_exported(learner, self.settings))
            per_group = {"per_group": True} if _per_group(learner.network) else {}
            write_atomically(folder / ENTRY_FILE, entry_text({**self.settings.entry(), **per_group}))

        metrics = self.validate(learner, timesteps)
        note(f"step {timesteps}: {self.title}")
        # First, because one whose row is missing in run.json is validated again on resumption.
        save_folder(self.folder / CHECKPOINTS, timesteps, write_checkpoint)
        if self.best is self.curve[-1]:
            save_folder(self.folder / BEST, timesteps, write_best)
        self.write()
        return metrics

    def validate(self, learner: Learner, timesteps: int) -> dict[str, float]:
        """Play the validation scenarios, add a row with score and metrics to the curve, and return the metrics."""
        s, network = self.settings, learner.network
        modes: dict[str, Any] = {"action_mode": s.action_mode, "observation_mode": s.observation_mode}
        policy, per_group = TorchPolicy(network), _per_group(network)
        entry = Entry(name="policy", policy=policy, strategy=s.strategy, per_group=per_group, **modes)
        seeds = get_suite(s.suite).seeds("validation")[: s.validation_episodes]
        results = evaluate([entry], s.suite, "validation", seeds=seeds)
        (summary,) = (summary for summary in results.summaries if summary.name == entry.name)
        metrics = {
            "score": results.scores[entry.name].value,
            **{f"score_{name}": score.value for name, score in summary.strata.items()},
            "marked": float(summary.marked),
            "lost_or_beyond_percent": summary.lost_or_beyond_percent,
            "cost": summary.mean_pinned_cost,
            "failures_percent": summary.failures_percent,
            "nadir_hz": summary.median_nadir_hz,
            "median_deviation_mhz": summary.median_deviation_mhz,
            "duty_error_percent": summary.mean_duty_error_percent,
            "energy_share_percent": summary.mean_energy_share_percent,
        }
        wall_time_s = round(time.monotonic() - self._began, 2)
        self.curve.append({"timesteps": timesteps, "wall_time_s": wall_time_s, **metrics})
        return metrics


def _exported(learner: Learner, settings: RunSettings) -> bytes:
    """Return the file of a policy as ONNX."""
    batch, network = EnvBatch(EnvSettings(**settings.env_arguments), 1, 1), learner.network
    n_parts = batch.n_wtg if _per_group(network) else 1
    return onnx_bytes(network, batch.n_observation // n_parts, batch.n_action // n_parts, tolerance=_TOLERANCE)


def _per_group(network: nn.Module) -> bool:
    """Return whether a network answers for one group at a time, which its attribute `per_group` says."""
    return bool(getattr(network, "per_group", False))


def _provenance(settings: RunSettings) -> dict[str, Any]:
    # The checkout's commit, marked where files differ from it; None outside of a checkout.
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    commit: str | None = None
    with contextlib.suppress(OSError, subprocess.CalledProcessError):
        commit = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    return {
        "command": shlex.join([Path(sys.executable).name, *sys.orig_argv[1:]]),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "machine": f"{platform.system()} {platform.machine()}",
        "git_commit": commit,
        "source_hash": source_hash(),
        "suite_hash": get_suite(settings.suite).hash,
        "versions": circumstances.installed(_PACKAGES),
    }


def draw(batch: EnvBatch, rng: np.random.Generator, n_scenarios: int) -> list[Scenario]:
    """Return training scenarios; of strata their seeds follow one another: three hold one of each."""
    if not batch.suite.strata:
        return batch.draw([rng] * n_scenarios)
    seeds = batch.suite.train
    first = int(rng.integers(seeds.start, seeds.stop - n_scenarios))
    return batch.scenarios(range(first, first + n_scenarios))


@options
@dataclass(frozen=True, kw_only=True)
class RunOptions(SharedSettings):
    """The options that every training shares."""

    output: Path | None = design(None, "-", "folder of the new run")
    resume: Path | None = design(None, "-", "go on with the run in this folder, with its own settings")
    timesteps: Whole | None = design(None, "-", "steps of all environments together; default: the learner's", 1, 10**12)
    n_envs: Whole | None = design(
        None, "-", "environments side by side, or scenarios of a round; default: the learner's", 1, 100_000
    )

    def settings(self, algo: str, hyperparameters: Mapping[str, Any], *, timesteps: int, n_envs: int) -> RunSettings:
        """Return the settings of a new run; `timesteps` and `n_envs` are used where no option gives them."""
        options = {key: value for key, value in vars(self).items() if key in RunSettings.__dataclass_fields__}
        named = {key: value for key, value in options.items() if value is not None}
        defaults = {"timesteps": timesteps, "n_envs": n_envs}
        return RunSettings(**{**defaults, **named, "algo": algo, "hyperparameters": hyperparameters})


def note(text: str) -> None:
    """Print a line on stderr, which holds no results."""
    print(text, file=sys.stderr)


def run_command(command: Callable[..., None], name: str, advice: str, argv: Sequence[str] | None = None) -> int:
    """Run `python -m NAME` with words, None for the command line's; return 0 fine, 2 bad input or 130 interrupted."""
    words = sys.argv[1:] if argv is None else list(argv)
    app = App(name=f"python -m {name}", help_format="plaintext", version_flags=(), suppress_keyboard_interrupt=False)
    app.default(command)
    try:
        options = {word.partition("=")[0] for word in words if word.startswith("--")}
        if "--resume" in options and (others := sorted(options - {"--resume"})):
            raise ValueError(f"--resume goes on with the run's own settings; leave out {', '.join(others)}")
        app(words, exit_on_error=False, print_error=False, result_action="return_value")
    except (CycloptsError, ValueError, OSError) as error:
        note(f"error: {one_line(error)}")
        return 2
    except KeyboardInterrupt:
        note(f"interrupted; {advice}")
        return 130
    return 0


def begin_or_go_on(
    options: RunOptions, algos: Container[str], settings: Callable[[], RunSettings], train: Callable[[Run], None]
) -> None:
    """Train one of some `algos` in the folder that the options name; `settings` returns those of a new run."""
    if options.resume is not None:
        folder, algo = options.resume, Run.read(options.resume).settings.algo
        if algo not in algos:
            raise ValueError(f"{folder} is a run of {algo}: go on with it by the command that began it")
    elif options.output is not None:
        folder, run = options.output, Run.new(options.output, settings())
        if (folder / RUN_FILE).exists():
            raise ValueError(f"{folder} holds a run already; give a new folder, or --resume {folder}")
        folder.mkdir(parents=True, exist_ok=True)
    else:
        raise ValueError("--output FOLDER is needed, or --resume FOLDER")
    with held(folder):
        if options.resume is not None:
            # Read again, now that no other process can change it.
            run = Run.read(folder)
            if not run.finished:
                run.resumptions.append(_provenance(run.settings))
        train(run)
    step = run.best["timesteps"] or "0, before the training: train longer"
    note(f"best validation score {run.best['score']:.1f} at step {step}; wrote {folder}")


def require_local(settings: RunSettings) -> None:
    """Raise a ValueError if a policy for every group alike would see the whole grid."""
    if settings.observation_mode != "local":
        raise ValueError("a policy for every group alike sees local observations: leave out --observation-mode")


class RoundLearner(Learner):
    """A learner that learns in rounds of equally many steps."""

    batch: EnvBatch  # whose training scenarios it learns from
    timesteps: int  # of a round

    def learn(self, scenarios: Sequence[Scenario], rng: np.random.Generator, index: int, n_rounds: int) -> float:
        """Learn from the scenarios of a round, the index-th of all, with its generator; return the loss."""
        raise NotImplementedError


def main_in_rounds(
    name: str, what: str, record: type[H], make: Callable[[RunSettings, H], RoundLearner], **defaults: int
) -> Callable[..., int]:
    """Return the `main` of the command `agents.NAME`, which trains what `make` returns in rounds.

    `what` is its help, `record` its hyperparameters; `defaults` are `timesteps` and `n_envs`, scenarios of a round.
    """

    def train(run: Run) -> None:
        settings = run.settings
        if run.finished:
            return
        # Sums over several threads depend on which of them ends first.
        torch.set_num_threads(1)
        torch.manual_seed(settings.seed)
        with interpreting(run.folder / RUN_FILE, "description of the run"):
            hyperparameters = record(**settings.hyperparameters)
        learner, first = make(settings, hyperparameters), 0
        n_rounds = -(-settings.timesteps // learner.timesteps)
        if saved := run.checkpoint:
            first = int(saved.name) // learner.timesteps
            learner.load(saved)
        run.begin(learner)
        with Progress("rounds") as progress:
            for index in range(first, n_rounds):
                run.take_stock(learner, index * learner.timesteps)
                # Of its own, so that a resumed run draws what an undisturbed one would have drawn.
                rng = np.random.default_rng((settings.seed, index))
                value = learner.learn(draw(learner.batch, rng, settings.n_envs), rng, index, n_rounds)
                progress.update(f"objective {value:.3f}, {run.title}", index + 1 - first, n_rounds - first)
        run.take_stock(learner, n_rounds * learner.timesteps, finished=True)

    def command(*, options: RunOptions = RunOptions(), h: Any = record()) -> None:  # noqa: B008
        begin_or_go_on(options, (name,), lambda: options.settings(name, dataclasses.asdict(h), **defaults), train)

    command.__doc__, command.__annotations__["h"] = what, record
    return functools.partial(run_command, command, f"agents.{name}", "go on with --resume")
