import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eofm.analysis.boundary import parse_edge
from eofm.errors import InputError

SHAPE, PIXEL = (40, 60), (4.0, 2.0)


@pytest.mark.parametrize(
    ("text", "outside", "motion"),
    [
        ("free", False, None),
        ("fixed", False, [0, 0]),
        ("moved 1.5 -6", False, [1.5, -6]),
        ("moved 1.5 -6 px", False, [1.5, -6]),
        ("moved 8 -6 um", False, [2, -3]),
        ("moved free -6 um", False, [np.nan, -3]),
        ("moved 8 free um", False, [2, np.nan]),
        ("outside moved free 0", True, [np.nan, 0]),
        ("outside", True, None),
        ("outside fixed", True, [0, 0]),
        ("outside moved 0 -6", True, [0, -6]),
    ],
)
def test_words(text, outside, motion):
    state = parse_edge("bottom", text, SHAPE, PIXEL)
    assert state.outside == outside
    if motion is None:
        assert state.motion is None
    else:
        np.testing.assert_allclose(state.motion[:, 0], motion)


def test_a_profile_has_a_row_per_pixel(tmp_path):
    profile = pd.DataFrame({"u1": np.zeros(60), "u2": np.linspace(-3, -2, 60)})
    profile.to_csv(tmp_path / "bottom.csv", index=False)
    text = f"moved {tmp_path / 'bottom.csv'}"
    np.testing.assert_allclose(parse_edge("bottom", text, SHAPE, PIXEL).motion, profile.T)
    with pytest.raises(InputError, match="60 rows but the edge has 40 pixels"):
        parse_edge("left", text, SHAPE, PIXEL)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fixd", "bottom: cannot read 'fixd'; use free, fixed"),
        ("", "bottom: cannot read ''"),
        ("fixed 3", "cannot read 'fixed 3'"),
        ("moved", "cannot read 'moved"),
        ("moved 1 x", "bottom: cannot read 'moved 1 x'; say moved U1 U2 .um., a number for each"),
        ("moved 0 -3 mm", "cannot read 'moved 0 -3 mm'"),
        ("moved 1 2 3", "cannot read 'moved 1 2 3'; .* direction of an image, or free"),
        ("moved -3", "cannot read 'moved -3'"),
        ("moved free", "cannot read 'moved free'"),
        ("moved 0 inf", "cannot read"),
        ("moved 0 nan", "cannot read"),
        ("moved free free", "cannot read"),
        ("fixed free", "cannot read"),
        ("moved nowhere.csv", "nowhere.csv"),
        ("moved 0 -40", "moves by 40 px but the image is only 40 px"),
        ("moved 60 0", "moves by 60 px but the image is only 60 px"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(text, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_edge("bottom", text, SHAPE, PIXEL)
    assert "\n" not in str(caught.value)


@given(st.text(max_size=20))
def test_any_text_is_an_edge_or_one_line(text):
    try:
        parse_edge("top", text, SHAPE, PIXEL)
    except InputError as error:
        assert "top" in str(error) or ":" in str(error)  # noqa: PT017


VOLUME, VOXEL = (30, 40, 60), (4.0, 2.0, 8.0)


def test_faces_of_a_volume_move_in_three_directions(tmp_path):
    moved = parse_edge("back", "moved 8 -6 16 um", VOLUME, VOXEL).motion
    assert moved.shape == (3, 1, 1)
    np.testing.assert_allclose(moved[:, 0, 0], [2, -3, 2])
    assert parse_edge("front", "fixed", VOLUME, VOXEL).motion.shape == (3, 1, 1)
    with pytest.raises(InputError, match="front: cannot read 'moved 1 2'"):
        parse_edge("front", "moved 1 2", VOLUME, VOXEL)
    with pytest.raises(InputError, match="moves by 30 px but the image is only 30 px"):
        parse_edge("front", "moved 0 0 30", VOLUME, VOXEL)
    with pytest.raises(InputError, match="a table of motions is of an image's edge"):
        parse_edge("front", f"moved {tmp_path / 'front.csv'}", VOLUME, VOXEL)
    slides = parse_edge("bottom", "moved free -2 free", VOLUME, VOXEL).motion
    np.testing.assert_allclose(slides[:, 0, 0], [np.nan, -2, np.nan])
    with pytest.raises(InputError, match=r"moved free -2'; say moved U1 U2 U3 .* of a volume"):
        parse_edge("bottom", "moved free -2", VOLUME, VOXEL)
