"""Facts about fresh seeds: nobody can choose them, and everybody can draw them again."""

from __future__ import annotations

import dataclasses
import hashlib
import hmac

from hypothesis import given
from hypothesis import strategies as st

from wtg_gym.scenarios import SPLITS, draw_seeds, get_suite

COMMIT = "0123456789abcdef0123456789abcdef01234567"
SECRET = b"sixteen bytes or more"


def test_seeds_are_the_written_formula() -> None:
    drawn = draw_seeds("gust", COMMIT, SECRET, 3)
    texts = (f"wtg_gym verification\ngust\n{get_suite('gust').hash}\n{COMMIT}\n{i}".encode() for i in range(3))
    numbers = (int.from_bytes(hmac.digest(SECRET, text, "sha256")[:8], "big") for text in texts)
    assert list(drawn.seeds) == [2**32 + number % (2**53 - 2**32) for number in numbers]
    assert drawn.secret_sha256 == hashlib.sha256(SECRET).hexdigest()


@given(st.binary(min_size=16, max_size=80), st.integers(1, 300))
def test_seeds_are_different_and_in_no_frozen_split(secret: bytes, n: int) -> None:
    seeds = draw_seeds("standard", COMMIT, secret, n).seeds
    assert len(set(seeds)) == n
    frozen = [get_suite("standard").seeds(split) for split in SPLITS]
    assert not any(seed in split for seed in seeds for split in frozen)
    # JavaScript's and JSON's numbers hold them exactly.
    assert all(int(float(seed)) == seed for seed in seeds)


def test_draw_knows_its_secret() -> None:
    drawn = draw_seeds("standard", COMMIT, SECRET, 5)
    assert drawn.is_of(SECRET) and not drawn.is_of(SECRET + b"!")
    chosen = dataclasses.replace(drawn, seeds=(*drawn.seeds[:4], 2**40))
    assert not chosen.is_of(SECRET)
