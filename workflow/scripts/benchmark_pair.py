"""A square pair of images with a known smooth motion of 6 px, for the benchmark."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eofm import io
from eofm.settings import Phantom
from eofm.simulation.phantom import make_phantom

# Bubbles per px: dense speckle with noise, or about as many as in the paper.
DENSE = {"sigma": (1.2, 1.8), "brightness": (0.3, 1.0), "noise": 0.05}
DENSITY = {"dense": 0.08, "sparse": 0.01}


def motion(size: int) -> NDArray[np.float64]:
    """A compression by 6 px that bulges, with waves of a third of the image, px."""
    x2, x1 = np.mgrid[:size, :size] / (size - 1)
    wave = 0.05 * np.sin(6 * np.pi * x2) * np.cos(np.pi * x1)
    return 6 * np.stack([0.5 * (x1 - 0.5) * np.sin(np.pi * x2), wave - x2])


size, image = int(snakemake.wildcards.size), snakemake.wildcards.image
settings = Phantom(**snakemake.params.phantom)
changes = {"count": round(DENSITY[image] * size**2), "seed": snakemake.params.seed}
u = motion(size)
I1, I2, _ = make_phantom(u, settings.changed(**(changes | (DENSE if image == "dense" else {}))))
io.write_image(Path(snakemake.output.reference), I1)
io.write_image(Path(snakemake.output.deformed), I2)
io.write_field(Path(snakemake.output.truth), u)
