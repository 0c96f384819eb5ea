"""Facts about training: it is reproducible, survives a kill, and its export plays as the learner does.

RL Zoo and this package mean the same by the configuration files, in which no code is run. Every shipped policy is as
its training left it.
"""

import dataclasses
import functools
import json
import re
import shutil
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
import torch
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from agents import shipped
from agents import train as training
from agents.export import export
from agents.export import main as export_command
from agents.run import Run, RunSettings, folders, held, save_folder
from agents.train import CONFIG_FOLDER, TRAINED, SB3Learner, load_model, main, new_model, read_config
from tests.agents.small import ENV_ID, V0, Normalized, config_file, largest_difference, stopped_after, trained
from wtg_gym.evaluation import OnnxPolicy, load_entries
from wtg_gym.files import sha256
from wtg_gym.policies.entry_folder import policy_folders
from wtg_gym.policies.gate import check_submission
from wtg_gym.tasks.episode import ACTION_MODES
from wtg_gym.tasks.observation import OBSERVATION_MODES

NEW = ("--output", "new")
#: Names of names, nine of each: a billion values of a few hundred characters.
ALIASES = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 11))
BAD = [
    ([], "--output FOLDER is needed"),
    ([*NEW], "--algo is needed"),
    (["--algo", "ppo", "--output", "."], "holds a run already"),
    (["--algo", "ppo", *NEW, "--validation-episodes", "101"], "validation_episodes .* 1 … 100"),
    (["--algo", "ppo", *NEW, "--config", "bad.yml"], "n_envs must be a whole number"),
    (["--algo", "ppo", *NEW, "--config", "rate.yml"], "ppo refuses .* could not convert string to float"),
    (["--algo", "ppo", *NEW, "--config", "key.yml"], "ppo refuses .* unexpected keyword argument 'frame_stack'"),
    (["--algo", "ppo", *NEW, "--config", "no.yml"], "cannot read the hyperparameter file"),
    (["--algo", "ppo", *NEW, "--suite", "paper"], "fixed list of cases"),
    (["--resume", "no-such-run"], "cannot read the description of the run"),
    (["--resume", "no-such-run", "--seed", "1", "--n-envs", "2"], "leave out --n-envs, --seed"),
]
BAD_FILES = [
    (ALIASES, "values on one level"),
    (f"{ENV_ID}: {{1: 2}}", "holds a key that is no text"),
    ("Pendulum-v1: {}", "must have a section"),
    ("a: [", "is not yml"),
    (f"{ENV_ID}: {{policy_kwargs: !!python/object/apply:os.abort []}}", "is not yml"),
]


@pytest.fixture(scope="module")
def run_of(tmp_path_factory):
    """A finished run of an algorithm, trained once, that tests read only."""
    return functools.cache(lambda algo: trained(tmp_path_factory.mktemp(algo), algo))


@pytest.fixture
def copied(run_of, tmp_path):
    return Path(shutil.copytree(run_of("ppo"), tmp_path / "run"))


@pytest.mark.parametrize("algo", TRAINED)
def test_interrupted_run_goes_on_from_its_checkpoint_in_other_scenarios(algo, run_of, tmp_path):
    undisturbed = Run.read(run_of(algo))
    stopped = stopped_after(256, run_of(algo), tmp_path / "stopped")
    (checkpoint,), run = folders(stopped / "checkpoints"), Run.read(stopped)
    first, restored = new_model(run.settings), load_model(checkpoint, run.settings)
    assert restored.num_timesteps == 256
    assert run.validate(SB3Learner(restored), 256)["score"] == run.curve[-2]["score"]
    starts = [torch.as_tensor(model.get_env().reset()) for model in (first, restored)]
    assert not torch.equal(*starts)
    if algo == "sac":
        assert restored.replay_buffer.size() == 256 // 16
    assert main(["--resume", str(stopped)]) == 0
    resumed = Run.read(stopped)
    assert [row["timesteps"] for row in resumed.curve] == [0, 256, 512, 768]
    assert [row["score"] for row in resumed.curve[:2]] == [row["score"] for row in undisturbed.curve[:2]]
    assert resumed.finished and (len(resumed.resumptions), len(undisturbed.resumptions)) == (1, 0)
    assert main(["--resume", str(stopped)]) == 0 and len(Run.read(stopped).resumptions) == 1


@pytest.mark.parametrize("algo", TRAINED)
def test_export_plays_as_the_learner_and_passes_the_gate(algo, run_of, tmp_path):
    folder, run = run_of(algo), Run.read(run_of(algo))
    export(folder, tmp_path / "entry", name="mine", authors=["A. Author"])
    report = check_submission(tmp_path / "entry")
    assert report.accepted, report.refusal
    (entry,) = load_entries(tmp_path / "entry")
    assert (entry.name, entry.training_seed, entry.kind, entry.source) == ("mine", 0, "learned", "A. Author")
    ((best,), (checkpoint,)) = (folders(folder / name) for name in ("best", "checkpoints"))
    assert (best / "policy.onnx").read_bytes() == (tmp_path / "entry" / "policy.onnx").read_bytes()
    model = load_model(checkpoint, run.settings)
    assert largest_difference(Normalized(model), OnnxPolicy(best / "policy.onnx"), run.settings) <= 1e-6
    model.get_env().close()


@pytest.mark.parametrize("missing", ["row", "checkpoint"])
def test_kill_between_two_files_is_mended(missing, copied):
    complete, damaged = Run.read(copied), Run.read(copied)
    del damaged.curve[-1 if missing == "row" else 0 :]
    damaged.write()
    if missing == "checkpoint":
        shutil.rmtree(copied / "checkpoints")
        shutil.rmtree(copied / "best")
    assert main(["--resume", str(copied)]) == 0
    scores = [[(row["timesteps"], row["score"]) for row in run.curve] for run in (complete, Run.read(copied))]
    assert scores[0] == scores[1]


def test_a_best_policy_of_before_the_training_is_said(copied, capsys):
    run = Run.read(copied)
    run.curve[0]["score"] = run.curve[-1]["score"] + 1.0
    run.write()
    assert main(["--resume", str(copied)]) == 0
    assert "at step 0, before the training: train longer" in capsys.readouterr().err


def test_seed_decides_the_first_weights_and_the_scenarios(run_of):
    settings = Run.read(run_of("ppo")).settings
    models = [new_model(dataclasses.replace(settings, seed=seed)) for seed in (0, 0, 1)]
    weights = [torch.nn.utils.parameters_to_vector(model.policy.parameters()) for model in models]
    for first, same, other in (weights, [torch.as_tensor(model.get_env().reset()) for model in models]):
        assert torch.equal(first, same) and not torch.equal(first, other)
    for model in models:
        model.get_env().close()


def test_export_describes_the_policy_that_it_writes_and_replaces_nothing(copied, tmp_path, capsys):
    entry, other = tmp_path / "entry", ["--output", str(tmp_path / "other")]
    command = [str(copied), "--output", str(entry), "--name", "mine"]
    run = Run.read(copied)
    # A row with a better score whose policy is not there, as an interruption may leave it.
    run.curve[0]["score"] = run.curve[-1]["score"] + 1.0
    run.write()
    assert export_command(command) == 0
    text = 'trained_on = "standard, split train, up to 768 steps; chosen on split validation"'
    assert text in (entry / "entry.toml").read_text()
    assert export_command(command) == 2 and "is there already" in capsys.readouterr().err
    for name in ("a|b", "Fast Droop"):
        assert export_command([str(copied), *other, "--name", name]) == 2
        assert "entry's name must " in capsys.readouterr().err
    del run.curve[-1]
    run.write()
    assert export_command([str(copied), *other]) == 2 and not (tmp_path / "other").exists()


def test_exports_of_several_seeds_share_a_row_whatever_steps_were_best(copied, tmp_path):
    export(copied, tmp_path / "seed-0")
    run, (best,) = Run.read(copied), folders(copied / "best")
    run.settings = dataclasses.replace(run.settings, seed=1)
    run.write()
    best.rename(best.with_name(f"{512:012d}"))
    export(copied, tmp_path / "seed-1")
    first, second = ({*(tmp_path / name / "entry.toml").read_text().splitlines()} for name in ("seed-0", "seed-1"))
    assert first ^ second == {"training_seed = 0", "training_seed = 1"}


def test_run_describes_itself_and_tensorboard_shows_its_scores(tmp_path):
    # Episodes of 600 steps come to their end.
    config, folder = config_file(tmp_path, "ppo", n_envs=8, n_timesteps=8 * 608), tmp_path / "run"
    command = [*V0, "--algo", "ppo", "--config", config, "--validation-episodes", "2", "--output", str(folder)]
    assert main([*command, "--interval", "4864"]) == 0
    data = json.loads((folder / "run.json").read_text())
    assert data["settings"]["action_mode"] == "k+tau" and data["settings"]["hyperparameters"]["n_steps"] == 8
    assert {"command", "git_commit", "suite_hash", "source_hash", "versions"} <= data["provenance"].keys()
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    assert {"rollout/ep_rew_mean", "episode/failure", "validation/score"} <= set(events.Tags()["scalars"])


def test_folder_is_complete_or_not_there(tmp_path):
    save_folder(tmp_path, 1, lambda path: (path / "a").write_text("1"))

    def fails(path: Path) -> None:
        (path / "a").write_text("half")
        raise OSError("disk full")

    names: set[str] = set()
    for _ in range(2):
        with pytest.raises(OSError, match="disk full"):
            save_folder(tmp_path, 2, lambda path: [names.add(path.name), fails(path)])
    assert len(names) == 2
    assert [path.name for path in folders(tmp_path)] == [f"{1:012d}"]
    save_folder(tmp_path, 3, lambda path: (path / "a").write_text("3"))
    assert {path.name for path in tmp_path.iterdir()} == {f"{3:012d}"}


def test_what_cannot_go_on_is_named(copied, capsys):
    def error_of_resume() -> str:
        capsys.readouterr()
        assert main(["--resume", str(copied)]) == 2
        return capsys.readouterr().err

    with held(copied):
        assert f"another process trains in {copied}" in error_of_resume()
    (checkpoint,) = folders(copied / "checkpoints")
    checkpoint.chmod(0o777)
    assert "another user could have written it" in error_of_resume()
    checkpoint.chmod(0o700)
    description = json.loads((checkpoint / "run.json").read_text())
    for change in (
        {"provenance": {**description["provenance"], "started": "1970-01-01T00:00:00Z"}},
        {"settings": {**description["settings"], "seed": 5}},
        {"curve": description["curve"][:-1]},
    ):
        (checkpoint / "run.json").write_text(json.dumps({**description, **change}))
        assert f"{checkpoint} is a checkpoint of another run or" in error_of_resume()
    (checkpoint / "run.json").write_text(json.dumps(description))
    for path in (*checkpoint.iterdir(), copied / "run.json"):
        intact = path.read_bytes()
        path.write_bytes(intact[: len(intact) // 2])
        assert str(path if path.name == "run.json" else checkpoint) in error_of_resume()
        path.write_bytes(intact)
    shutil.rmtree(copied / "checkpoints")
    assert "no checkpoint to go on from" in error_of_resume()
    (copied / "run.json").write_text('{"settings": "ppo"}')
    assert "run.json: it holds what cannot be used" in error_of_resume()


@pytest.mark.parametrize(("arguments", "text"), BAD)
def test_bad_options_are_refused_before_anything_runs(arguments, text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.json").touch()
    changed = {"bad": {"n_envs": "many"}, "rate": {"learning_rate": "lin_fast"}, "key": {"frame_stack": 4}}
    for name, changes in changed.items():
        Path(config_file(tmp_path, "ppo", **changes)).rename(f"{name}.yml")
    of_v0 = [] if "--resume" in arguments or "--suite" in arguments else V0
    assert main([*of_v0, *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and re.search(text, error), error
    assert not (tmp_path / "new" / "run.json").exists()


@pytest.mark.parametrize("name", [*TRAINED, "ppo_tau"])
def test_shipped_files_mean_what_rl_zoo_makes_of_them(name):
    path = CONFIG_FOLDER / f"{name}.yml"
    raw, read = yaml.safe_load(path.read_text())[ENV_ID], read_config(path, ENV_ID)
    arguments = training.algorithm_arguments(read)
    # RL Zoo evaluates texts, takes dictionaries as they are, and the part after "lin_" for a schedule that falls to 0.
    assert arguments["policy_kwargs"] == raw["policy_kwargs"] and isinstance(raw["policy_kwargs"], dict)
    start, schedule = float(raw["learning_rate"].removeprefix("lin_")), arguments["learning_rate"]
    assert [schedule(left) for left in (1.0, 0.5, 0.0)] == pytest.approx([start, start / 2, 0.0])
    assert raw["normalize"] is True and training.normalization_arguments(read) == {"gamma": raw["gamma"]}


@pytest.mark.parametrize(("content", "text"), BAD_FILES)
def test_files_without_a_section_in_plain_yml_are_refused(content, text, tmp_path):
    (tmp_path / "a.yml").write_text(content)
    with pytest.raises(ValueError, match=text):
        read_config(tmp_path / "a.yml", ENV_ID)


def test_every_trained_policy_is_the_one_of_its_record():
    records = json.loads(shipped.RECORDS.read_text(encoding="utf-8"))
    for folder in policy_folders():
        (entry,) = load_entries(folder)
        # One feedback is older than the records; policies of others have none.
        if folder.name == "linear-feedback" or entry.source != "The wtg_gym authors":
            continue
        record = records.pop(folder.name)
        assert record["policy_sha256"] == sha256((folder / "policy.onnx").read_bytes())
        assert f"--seed {entry.training_seed} " in record["command"] and entry.kind == "learned"
    assert not records


def test_the_page_has_the_table_and_the_curves_that_the_command_makes():
    assert shipped.table() in shipped.PAGE.read_text(encoding="utf-8")
    records = json.loads(shipped.RECORDS.read_text(encoding="utf-8")).values()
    assert len(shipped.curves().axes[0].lines) == sum("curve" in record for record in records)


def test_a_run_is_added_by_its_best_policy(tmp_path, monkeypatch):
    (folder,) = [folder for folder in policy_folders() if folder.name == "ppo-v1-2"]
    best = tmp_path / "run" / "best" / f"{2_150_400:012d}"
    best.mkdir(parents=True)
    (best / "policy.onnx").write_bytes((folder / "policy.onnx").read_bytes())
    run = Run.new(tmp_path / "run", RunSettings(algo="ppo", hyperparameters={}, timesteps=2_250_000, n_envs=512))
    rows = ((2_150_400, 102.46, 60.0), (2_304_000, 1.0, 70.0))
    names = ("timesteps", "score", "wall_time_s")
    run.curve = [{**dict(zip(names, row, strict=True)), "marked": 1.0} for row in rows]
    run.write()
    monkeypatch.setattr(shipped, "PICTURE", tmp_path / "training.svg")
    for name in ("RECORDS", "PAGE"):
        monkeypatch.setattr(shipped, name, Path(shutil.copy(getattr(shipped, name), tmp_path / name)))
    assert shipped.main([str(tmp_path / "run")]) == 0
    record = json.loads(shipped.RECORDS.read_text(encoding="utf-8"))["ppo-v1-2"]
    assert (record["steps"], record["validation_score"], record["wall_time_s"]) == (2_150_400, 102.5, 70)
    assert "| 1.2 |" in shipped.table()


def test_modes_of_the_commands_are_those_of_the_environment():
    hints = get_type_hints(RunSettings)
    assert get_args(hints["action_mode"]) == tuple(ACTION_MODES)
    assert get_args(hints["observation_mode"]) == OBSERVATION_MODES
