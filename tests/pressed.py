"""A pressed sample with a stiff disc, and images of it."""

from functools import cache

import numpy as np

from eofm.elasticity.forward import true_field
from eofm.settings import Forward, Inclusion, Phantom, Sample
from eofm.simulation.phantom import make_phantom

PLAIN = Sample(height=48, width=76, poisson_ratio=0.492, compression=2.0)
PRESSED = {"top": np.zeros((2, 1)), "bottom": np.array([[0.0], [-2.0]])}
DISC = Inclusion(x1=32, x2=27, radius=11, stiffness=5)
DENSE = Phantom(count=1500, sigma=(1.3, 1.3), noise=0.02, seed=5)


@cache
def pair(stiff=True, seed=DENSE.seed):
    sample = PLAIN.changed(inclusions=(DISC,) if stiff else ())
    u = true_field(sample, Forward(true_cell=2.0))
    return *make_phantom(u, DENSE.changed(seed=seed))[:2], u
