"""The virtual OCT experiment: table of errors, and Figures 1, 2 and 8 of the paper."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.patches import Circle
from scipy.ndimage import gaussian_filter1d

from eofm import io
from eofm.analysis.figures import compare_errors, compare_fields, image_pair, save
from eofm.analysis.metrics import pixel_errors
from eofm.grid import Array
from eofm.settings import Figures

# Depth in px over which derivatives at an edge are taken, and radius of circles by the height.
DEPTH, RADIUS = 5, 0.06


def natural_places(standard: Array, eofm: Array) -> list[tuple[float, float]]:
    """Where on its edges one component of standard flow obeys natural conditions most wrongly.

    Its level lines meet an edge at right angles, for the derivative across the edge is about
    zero; the place is where EOFM's derivative differs most from it. Edges along which they differ
    by less than half as much as on the worst one are left out.

    Returns
    -------
    list of (float, float)
        Places x1, x2 in px, at most one for each edge.
    """
    height, width = standard.shape
    places = []
    for axis, last in ((0, height - 1), (1, width - 1)):
        for edge, inner in ((0, DEPTH), (last, last - DEPTH)):
            across = [np.take(u, edge, axis) - np.take(u, inner, axis) for u in (standard, eofm)]
            wrong = gaussian_filter1d(np.abs(across[1]) - np.abs(across[0]), RADIUS * height)
            along = int(wrong.argmax())
            places.append((wrong.max(), (along, edge) if axis == 0 else (edge, along)))
    worst = max(size for size, _ in places)
    return [place for size, place in places if size >= worst / 2]


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
# As in the paper, red circles show what natural conditions do to standard flow.
for i, axis in enumerate(figures["figure2"].axes[::2]):
    for place in natural_places(fields["standard"][i], fields["eofm"][i]):
        centre = np.multiply(place, settings.pixel_size)
        radius = RADIUS * truth.shape[1] * settings.pixel_size[1]
        axis.add_patch(Circle(centre, radius, fill=False, color="red", clip_on=False))
for name, figure in figures.items():
    png = Path(snakemake.output[name])
    save(figure, [png, png.with_suffix(".pdf")], settings)
