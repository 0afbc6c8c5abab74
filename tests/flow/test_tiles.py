"""Tiles: how they fit together, and that they give what the whole gives."""

from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eofm.errors import InputError
from eofm.flow.tiles import blend, common, cut
from eofm.imaging.splines import needed, resize, resize_field, resize_part


@st.composite
def divisions(draw):
    """A shape, numbers of tiles and an overlap that fit each other."""
    ndim = draw(st.integers(2, 3))
    counts = draw(st.tuples(*[st.integers(1, 3)] * ndim))
    overlap = draw(st.integers(1, 5))
    shape = tuple(draw(st.integers(2 * overlap * c, 2 * overlap * c + 9)) for c in counts)
    return shape, counts, overlap


@given(divisions())
@settings(max_examples=50, deadline=None)
def test_tiles_are_a_partition_of_unity(division):
    shape, counts, overlap = division
    tiles = cut(shape, counts, overlap)
    assert len(tiles) == np.prod(counts)
    seen, total = np.zeros(shape, int), np.zeros(shape)
    for tile in tiles:
        seen[tile.core] += 1
        weight = reduce(np.multiply.outer, tile.weights(shape, overlap))
        assert (weight >= 0).all()
        total[tile.region] += weight
    assert (seen == 1).all()
    np.testing.assert_allclose(total, 1, atol=1e-12)


@given(divisions(), st.data())
@settings(max_examples=30, deadline=None)
def test_parts_of_tiles_blend_into_any_window_of_a_field(division, data):
    shape, counts, overlap = division
    window = []
    for n in shape:
        first = data.draw(st.integers(0, n - 1))
        window.append(slice(first, data.draw(st.integers(first + 1, n))))
    window = tuple(window)
    whole = np.random.default_rng(1).random((2, *shape))
    field = np.zeros((2, *(w.stop - w.start for w in window)))
    for tile in cut(shape, counts, overlap):
        both = common(window, tile.region)
        if both is not None:
            blend(field, window, tile, whole[:, *both], shape, overlap)
    np.testing.assert_allclose(field, whole[:, *window], atol=1e-12)


def test_weights_have_no_kink():
    (tile, _) = cut((80,), (2,), 16)
    (w,) = tile.weights((80,), 16)
    assert np.abs(np.diff(w, 2)).max() < 0.03
    assert w[-9:].max() < 0.02


@pytest.mark.parametrize("counts", [(5, 1), (1, 3)])
def test_tiles_too_small_for_their_overlap(counts):
    with pytest.raises(InputError, match="less than twice the overlap of 8 px; use fewer"):
        cut((60, 40), counts, 8)


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_a_part_of_a_resized_image_needs_a_part_of_the_image(data):
    ndim = data.draw(st.integers(2, 3))
    old = tuple(data.draw(st.integers(20, 70)) for _ in range(ndim))
    new = tuple(data.draw(st.integers(8, 75)) for _ in range(ndim))
    window = []
    for n in new:
        first = data.draw(st.integers(0, n - 1))
        window.append(slice(first, data.draw(st.integers(first + 1, n))))
    window = tuple(window)
    I = np.random.default_rng(2).random(old)
    part = needed(old, new, window)
    image, field = (
        resize_part(np.ascontiguousarray(I[part]), part, old, new, window, odd)
        for odd in (False, True)
    )
    np.testing.assert_allclose(image, resize(I, new)[window], atol=2e-6)
    u = np.stack([I] * ndim)
    np.testing.assert_allclose(field, resize_field(u, new)[0][window], atol=2e-6)
