"""The compiled streams are those of numpy's default generator."""

import numpy as np
import pytest

from wtg_gym.scenarios.stream import draw_normals, draw_uniforms, seed_streams

SEEDS = [0, 1, 7, 2**32 - 1, 2**32, 2**40 + 3, 2**63 - 1, *range(1_000_000, 1_000_300)]


@pytest.mark.parametrize("key", [0, 1, 0x2360ED05, 2**32 - 1])
def test_streams_are_those_of_numpy_bit_for_bit(key: int):
    states = seed_streams(SEEDS, key)
    uniforms, more, normals = (np.empty((len(SEEDS), n)) for n in (64, 3, 3606))
    draw_uniforms(states, uniforms)
    draw_normals(states, np.ones((len(SEEDS), 1803)), normals.reshape(-1, 1803, 2))
    draw_uniforms(states, more)
    for i, seed in enumerate(SEEDS):
        reference = np.random.default_rng([seed, key])
        assert (uniforms[i] == reference.random(64)).all()
        assert (normals[i] == reference.standard_normal(3606)).all()
        assert (more[i] == reference.random(3)).all()


def test_streams_reach_every_layer_of_the_ziggurat_and_its_tail():
    states = seed_streams([3], 5)
    normals = np.empty((1, 2_000_000))
    draw_normals(states, np.full((1, 1_000_000), 2.0), normals.reshape(1, -1, 2))
    assert (normals[0] == 2.0 * np.random.default_rng([3, 5]).standard_normal(2_000_000)).all()
    assert normals.max() > 2.0 * 3.6541528853610088 and normals.min() < -2.0 * 3.6541528853610088
