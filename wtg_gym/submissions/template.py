"""A commented entry.toml to fill in."""

from __future__ import annotations

from pathlib import Path

from wtg_gym.evaluation.entries import ENTRY_FILE, POLICY_FILE
from wtg_gym.files import write_atomically
from wtg_gym.submissions.folder import read_policy

_TEMPLATE = """\
# A submission: this file, policy.onnx and, if you like, a README.md, in a folder of their own. Nothing in it is code.
# `wtg-gym submission check FOLDER` says whether it is accepted, and why not.

# Stands in the table, must be filled in: letters, digits, blanks and ( ) + - . , = _. Policies trained with several
# seeds are several folders of one name, each with its own training_seed; they share a row, whose interval covers them.
name = ""

# One sentence on what it is.
description = ""

# Who made it, at least one name, such as ["Jane Doe", "John Roe"].
authors = []

# Seed it was trained with.
training_seed = 0

# What its actions mean: "k", "tau" or "k+tau".
action_mode = "k+tau"

# What it sees: "local", what a group's own controller measures, or "privileged", the state of the grid as well.
observation_mode = "local"

# What it was trained on: suite, split, steps. Test scenarios are for scoring only.
trained_on = "standard, split train"

# https addresses of a paper or of the training code.
links = []
"""


def write_template(folder: Path, policy: Path | None = None) -> list[Path]:
    """Write an entry.toml to fill in, and a copy of a policy beside it.

    Args:
        folder: where to; made if missing.
        policy: an .onnx file to copy; None for none.

    Returns:
        the files written.

    Raises:
        ValueError: one of the files is there already, or the policy is no plain file or too large.
    """
    content = None if policy is None else read_policy(policy)
    wanted = {ENTRY_FILE: _TEMPLATE.encode(), **({} if content is None else {POLICY_FILE: content})}
    there = [name for name in wanted if (folder / name).exists()]
    if there:
        raise ValueError(f"{folder} has {' and '.join(there)} already; choose another folder")
    for name, data in wanted.items():
        write_atomically(folder / name, data)
    return [folder / name for name in wanted]


__all__ = ["write_template"]
