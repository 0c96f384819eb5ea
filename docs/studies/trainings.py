"""`python -m docs.studies.trainings`: how the shipped policies were trained, as table and picture of docs/agents.md."""

import functools
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.run import BEST, Run, folders, note, run_command
from wtg_gym import files
from wtg_gym.plotting.style import DOUBLE_COLUMN_MM, law_looks, new_figure, printed, save_figure
from wtg_gym.policies.entry_folder import ENTRY_FILE, POLICY_FILE, policy_folders

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: One record per folder of agents/policies that a command of `agents` trained.
PAGE = Path(__file__).parents[1] / "agents.md"
RECORDS = PAGE.parents[1] / "agents" / "shipped.json"
PICTURE = PAGE.parent / "images" / "training"
_OUTPUT = re.compile(r"(?<= --output )\S+")
#: What differs between the commands of several seeds.
_OF_A_SEED = ((re.compile(r" --(seed|output) \S+"), ""), (re.compile(r"( --start \S+-)\d+"), r"\1SEED"))
_COLUMNS = ("policy", "seeds", "steps [million]", "validation score", "minutes", "command", "commit")


def record(run_folder: Path) -> tuple[str, dict[str, Any]]:
    """Return the folder in agents/policies with the best policy of a run, and the record of its training."""
    run = Run.read(run_folder)
    shipped = {files.sha256((folder / POLICY_FILE).read_bytes()): folder.name for folder in policy_folders()}
    rows = {int(row["timesteps"]): row for row in run.curve}
    for best in folders(run_folder / BEST):
        digest = files.sha256((best / POLICY_FILE).read_bytes())
        if digest in shipped:
            name = shipped[digest]
            return name, {
                # Where the run was written is a path of one machine.
                "command": _OUTPUT.sub(f"runs/{name}", run.provenance["command"]),
                "git_commit": run.provenance["git_commit"],
                "policy_sha256": digest,
                "steps": int(best.name),
                "steps_of_run": run.settings.timesteps,
                "validation_scenarios": run.settings.validation_episodes,
                "validation_score": round(rows[int(best.name)]["score"], 1),
                "wall_time_s": round(run.curve[-1]["wall_time_s"]),
                # Of every validation: minutes since the start, and the score.
                "curve": [[round(row["wall_time_s"] / 60, 1), round(row["score"], 1)] for row in run.curve],
            }
    raise ValueError(f"the best policy of {run_folder} is not in agents/policies: export it first")


def _trainings() -> dict[tuple[str, str], dict[str, dict[str, Any]]]:
    """Return the records of the shipped policies by environment and name, then by folder; of some there is none."""
    records = files.read_json(RECORDS, "records of the trainings")
    trainings: dict[tuple[str, str], dict[str, dict[str, Any]]] = {}
    for folder in policy_folders():
        entry = files.read_toml(folder / ENTRY_FILE, "entry file")
        trainings.setdefault((entry["environment"], entry["name"]), {})[folder.name] = records.get(folder.name, {})
    return trainings


def table() -> str:
    """Return the table: a row per name of an entry and environment, its training seeds together."""
    groups, rows = _trainings(), []
    for environment, name in sorted(groups, key=lambda key: (-int(key[0][-1]), key[1].casefold())):
        trainings = [training for training in groups[environment, name].values() if training]
        rows.append(
            [
                f"{name} ({environment.rpartition('-')[2]})",
                str(len(groups[environment, name])),
                _range([training["steps"] / 1e6 for training in trainings]),
                _range([training["validation_score"] for training in trainings]),
                _range([training["wall_time_s"] / 60 for training in trainings if "wall_time_s" in training]),
                f"`{_without_seed(trainings[0]['command'])}`" if trainings else "",
                ", ".join(dict.fromkeys(f"`{training['git_commit'][:8]}`" for training in trainings)),
            ]
        )
    return files.markdown_table(_COLUMNS, rows, right=(1, 2, 3, 4))


def _without_seed(command: str) -> str:
    return functools.reduce(lambda text, part: part[0].sub(part[1], text), _OF_A_SEED, command)


@printed
def curves() -> "Figure":
    """Return a figure of validation scores over the minutes of training, of every policy whose record has them."""
    groups = _trainings().items()
    shown = [(name, each["curve"]) for (_, name), seeds in groups for each in seeds.values() if "curve" in each]
    looks = law_looks(dict.fromkeys(name for name, _ in shown))
    figure = new_figure(DOUBLE_COLUMN_MM, 70.0)
    axes = figure.subplots()
    for name, curve in shown:
        axes.plot(*zip(*curve, strict=True), color=looks[name].colour, ls=looks[name].dashes, label=name)
    axes.set(xlabel="minutes", ylabel="validation score", ylim=(100.0, None))
    by_name = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    axes.legend(by_name.values(), by_name.keys(), loc="lower right")
    return figure


def _range(values: Sequence[float]) -> str:
    """Return the least and the largest of some values, or the one that they are."""
    return " … ".join(dict.fromkeys(f"{value:.1f}" for value in (min(values), max(values)))) if values else ""


def command(*runs: Path) -> None:
    """Write table and curves of docs/agents.md, from agents/shipped.json and the entry.toml of each policy.

    Args:
        runs: folders of runs whose best policies are files of agents/policies, to add to agents/shipped.json first
    """
    records = files.read_json(RECORDS, "records of the trainings")
    records |= dict(record(run) for run in runs)
    files.write_atomically(RECORDS, files.to_json(records))
    save_figure(curves(), PICTURE, ["svg"])
    changed = files.update_between_markers(PAGE, table(), "shipped")
    note(f"{PAGE}: {'updated' if changed else 'already up to date'}")


main = functools.partial(run_command, command, "docs.studies.trainings", "run it again")

if __name__ == "__main__":
    sys.exit(main())
