"""Any policy of PyTorch as an entry: `policy.onnx` with its weights inside, and `entry.toml`; needs torch."""

import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.files import write_together
from wtg_gym.physics.tracking_law import LAW_NAMES, get_law
from wtg_gym.policies.entry import without_environment
from wtg_gym.policies.entry_folder import ENTRY_FILE, FILES, KEYS, POLICY_FILE, entry_text, parse_entry
from wtg_gym.policies.gate import widths
from wtg_gym.policies.policy_process import OnnxPolicy, PolicyError
from wtg_gym.ranges import did_you_mean

try:
    import torch
    from torch import Tensor, nn
except ImportError as error:
    raise ImportError(f"export_onnx() needs torch: pip install torch ({error})") from error

#: Old enough for every onnxruntime that is still around.
_OPSET = 17
_CHECKED_ENVS, _CHECKED_STEPS = 16, 20


def export_onnx(
    module: nn.Module,
    folder: str | Path,
    *,
    name: str,
    tolerance: float = 1e-5,
    overwrite: bool = False,
    **entry: Any,
) -> Path:
    """Write a policy as `policy.onnx` and `entry.toml` into a folder, which is then an entry.

    The file's actions are compared with the module's on 320 random observations, episode starts among them. A
    ValueError says that an argument is out of range, the folder has another entry.toml, the module answers in another
    form, torch cannot export it, or the file gives other actions or is too large; a TypeError names an unknown key.

    Args:
        module: maps observations (batch, n_observation) to actions (batch, n_action), float32; with memory, also one
            state (batch, n) after the other, and returns (actions, next states …), and has their widths n as
            `state_widths`. States are zero at the start of an episode. Actions are clipped to [-1, 1]. It is exported
            in evaluation mode.
        folder: where to write; made if missing.
        name: of the entry.
        tolerance: largest difference between the actions of the file and the module, [-1, 1].
        overwrite: whether another entry.toml in the folder is replaced; a policy with the same one always is.
        entry: further keys of entry.toml: environment (default "GFMWTG-14bus-v1"), action_mode ("k+tau"),
            observation_mode, strategy, training_seed (0), authors ([]; a submission needs them), description,
            trained_on. A :class:`~wtg_gym.sb3.DeterministicPolicy` knows its learner's environment, strategy and modes.

    Returns:
        the folder.
    """
    if not isinstance(module, nn.Module):
        raise ValueError(f"export_onnx() takes a torch.nn.Module, got {type(module).__name__}")
    for key in (key for key in entry if key not in KEYS):
        raise TypeError(f"export_onnx() got an unexpected keyword argument {key!r}{did_you_mean(key, KEYS)}")
    learned: dict[str, Any] | None = getattr(module, "learned_in", None)
    if learned == {} and "strategy" not in entry:
        raise without_environment(name)
    of_training = {key: getattr(value, "name", value) for key, value in (learned or {}).items()}
    law = of_training.get("strategy")
    if learned and (law not in LAW_NAMES or get_law(law) != learned["strategy"]):
        raise ValueError(f"a folder's strategy is a built-in one, the learner's was {law!r}: play it by Entry()")
    defaults = {"environment": "GFMWTG-14bus-v1", "action_mode": "k+tau", "training_seed": 0, "authors": []}
    text = entry_text({"name": name, **defaults, **of_training, **entry})
    described = parse_entry(text)
    described.check_learned(learned or {})
    path = Path(folder) / ENTRY_FILE
    if not overwrite and path.exists() and path.read_bytes() != text.encode():
        raise ValueError(f"{folder} has another {ENTRY_FILE} already; choose another folder, or give overwrite=True")
    content = onnx_bytes(module, *widths(described), tolerance=tolerance)
    # entry.toml last, because it makes the folder an entry.
    write_together({Path(folder) / POLICY_FILE: content, path: text})
    return Path(folder)


def onnx_bytes(module: nn.Module, n_observation: int, n_action: int, *, tolerance: float = 1e-5) -> bytes:
    """Return the file that :func:`export_onnx` writes, for a module of any width; raises as that does."""
    modes = [(layer, layer.training) for layer in module.modules()]
    playable = _Playable(module).eval()
    try:
        _check_form(playable, n_observation, n_action)
        content = _exported(playable, n_observation)
        difference = largest_difference(playable, content, n_observation)
    finally:
        for layer, training in modes:
            layer.training = training
    if len(content) > FILES[POLICY_FILE]:
        raise ValueError(f"the file has {len(content)} bytes, allowed are {FILES[POLICY_FILE]}: use a smaller network")
    if not difference <= tolerance:
        raise ValueError(
            f"the actions of the ONNX file differ by {difference:.2g} from those of the {playable.label}, allowed are "
            f"{tolerance:g}: a module that draws random numbers, has memory of its own or branches on its input cannot "
            "be exported; return the mean, pass the memory as states, use torch.where"
        )
    return content


class TorchPolicy:
    """A module in the form of :func:`export_onnx` as a policy, to be played without a file."""

    def __init__(self, module: nn.Module) -> None:
        self._playable = _Playable(module)

    @torch.no_grad()
    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """Return (actions (num_envs, n_action), states), in the manner of Stable-Baselines3."""
        widths = self._playable.state_widths
        states = [torch.zeros(len(observation), width) for width in widths] if state is None else state
        if episode_start is not None:
            goes_on = torch.as_tensor(~np.asarray(episode_start, dtype=np.bool_), dtype=torch.float32)[:, None]
            states = [memory * goes_on for memory in states]
        action, *following = self._playable(torch.as_tensor(observation, dtype=torch.float32), *states)
        return action.numpy(), following


class _Playable(nn.Module):
    """A module whose answer is a tuple with clipped actions; inputs go to its device, answers come from it."""

    def __init__(self, module: nn.Module) -> None:
        super().__init__()
        self.label = f"module {type(module).__name__}"
        self.module = module
        self.state_widths: tuple[int, ...] = tuple(getattr(module, "state_widths", ()))
        self._device = next((t.device for t in (*module.parameters(), *module.buffers())), torch.device("cpu"))

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        answer = self.module(*(tensor.to(self._device) for tensor in inputs))
        action, *following = answer if isinstance(answer, (tuple, list)) else (answer,)
        return action.float().clamp(-1.0, 1.0).cpu(), *(tensor.float().cpu() for tensor in following)


@torch.no_grad()
def _check_form(playable: _Playable, n_observation: int, n_action: int) -> None:
    """Raise a ValueError if the module cannot answer observations, or answers in another form."""
    inputs = [torch.zeros(2, width) for width in (n_observation, *playable.state_widths)]
    label = f"the {playable.label} %s inputs of shapes {', '.join(str(tuple(tensor.shape)) for tensor in inputs)}"
    try:
        shapes = [tuple(tensor.shape) for tensor in playable(*inputs)]
    except Exception as error:
        raise ValueError(
            f"{label % 'cannot answer'}: {_first_line(error)}; give the environment and modes of its training"
        ) from error
    expected = [(2, width) for width in (n_action, *playable.state_widths)]
    if shapes != expected:
        raise ValueError(f"{label % 'must answer'} by actions and next states of shapes {expected}, got {shapes}")


def _exported(playable: _Playable, n_observation: int) -> bytes:
    states = [f"state_{index}" for index in range(len(playable.state_widths))]
    inputs, outputs = ["observation", *states], ["action", *(f"next_{name}" for name in states)]
    # Without another size of the batch onnxruntime simplifies more, where a policy is played row by row.
    example = tuple(torch.zeros(1, width) for width in (n_observation, *playable.state_widths))
    try:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), torch.no_grad():
            file = Path(folder) / POLICY_FILE
            # Traced branches are found by comparing the actions; that this exporter is the older one is known.
            warnings.simplefilter("ignore")
            # The exporter of traced graphs needs no onnxscript, and puts the weights into the file itself.
            options: dict[str, Any] = {"dynamo": False, "opset_version": _OPSET}
            torch.onnx.export(playable, example, file, input_names=inputs, output_names=outputs, **options)
            return file.read_bytes()
    except Exception as error:
        raise ValueError(f"torch cannot export the {playable.label}: {_first_line(error)}") from error


def largest_difference(playable: nn.Module, content: bytes, n_observation: int) -> float:
    """Return how far the actions of a module and of a file are apart on random observations."""
    rng, module = np.random.default_rng(0), TorchPolicy(playable)
    largest, state, file_state = 0.0, None, None
    with OnnxPolicy(content) as policy:
        for step in range(_CHECKED_STEPS):
            observations = rng.normal(0.0, 1.0, (_CHECKED_ENVS, n_observation)).astype(np.float32)
            start = np.full(_CHECKED_ENVS, step == 0) | (rng.random(_CHECKED_ENVS) < 0.1)
            actions, state = module.predict(observations, state, start)
            try:
                other, file_state = policy.predict(observations, file_state, start)
            except PolicyError as error:
                raise ValueError(f"the ONNX file of the module cannot be played: {error}") from error
            difference = np.abs(actions - other).max()
            largest = max(largest, float(np.inf if np.isnan(difference) else difference))
    return largest


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
