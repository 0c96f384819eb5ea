"""Every hostile submission is refused by the check that its row names, and docs/submissions.md says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.submissions.hostile import ATTACKS, PAGE, SECTION, Attack, row, verdict

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("attack", ATTACKS, ids=[attack.name for attack in ATTACKS])
def test_hostile_submission_is_refused(attack: Attack, tmp_path: Path) -> None:
    check, reason = verdict(attack, tmp_path)
    assert check == attack.check, reason
    assert reason and reason.isprintable() and len(reason) < 1600
    # Reasons may quote a library, whose words change.
    assert row(attack, check, "").removesuffix("`` |") in (ROOT / PAGE).read_text(encoding="utf-8")
    # What is in a pickle would have left it here, what is in an archive there.
    assert not (tmp_path / "trace").exists() and not (tmp_path.parent / "escaped").exists()


def test_page_shows_every_attack_once() -> None:
    page = (ROOT / PAGE).read_text(encoding="utf-8")
    table = page.partition(f"<!-- {SECTION}:start -->")[2].partition(f"<!-- {SECTION}:end -->")[0]
    assert [line.split(" | ")[0].removeprefix("| ") for line in table.strip().splitlines()[2:]] == [
        attack.name for attack in ATTACKS
    ]
