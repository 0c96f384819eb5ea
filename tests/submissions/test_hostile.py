"""Every hostile submission gets its verdict, and docs/submissions.md counts them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.submissions.hostile import ATTACKS, HARMLESS, PAGE, SCORED, SECTION, Attack, table, verdict
from wtg_gym.policies import gate, policy_process
from wtg_gym.policies.onnx_policy import OnnxPolicy

ROOT = Path(__file__).resolve().parents[2]
#: Each of these takes all the time that an answer may take, if it is harmful.
ENDLESS = ("an endless loop", "a slow operator")


@pytest.mark.parametrize("attack", ATTACKS, ids=[f"{attack.end}: {attack.name}" for attack in ATTACKS])
def test_hostile_submission_is_stopped(attack: Attack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Long enough for every other step, on a busy machine too.
    monkeypatch.setattr(policy_process, "STEP_S", 2.0 if attack.name in ENDLESS else 5.0)
    monkeypatch.setattr(policy_process, "LOAD_S", 20.0)
    if attack.name in ENDLESS and attack.end != SCORED:
        # It is loaded in its time, and takes all that its first answer may take.
        check_speed = gate.check_speed

        def impatient(policy: OnnxPolicy) -> str:
            monkeypatch.setattr(policy_process, "LOAD_S", 2.0)
            return check_speed(policy)

        monkeypatch.setattr(gate, "check_speed", impatient)
    if attack.end != HARMLESS:
        # Its verdict is another one than that its answers repeat, which is looked at in all of the gate's scenarios.
        monkeypatch.setattr(gate, "_ROLLOUT_LANES", 8)
    end, reason = verdict(attack, tmp_path)
    assert end == attack.end, reason
    assert reason and reason.isprintable() and len(reason) < 1600
    # What is in a pickle would have left it here.
    assert not (tmp_path / "trace").exists()


def test_page_counts_every_attack_under_its_verdict() -> None:
    page = (ROOT / PAGE).read_text(encoding="utf-8")
    block = page.partition(f"<!-- {SECTION}:start -->")[2].partition(f"<!-- {SECTION}:end -->")[0]
    ends = [attack.end for attack in ATTACKS]
    assert block.strip() == table(ends)
    # Every attack is counted: none has a verdict that it leaves out.
    assert sum(int(line.split(" | ")[1]) for line in block.strip().splitlines()[2:]) == len(ATTACKS)
