"""Facts about fresh seeds: nobody can choose them, and everybody can draw them again."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wtg_gym.scenarios import FRESH, SPLITS, SUITES, FreshDraw, draw_seeds, get_suite

COMMIT = "0123456789abcdef0123456789abcdef01234567"
SECRET = b"sixteen bytes or more"


def hmac_sha256(key: bytes, message: bytes) -> bytes:
    """RFC 2104, written out."""
    padded = key.ljust(64, b"\0")
    inner = hashlib.sha256(bytes(byte ^ 0x36 for byte in padded) + message).digest()
    return hashlib.sha256(bytes(byte ^ 0x5C for byte in padded) + inner).digest()


def test_seeds_are_the_written_formula() -> None:
    drawn = draw_seeds("gust", COMMIT, SECRET, 3)
    expected = [
        2**32
        + int.from_bytes(
            hmac_sha256(SECRET, f"wtg_gym verification\ngust\n{get_suite('gust').hash}\n{COMMIT}\n{i}".encode())[:8],
            "big",
        )
        % (2**53 - 2**32)
        for i in range(3)
    ]
    assert list(drawn.seeds) == expected
    assert drawn.secret_sha256 == hashlib.sha256(SECRET).hexdigest()


def test_every_input_changes_all_seeds() -> None:
    base = set(draw_seeds("standard", COMMIT, SECRET).seeds)
    others = [
        draw_seeds("weak-grid", COMMIT, SECRET),
        draw_seeds("standard", "f" * 40, SECRET),
        draw_seeds("standard", "f" * 64, SECRET),
        draw_seeds("standard", COMMIT, SECRET + b"!"),
    ]
    assert len(base) == 200
    assert not any(base & set(other.seeds) for other in others)


@given(st.binary(min_size=16, max_size=80), st.integers(1, 300))
def test_seeds_are_different_and_in_no_frozen_split(secret: bytes, n: int) -> None:
    seeds = draw_seeds("standard", COMMIT, secret, n).seeds
    assert len(set(seeds)) == n
    frozen = [get_suite("standard").seeds(split) for split in SPLITS]
    assert not any(seed in split for seed in seeds for split in frozen)
    # JavaScript's and JSON's numbers hold them exactly.
    assert all(int(float(seed)) == seed for seed in seeds)


def test_fewer_seeds_are_the_first_of_more() -> None:
    assert draw_seeds("standard", COMMIT, SECRET, 300).seeds[:7] == draw_seeds("standard", COMMIT, SECRET, 7).seeds


def test_draw_knows_its_secret() -> None:
    drawn = draw_seeds("standard", COMMIT, SECRET, 5)
    assert drawn.is_of(SECRET) and not drawn.is_of(SECRET + b"!")
    chosen = dataclasses.replace(drawn, seeds=(*drawn.seeds[:4], 2**40))
    assert not chosen.is_of(SECRET)


@pytest.mark.parametrize("suite", [name for name, suite in SUITES.items() if suite.distribution is not None])
def test_scenarios_of_drawn_seeds_are_like_those_of_the_suite(suite: str) -> None:
    drawn = draw_seeds(suite, COMMIT, SECRET, 3)
    scenarios = get_suite(suite).scenarios(drawn.seeds)
    assert [scenario.seed for scenario in scenarios] == list(drawn.seeds)
    assert all(scenario.duration_s == get_suite(suite).duration_s for scenario in scenarios)
    assert len({float(scenario.wind_speed.mean()) for scenario in scenarios}) == 3


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"suite": "paper"}, "suite 'paper' has fixed cases"),
        ({"suite": "nowhere"}, "unknown suite 'nowhere'"),
        ({"commit": "abc"}, "full git hash of 40 or 64 hexadecimal digits, got 'abc'"),
        ({"commit": COMMIT.upper()}, "full git hash"),
        ({"secret": b"short"}, "16 bytes or more, got 5"),
        ({"n": 0}, r"1 … 100000, got 0"),
        ({"n": True}, r"1 … 100000, got True"),
    ],
)
def test_bad_draws_are_refused(change: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        draw_seeds(**{"suite": "standard", "commit": COMMIT, "secret": SECRET, "n": 5, **change})


@pytest.mark.parametrize("seeds", [(), (2**40, 2**40), (20_000,), (2**53,), (True,), (2.0**40,)])
def test_draw_holds_seeds_of_the_split_only(seeds: Any) -> None:
    with pytest.raises(ValueError, match="seeds of a draw"):
        FreshDraw(suite="standard", commit=COMMIT, secret_sha256="0" * 64, seeds=seeds)


def test_frozen_suites_know_nothing_of_the_split() -> None:
    assert FRESH not in SPLITS
    with pytest.raises(ValueError, match="there is nothing to draw"):
        get_suite("paper").seeds(FRESH)
