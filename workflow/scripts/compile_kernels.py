"""Compile what estimates of images and of volumes need, so that no first run has to wait for it."""

import numpy as np

import eofm

for shape in ((64, 64), (24, 24, 24)):
    before, after, _ = eofm.make_phantom(np.zeros((len(shape), *shape)), eofm.Phantom(count=40))
    for method in ("preset", "paper"):
        eofm.estimate_displacement(before, after, eofm.Estimation(method=method, scales=2))
