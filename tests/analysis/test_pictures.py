import base64
import io

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from eofm.analysis.pictures import gradient, motion, palette, png


def shown(address):
    """The picture as colours with how opaque they are."""
    kind, _, data = address.partition(",")
    assert kind == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA"))


def test_values_have_the_colours_of_the_bar_and_none_is_see_through():
    values = np.array([[0.0, 1.0, 2.0, np.nan, 9.0]])
    address, size = png(values, (0.0, 2.0), "viridis", (4.0, 2.0))
    seen = shown(address)
    assert size == (20.0, 2.0)
    np.testing.assert_array_equal(seen[0, :3, :3], palette("viridis")[[0, 127, 254]])
    np.testing.assert_array_equal(seen[0, 4, :3], palette("viridis")[254])
    np.testing.assert_array_equal(seen[0, :, 3], [255, 255, 255, 0, 255])


def test_large_images_are_averaged_and_dead_pixels_count_for_nothing(rng):
    values = rng.uniform(0.4, 0.6, (100, 300))
    values[:50] = np.nan
    seen = shown(png(values, (0.0, 1.0), "gray", (1.0, 1.0), side=30)[0])
    assert seen.shape[:2] == (10, 30)
    assert (seen[:5, :, 3] == 0).all()
    assert (seen[5:, :, 3] == 255).all()
    assert np.ptp(seen[5:, :, 0].astype(int)) < 25


@pytest.mark.parametrize("shape", [(8, 4000), (4000, 8), (9, 10, 2000)])
def test_thin_images_have_a_picture(shape, rng):
    seen = shown(png(rng.normal(size=shape), (-1, 1), "gray", (1.0,) * len(shape))[0])
    assert max(seen.shape) <= 480


def test_the_share_has_three_colours_that_begin_where_the_bar_says():
    seen = shown(png(np.array([[0.05, 0.3, 0.8]]), (0, 1), "share", (1.0, 1.0))[0])
    assert len(np.unique(seen[0], axis=0)) == 3
    assert "10% 50%" in gradient("share")


def test_arrows_begin_at_bubbles_and_are_enlarged_to_be_seen():
    bubbles = pd.DataFrame({"x1": [10.0], "x2": [20.0], "u1": [0.5], "u2": [-1.0]})
    path, factor = motion(bubbles, (60, 100))
    assert factor == 10
    assert path.startswith("M10.5 20.5L15.5 10.5")
