"""The card of every shipped policy that a learner trained has its file's sha256 and its command."""

from __future__ import annotations

from wtg_gym.evaluation import load_entries
from wtg_gym.files import sha256
from wtg_gym.policies.entry_folder import policy_folders


def test_every_trained_policy_is_there_and_its_card_has_its_command() -> None:
    n_cards = 0
    for folder in policy_folders():
        (entry,) = load_entries(folder)
        # A feedback is one run, not one of several seeds; policies of others may have any card.
        if "feedback" in folder.name or entry.source != "The wtg_gym authors":
            continue
        card, n_cards = (folder / "README.md").read_text(encoding="utf-8"), n_cards + 1
        assert (str(entry.training_seed), entry.kind) == (folder.name.rpartition("-")[2], "learned")
        assert " -m agents." in card and sha256((folder / "policy.onnx").read_bytes()) in card
    assert n_cards == 44
