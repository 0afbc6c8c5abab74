"""Figure 3: the sample before and after compression."""

from pathlib import Path

from eofm import io
from eofm.analysis.figures import image_pair, save
from eofm.settings import Figures

settings = Figures(**snakemake.params.figures)
pair = io.read_pair(Path(snakemake.input.reference), Path(snakemake.input.deformed))
save(
    image_pair(*pair, settings), [Path(snakemake.output.png), Path(snakemake.output.pdf)], settings
)
