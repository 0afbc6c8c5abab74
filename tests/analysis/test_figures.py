import numpy as np
import pytest
from matplotlib.image import imread

import eofm
from eofm.analysis import figures


@pytest.fixture
def draw(truth, pair):
    """Functions that draw each kind of figure."""
    return {
        "pair": lambda: figures.image_pair(pair[0], pair[1]),
        "field": lambda: figures.field(truth),
        "errors": lambda: figures.field_and_error(1.1 * truth, truth, 0.5),
        "bubbles": lambda: figures.image_pair(pair[0], pair[1], eofm.Figures(), pair[2]),
        "fields": lambda: figures.compare_fields({"A": truth, "B": 2 * truth}),
        "two errors": lambda: figures.compare_errors({"A": truth, "B": 2 * truth}, truth),
    }


@pytest.mark.parametrize("kind", ["pair", "field", "errors", "bubbles", "fields", "two errors"])
def test_figures_are_written_as_png_and_pdf_with_the_same_bytes(draw, tmp_path, kind):
    quick = eofm.Figures(dpi=60)
    for name in ("a", "b"):
        figures.save(draw[kind](), [tmp_path / f"{name}.png", tmp_path / f"{name}.pdf"], quick)
    assert imread(tmp_path / "a.png").std() > 0.05
    for end in ("png", "pdf"):
        assert (tmp_path / f"a.{end}").read_bytes() == (tmp_path / f"b.{end}").read_bytes()


def test_units_and_shared_scales(draw, truth):
    drawn = draw["errors"]()
    panels = [axis for axis in drawn.axes if axis.images]
    assert [axis.images[0].get_clim() for axis in panels[1::2]] == [(0, 0.5)] * 2
    largest = abs(truth[0]).max()
    assert panels[0].images[0].get_clim() == (-largest, largest)
    assert panels[0].get_ylabel() == "axial position [µm]"
    assert panels[2].get_xlabel() == "lateral position [µm]"


@pytest.mark.parametrize("kind", ["fields", "two errors"])
def test_methods_share_one_scale_in_a_row(draw, kind):
    shown = [axis.images[0].get_clim() for axis in draw[kind]().axes if axis.images]
    assert shown[0] == shown[1]
    assert shown[2] == shown[3]


def test_positions_follow_the_pixel_size():
    figure = figures.field(np.zeros((2, 11, 21)), eofm.Figures(pixel_size=(2.0, 3.0)))
    assert list(figure.axes[0].images[0].get_extent()) == [-1, 41, 31.5, -1.5]


def test_a_field_without_motion_can_be_drawn(tmp_path):
    figures.save(figures.field(np.zeros((2, 11, 21))), [tmp_path / "u.png"])
