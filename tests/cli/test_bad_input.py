"""Bad input to any command: one line on stderr, exit code 2, nothing played and nothing written."""

import json
import shlex
import sys

import pytest

from tests.cli.calls import error_of
from wtg_gym import evaluate, get_suite

#: A command line, and what its error says; of what the package refuses, a row for each kind.
BAD = [
    ("fly", "fly"),
    ("simulate --wind strong", "strong"),
    ("play --speed 0", "Must be >= 0.1"),
    ("play --seed -1", "is in no split of suite 'standard-v1'"),
    ("results recompute", "RESULTS"),
    ("results recompute", "(see: wtg-gym results recompute --help)"),
    ("simulate --wnd 8", "(see: wtg-gym simulate --help)"),
    ("evaluate --entries", "--entries requires at least 1 element"),
    ("simulate --wind 8 --wind-csv wind.csv", "--wind and --wind-csv exclude each other"),
    ("simulate --scenario good.json --seed 3 --suite standard", "--scenario and --seed exclude each other"),
    ("simulate --suite standard --seed 3", "seed 3 is in no split"),
    ("simulate --suite paper-v1 --wind 9 8", "wind for 2 WTG groups, paper-v1 has 4"),
    ("simulate --plot run.jpg", 'supported extensions {"png", "svg", "pdf"}'),
    ("grid import case.m --output run.txt", 'must have extension "json"'),
    ("simulate --plot folder.png", '"folder.png" is a directory'),
    ("simulate --plot file.txt/run.png", "file.txt is not a folder"),
    ("evaluate --results /proc/results", "The folder /proc is not writable"),
    ("report mppt --output /proc/results/page.html", "The folder /proc is not writable"),
    ("simulate --scenario nowhere.json", "cannot read the scenario file nowhere.json"),
    ("simulate --scenario broken.json", "broken.json is not JSON"),
    ("simulate --scenario long.json", "long.json"),
    ("simulate --scenario sensors.json", "say with --suite whose grid it is"),
    ("simulate --strategy formula.toml", "the law file formula.toml: the name of a law must be 1 … 60 characters"),
    ("simulate --strategy alike.toml", "alike.toml: name 'M-PPT' is, or looks like, that of a built-in law"),
    ("simulate --wind-csv nowhere.csv", "nowhere.csv: No such file"),
    ("evaluate --entries mppt mppt", "the entry mppt is given twice"),
    ("evaluate --entries best", "the folder best holds no entry.toml; several folders are best/*"),
    ("evaluate --entries best/empty", "the folder best/empty holds no entry.toml"),
    ("evaluate --entries model.zip", "model.zip: an archive of Stable-Baselines3 is not opened"),
    ("evaluate --suite paper-v1 --entries 'PPO (k)'", "is for GFMWTG-14bus-v0, these scenarios are of"),
    ("evaluate --suite paper --entries fast-droop", "is for GFMWTG-14bus-v1, these scenarios are of GFMWTG-14bus-v0"),
    ("evaluate --seeds 10003 10003", "every seed may be given once; given more often: 10003"),
    ("evaluate --seeds 3", "the validation seeds of suite 'standard-v1' are 10000 … 10299"),
    ("evaluate --scenarios 301", "--scenarios = 301 is outside the allowed range 1 … 300"),
    ("evaluate --seeds 20000-20010", '"20000-20010"'),
    ("evaluate --duration 0.2", "duration_s = 0.2 s is outside the allowed range 1 … 3600 s"),
    (f"evaluate --seeds {' 1' * 2000}", "the command line has 2004 items; allowed: at most 2000"),
    ("evaluate --threads 0", "the number of threads must be a whole number of 1 or more, got 0"),
    ("evaluate --results file.txt", '"file.txt" is a file'),
    ("evaluate --address tcp://head:8786", "--address is for workers: say which with --backend loky, dask"),
    ("evaluate --backend loky --address tcp://head:8786", "loky has workers on this machine only"),
    ("evaluate --backend loky --threads 2", "--threads 2: a worker steps with one thread; say how many with --jobs"),
    ("leaderboard --suite paper --readme nowhere.md", "cannot read the file with the markers"),
    ("leaderboard --suite paper --readme file.txt", "must have the markers <!-- leaderboard:paper:start -->"),
    ("results recompute nowhere.json", "nowhere.json"),
    ("results recompute paper-test.json --entries no-such-thing", "unknown entry"),
    ("results recompute paper-test.json", "hold entries that were not given: deloaded-7"),
    ("submission check best/1000 nowhere", 'error: Invalid value "nowhere" for FOLDERS. "nowhere" does not exist.'),
    ("submission new best/1000", "has entry.toml already"),
    ("submission new a_folder!", "the folder's name must be 1 … 80"),
    ("report baselines", "a report is about one entry"),
    ("report mppt --output page.pdf", 'supported extensions {"html", "htm", "md"}'),
    ("simulate --scenario no-\x1b[31m-file.json", r"no-\x1b[31m-file.json"),
    ("results recompute no-\u202efile.json", r"no-\u202efile.json"),
    ("evaluate --entries no-\x1b[31m-file", r"no-\x1b[31m-file"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("bad")
    (root / "file.txt").write_text("not a folder")
    (root / "folder.png").mkdir()
    for name in ("best/1000", "best/2000"):
        (root / name).mkdir(parents=True)
        (root / name / "entry.toml").write_text('name = "mine"\naction_mode = "k"\n')
    (root / "best/empty").mkdir()
    (root / "wind.csv").touch()
    (root / "broken.json").write_text('{"name": ')
    scenario = get_suite("standard").scenario(20_003).to_dict()
    (root / "good.json").write_text(json.dumps(scenario))
    (root / "long.json").write_text(json.dumps({**scenario, "events": "x" * 100_000}))
    (root / "sensors.json").write_text(get_suite("standard-v1").scenario(20_003).to_json())
    for file, name in (("seven", "deloaded-7"), ("formula", "=1+1"), ("alike", "M-PPT")):
        (root / f"{file}.toml").write_text(f'name = "{name}"\nk_min = 0.3\nk_nominal = 0.35\nk_max = 0.4\n')
    evaluate(root / "seven.toml", "paper", "test", duration_s=2.0).write(root)
    return root


@pytest.mark.parametrize(("line", "said"), BAD, ids=lambda text: ascii(text)[:60])
def test_bad_input_is_one_line_and_leaves_nothing(line, said, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    before = set(folder.rglob("*"))
    words = shlex.split(line)
    # Where the table says nothing of entries, one that is there.
    if words[0] == "evaluate" and "--entries" not in words:
        words += ["--entries", "mppt"]
    error = error_of(capsys, *words)
    assert said in error and error.isprintable() and len(error) < 2000
    assert set(folder.rglob("*")) == before


def test_missing_matplotlib_is_said_before_anything_runs(capsys, monkeypatch, tmp_path):
    # A module that is None in sys.modules cannot be imported.
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    line = error_of(capsys, "simulate", "--plot", str(tmp_path / "run.png"))
    assert "--plot needs matplotlib; in a checkout: pip install '.[leaderboard]'" in line
