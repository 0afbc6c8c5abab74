"""Figure 4: the true displacement."""

from pathlib import Path

from eofm import io
from eofm.analysis.figures import field, save
from eofm.settings import Figures

settings = Figures(**snakemake.params.figures)
truth = io.read_field(Path(snakemake.input.truth))
save(field(truth, settings), [Path(snakemake.output.png), Path(snakemake.output.pdf)], settings)
