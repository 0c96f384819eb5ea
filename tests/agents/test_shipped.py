"""The card of every shipped policy that a learner trained has its file's sha256 and its command."""

from __future__ import annotations

from wtg_gym.evaluation import load_entries
from wtg_gym.files import sha256
from wtg_gym.policies.load import policy_folders


def test_every_trained_policy_is_there_and_its_card_has_its_command() -> None:
    # The feedbacks were tuned by hand and have no cards.
    cards = [folder / "README.md" for folder in policy_folders() if "feedback" not in folder.name]
    assert len(cards) == 39
    for path in cards:
        card, (entry,) = path.read_text(encoding="utf-8"), load_entries(path.parent)
        assert (str(entry.training_seed), entry.kind) == (path.parent.name.rpartition("-")[2], "learned")
        assert " -m agents." in card and sha256((path.parent / "policy.onnx").read_bytes()) in card
