"""What becomes of every hostile submission is what its row names, and docs/submissions.md says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.submissions.hostile import ATTACKS, PAGE, SECTION, Attack, row, verdict
from wtg_gym.policies import policy_process

ROOT = Path(__file__).resolve().parents[2]
#: Each of these takes all the time that its first answer may take.
ENDLESS = ("a loop that does not end", "an operator that takes its time")


@pytest.mark.parametrize("attack", ATTACKS, ids=[attack.name for attack in ATTACKS])
def test_hostile_submission_is_stopped(attack: Attack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Long enough for every other step, on a busy machine too.
    monkeypatch.setattr(policy_process, "STEP_S", 5.0)
    monkeypatch.setattr(policy_process, "LOAD_S", 8.0 if attack.name in ENDLESS else 20.0)
    end, reason = verdict(attack, tmp_path)
    assert end == attack.end, reason
    assert reason and reason.isprintable() and len(reason) < 1600
    # Reasons may quote a library, whose words change.
    assert row(attack, end, "").removesuffix("`` |") in (ROOT / PAGE).read_text(encoding="utf-8")
    # What is in a pickle would have left it here.
    assert not (tmp_path / "trace").exists()


def test_page_shows_every_attack_once() -> None:
    page = (ROOT / PAGE).read_text(encoding="utf-8")
    table = page.partition(f"<!-- {SECTION}:start -->")[2].partition(f"<!-- {SECTION}:end -->")[0]
    assert [line.split(" | ")[0].removeprefix("| ") for line in table.strip().splitlines()[2:]] == [
        attack.name for attack in ATTACKS
    ]
