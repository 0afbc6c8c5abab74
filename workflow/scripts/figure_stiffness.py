"""True and identified modulus with the true outline, and the error bar of its logarithm."""

from pathlib import Path

import numpy as np

from eofm import io
from eofm.analysis.figures import moduli, save
from eofm.elasticity.forward import lame
from eofm.settings import Figures, Sample

settings = Figures(**snakemake.params.figures)
sample = Sample(**snakemake.params.sample)
x = np.mgrid[: sample.height, : sample.width][::-1].astype(float)
mu = lame(sample, x)[1]
plain = lame(sample.changed(inclusions=()), x)[1]
E = io.read_image(Path(snakemake.input.stiffness))
deviation = io.read_image(Path(snakemake.input.deviation))
truth = mu / plain
figure = moduli({"true": truth, "identified": E}, deviation, settings, outline=truth)
save(figure, [Path(snakemake.output.png), Path(snakemake.output.pdf)], settings)
