import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eofm.errors import InputError
from eofm.flow.pyramid import pyramid, sampled


@given(st.integers(8, 300), st.integers(8, 300), st.integers(1, 6), st.floats(0.3, 0.9))
def test_grids_share_the_corners(height, width, scales, factor):
    try:
        grids = pyramid((height, width), scales, factor)
    except InputError as error:
        assert "too small" in str(error)  # noqa: PT017
        return
    assert len(grids) == scales
    assert grids[-1].shape == (height, width)
    assert grids[-1].spacing == (1, 1)
    for grid in grids:
        assert grid.lengths == pytest.approx([width - 1, height - 1])
    sizes = [np.prod(grid.shape) for grid in grids]
    assert sizes == sorted(set(sizes))


def test_too_small_an_image_says_how_many_scales_fit():
    with pytest.raises(InputError, match="9 x 40 px is too small for 4 scales; use at most 2"):
        pyramid((9, 40), 4, 0.5)
    assert len(pyramid((9, 40), 2, 0.5)) == 2


def test_images_keep_their_means_and_the_finest_is_the_image(rng):
    I = rng.normal(size=(33, 41))
    grids = pyramid(I.shape, 3, 0.5)
    J = sampled(I, grids)
    assert [j.shape for j in J] == [grid.shape for grid in grids]
    assert J[-1] is I
    x1, x2 = np.meshgrid(*grids[0].axes)
    plane = [sampled(c, grids)[0] for c in np.mgrid[:33, :41].astype(float)]
    np.testing.assert_allclose(plane[0][2:-2, 2:-2], x2[2:-2, 2:-2], atol=0.02)
    np.testing.assert_allclose(plane[1][2:-2, 2:-2], x1[2:-2, 2:-2], atol=0.02)


@pytest.mark.parametrize(("shape", "scales"), [((108, 180), 4), ((12, 400), 5), ((97, 97), 4)])
def test_open_scales_leave_twelve_pixels(shape, scales):
    grids = pyramid(shape, None, 0.5)
    assert len(grids) == scales
    assert min(grids[0].shape) >= 12
