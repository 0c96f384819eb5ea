"""Groups that share the paper's plant; units and sources are tests/analysis/test_parameter_list.py's matter."""

from __future__ import annotations

import pytest

from wtg_gym.physics.parameters import default_groups


@pytest.mark.parametrize("n_groups", [1, 2, 20])
def test_default_groups_share_the_papers_hundred_megawatt(n_groups: int) -> None:
    groups = default_groups(n_groups)
    assert len(groups) == n_groups
    assert sum(group.n_turbines for group in groups) * 5.0 == pytest.approx(100.0)


@pytest.mark.parametrize("n_groups", [0, -1, 2.0, True, "2", 1025])
def test_impossible_numbers_of_groups_are_refused(n_groups: object) -> None:
    with pytest.raises(ValueError, match="must be 1 … 1024"):
        default_groups(n_groups)  # type: ignore[arg-type]
