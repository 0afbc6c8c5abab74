"""The virtual OCT experiment: table of errors, and Figures 1, 2 and 8 of the paper."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle

from eofm import io
from eofm.analysis.figures import compare_errors, compare_fields, image_pair, save
from eofm.analysis.metrics import pixel_errors
from eofm.analysis.panels import scale
from eofm.grid import Array
from eofm.settings import Figures

# Length in px over which derivatives at an edge are taken, and radius of circles by the height.
LENGTH, RADIUS = 5, 0.05
# Sine of the angle between a level line and the normal of an edge: below, and above.
UPRIGHT, SLANTED = 0.35, 0.5


def slant(u: Array, axis: int, edge: int, along: int) -> float:
    """Sine of the angle between a component's level line and the normal of an edge, at a pixel.

    The edge is the first (0) or last (-1) one along ``axis``; the pixel is number ``along`` of it.
    """
    lines = np.moveaxis(u, axis, 0)[:: 1 if edge == 0 else -1]
    low, high = max(along - LENGTH, 0), min(along + LENGTH, lines.shape[1] - 1)
    across = (lines[LENGTH, low : high + 1] - lines[0, low : high + 1]).mean() / LENGTH
    tangential = (lines[:LENGTH, high] - lines[:LENGTH, low]).mean() / (high - low)
    return float(abs(across) / max(np.hypot(across, tangential), 1e-12))


def natural_places(axis: Axes, standard: Array, eofm: Array) -> list[Array]:
    """Where drawn level lines of standard flow meet an edge upright, and EOFM's do not.

    Returns
    -------
    list of ndarray, shape (2,)
        Places x1, x2 in px, no two of which are nearer than a circle is wide.
    """
    places: list[Array] = []
    last = np.array(standard.shape[::-1]) - 1
    lines = [c for c in axis.collections if isinstance(c, LineCollection)]
    ends = [line[i] for c in lines for line in c.get_segments() for i in (0, -1)]
    for end in ends:
        x = np.rint(end / scale(settings, 2)).astype(int)
        for i in (0, 1):
            if min(x[i], last[i] - x[i]) > 1:
                continue
            edge = 0 if x[i] <= 1 else -1
            angles = [slant(u, 1 - i, edge, x[1 - i]) for u in (standard, eofm)]
            near = [np.hypot(*(x - place)) < 2 * RADIUS * standard.shape[0] for place in places]
            if angles[0] < UPRIGHT and angles[1] > SLANTED and not any(near):
                places.append(x)
    return places


settings = Figures(**snakemake.params.figures)
files = {name: Path(path) for name, path in snakemake.input.items() if isinstance(path, str)}
truth = io.read_field(files["truth"])
fields = {name: io.read_field(files[name]) for name in ("background", "standard", "eofm")}

rows = [{"method": name} | pixel_errors(u, truth) for name, u in fields.items()]
io.write_table(Path(snakemake.output.errors), pd.DataFrame(rows))

shown = {"standard optical flow": fields["standard"], "EOFM": fields["eofm"]}
images = io.read_pair(files["reference"], files["deformed"])
figures = {
    "figure1": image_pair(*images, settings, io.read_bubbles(files["bubbles"])),
    "figure2": compare_fields(shown, settings),
    "figure8": compare_errors(shown, truth, settings),
}
# As in the paper, red circles show what natural boundary conditions do to standard flow.
# Panels stand first among the axes, row by row, and each row begins with standard flow.
for i, axis in enumerate(figures["figure2"].axes[: len(truth) * len(shown) : len(shown)]):
    for x in natural_places(axis, fields["standard"][i], fields["eofm"][i]):
        side = scale(settings, 2)
        radius = RADIUS * truth.shape[1] * side[1]
        circle = Circle(x * side, radius, fill=False, color="red", clip_on=False)
        axis.add_artist(circle)
for name, figure in figures.items():
    png = Path(snakemake.output[name])
    save(figure, [png, png.with_suffix(".pdf")], settings)
