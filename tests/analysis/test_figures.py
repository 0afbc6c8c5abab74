import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.quiver import Quiver

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


@pytest.mark.parametrize(("unit", "side", "name"), [("um", 5.0, "µm"), ("px", 1.0, "px")])
def test_one_unit_and_shared_scales(truth, unit, side, name):
    """Positions, displacements and errors are all in um, or all in px."""
    drawn = figures.field_and_error(1.1 * truth, truth, 0.5, eofm.Figures(unit=unit))
    panels = [axis for axis in drawn.axes if axis.get_title("left")]
    limits = [axis.images[0].get_clim() for axis in panels]
    assert limits[1::2] == [(0, pytest.approx(0.5 * side))] * 2
    assert limits[0][1] == -limits[0][0] == pytest.approx(side * abs(truth[0]).max())
    assert panels[0].get_ylabel() == f"axial position [{name}]"
    assert panels[2].get_xlabel() == f"lateral position [{name}]"
    assert all(f"[{name}]" in axis.get_title("left") for axis in panels)
    assert f"≤ {0.1 * side * abs(truth[0]).max():.2f} [{name}]" in panels[1].get_title("left")
    left, right, *_ = panels[0].images[0].get_extent()
    assert right - left == pytest.approx(side * truth.shape[2])


@pytest.mark.parametrize("shape", [(61, 90), (40, 200), (200, 40), (14, 20, 30)])
def test_no_text_is_cut_off(shape, rng):
    u = rng.normal(size=(len(shape), *shape)).cumsum(-1)
    settings = eofm.Figures(pixel_size=(3.9, 6.0))
    maps = {"residual $I_2(x + u) - I_1$": u[0], "forward-backward error, first step": abs(u[0])}
    maps |= {"correlation after the motion: doubtful": u[0], "what decides the estimate": u[0]}
    for figure in (
        figures.compare_fields({"standard flow": u, "EOFM": u}, settings, abs(u)),
        figures.strains(rng.normal(size=(3 * (len(shape) - 1), *shape)), settings, "hencky"),
        figures.quality(maps, settings),
        figures.image_pair(u[0], u[0], settings),
    ):
        figure.canvas.draw()
        for axis in figure.axes:
            box = axis.get_tightbbox()
            assert box.x0 >= 0
            assert box.y0 >= 0
            assert box.x1 <= figure.bbox.width
            assert box.y1 <= figure.bbox.height


def test_labels_of_level_lines_stay_apart_and_off_the_border(truth):
    figure = figures.field(truth)
    figure.canvas.draw()
    for axis in (axis for axis in figure.axes if axis.texts):
        boxes = [text.get_window_extent() for text in axis.texts]
        assert len(boxes) > 2
        for k, box in enumerate(boxes):
            assert axis.bbox.x0 < box.x0 < box.x1 < axis.bbox.x1
            assert not any(box.overlaps(other) for other in boxes[k + 1 :])


def test_noise_makes_no_level_lines(rng):
    """A flat field with noise would scribble over the whole picture."""
    figure = figures.field(rng.normal(0, 0.01, (2, 60, 90)))
    lines = [c for axis in figure.axes for c in axis.collections for _ in c.get_segments()]
    assert len(lines) < 10


def test_arrows_can_be_seen_and_stand_on_the_image_before_only(pair):
    figure = figures.image_pair(pair[0], pair[1], eofm.Figures(), pair[2])
    before, after = (axis for axis in figure.axes if axis.get_title("left"))
    (arrows,) = (c for c in before.collections if isinstance(c, Quiver))
    longest = np.hypot(arrows.U, arrows.V).max() / arrows.scale
    assert 0.03 * 5 * 90 < longest < 0.13 * 5 * 90
    assert not after.collections


@pytest.mark.parametrize("kind", ["fields", "two errors"])
def test_methods_share_one_scale_in_a_row(draw, kind):
    shown = [axis.images[0].get_clim() for axis in draw[kind]().axes if axis.get_title("left")]
    assert shown[0] == shown[1]
    assert shown[2] == shown[3]


def test_positions_follow_the_pixel_size():
    figure = figures.field(np.zeros((2, 11, 21)), eofm.Figures(pixel_size=(2.0, 3.0)))
    assert list(figure.axes[0].images[0].get_extent()) == [-1, 41, 31.5, -1.5]


def test_a_field_without_motion_can_be_drawn(tmp_path):
    figures.save(figures.field(np.zeros((2, 11, 21))), [tmp_path / "u.png"])
