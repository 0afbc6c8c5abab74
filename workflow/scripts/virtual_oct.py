"""The virtual OCT experiment: table of errors, and Figures 1, 2 and 8 of the paper."""

from pathlib import Path

import pandas as pd

from eofm import io
from eofm.analysis.figures import compare_errors, compare_fields, image_pair, save
from eofm.analysis.metrics import pixel_errors
from eofm.settings import Figures

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
for name, figure in figures.items():
    png = Path(snakemake.output[name])
    save(figure, [png, png.with_suffix(".pdf")], settings)
