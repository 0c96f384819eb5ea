"""Fresh scenarios: seeds drawn after a submission, from its commit and a secret.

The test scenarios are public, so a policy can be fitted to them, by mistake or on purpose. Seeds that depend on the
commit cannot be known before the submission is made; that they also depend on a secret keeps its authors from trying
commits until the draw suits them. The secret's sha256 is published beforehand and the secret afterwards: then everybody
can see that the seeds are those of commit and secret.
"""

from __future__ import annotations

import hashlib
import hmac
import itertools
import re
from dataclasses import dataclass

from wtg_gym.ranges import require_whole
from wtg_gym.scenarios.suite import FRESH
from wtg_gym.scenarios.suites import get_suite

#: Scenarios of one evaluation at most: the intervals of its scores take memory in proportion.
MOST_SCENARIOS = 10_000
_SHORTEST_SECRET = 16
_COMMIT = re.compile("[0-9a-f]{40}|[0-9a-f]{64}")
_SHA256 = re.compile("[0-9a-f]{64}")


@dataclass(frozen=True, kw_only=True)
class FreshDraw:
    """Seeds of the split "fresh", with the commit and the secret's sha256 that they were drawn from.

    Args:
        suite: name of the suite.
        commit: full hash of the git commit with the submissions, 40 or 64 hexadecimal digits.
        secret_sha256: sha256 of the secret.
        seeds: the seeds, all different.

    Raises:
        ValueError: a value is not of this form, or a seed is not of the split.
    """

    suite: str
    commit: str
    secret_sha256: str
    seeds: tuple[int, ...]

    def __post_init__(self) -> None:
        allowed = get_suite(self.suite).seeds(FRESH)
        _check_commit(self.commit)
        if not isinstance(self.secret_sha256, str) or _SHA256.fullmatch(self.secret_sha256) is None:
            raise ValueError(f"secret_sha256 must be 64 hexadecimal digits, got {self.secret_sha256!r}")
        wrong = [seed for seed in self.seeds if type(seed) is not int or seed not in allowed]
        if wrong or not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(
                f"seeds of a draw must be at least one, all different, {allowed.start} … {allowed.stop - 1}; "
                f"got {(wrong or list(self.seeds))[:5]}"
            )

    def is_of(self, secret: bytes) -> bool:
        """Return whether these are the seeds that :func:`draw_seeds` gives for a secret."""
        return self == draw_seeds(self.suite, self.commit, secret, len(self.seeds))


def draw_seeds(suite: str, commit: str, secret: bytes, n: int | None = None) -> FreshDraw:
    """Draw seeds: HMAC-SHA256 of suite, its hash, commit and a counter under the secret, 8 bytes of each digest.

    Args:
        suite: name of a suite whose scenarios are drawn.
        commit: full hash of a git commit, 40 or 64 hexadecimal digits.
        secret: 16 bytes or more; as many as cannot be guessed.
        n: how many, 1 … 10000, fewer seeds are the first of more; None: as many as the test split has.

    Raises:
        ValueError: an argument is out of range, or the suite has fixed cases only.
    """
    drawn = get_suite(suite)
    allowed = drawn.seeds(FRESH)
    _check_commit(commit)
    if len(secret) < _SHORTEST_SECRET:
        raise ValueError(f"the secret must have {_SHORTEST_SECRET} bytes or more, got {len(secret)}")
    n = len(drawn.test) if n is None else n
    n = require_whole("the number of scenarios to draw", n, 1, MOST_SCENARIOS)
    seeds: dict[int, None] = {}
    for counter in itertools.count():
        if len(seeds) == n:
            break
        # The word is part of the rounds that are published.
        message = f"wtg_gym verification\n{suite}\n{drawn.hash}\n{commit}\n{counter}"
        digest = hmac.digest(secret, message.encode(), "sha256")
        seeds[allowed.start + int.from_bytes(digest[:8], "big") % len(allowed)] = None
    return FreshDraw(suite=suite, commit=commit, secret_sha256=hashlib.sha256(secret).hexdigest(), seeds=tuple(seeds))


def _check_commit(commit: str) -> None:
    if not isinstance(commit, str) or _COMMIT.fullmatch(commit) is None:
        raise ValueError(f"commit must be a full git hash of 40 or 64 hexadecimal digits, got {commit!r}")
