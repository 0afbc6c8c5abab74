"""
Strain that is not small
========================

Small strain is a straight line through something curved. Turn a sample and it sees strain where
there is none; press it hard and it tells too much or too little, depending on what one asks.
Three other measures have names, and one key chooses among them.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

# %%
# A sample that is shortened by 8 % in depth, and then turned by 6 degrees about its middle. Both
# are the same everywhere, so the truth is one number for each measure.
angle, shape = np.radians(6), (90, 120)
stretch = np.diag([1.04, 0.92])
turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
F = turn @ stretch
x2, x1 = np.mgrid[: shape[0], : shape[1]].astype(float)
x = np.stack([x1 - 60, x2 - 45])
u = np.einsum("ij,jkl->ikl", F - np.eye(2), x)
before, after, _ = eofm.make_phantom(u, eofm.Phantom(count=2000, seed=1))

# %%
measures = ("small", "green-lagrange", "almansi", "hencky")
found, known = {}, eofm.Known(pixel_size=(5.0, 5.0))
for name in measures:
    asked = eofm.Measures(strain_measure=name, error_bars=0)
    strain = eofm.analyse(before, after, known=known, measures=asked).strain
    found[name] = strain[:, 20:70, 30:90].mean(axis=(1, 2))

# %%
# What they should be. Green-Lagrange and Hencky do not see the rotation at all: they are those of
# the stretch alone. Almansi strain turns with the sample.
inverse = np.linalg.inv(F)
truth = {
    "small": (F + F.T) / 2 - np.eye(2),
    "green-lagrange": (F.T @ F - np.eye(2)) / 2,
    "almansi": (np.eye(2) - inverse.T @ inverse) / 2,
    "hencky": np.diag(np.log(np.diag(stretch))),
}
fig, axes = plt.subplots(1, 3, figsize=(8, 3), sharey=True)
for k, (ax, title) in enumerate(zip(axes, ("e11", "e22", "e12"), strict=True)):
    i, j = ((0, 0), (1, 1), (0, 1))[k]
    ax.barh(measures, [100 * found[name][k] for name in measures])
    ax.plot([100 * truth[name][i, j] for name in measures], range(4), "k|", ms=18)
    ax.set(title=f"{title}, % (black: the truth)")
axes[0].invert_yaxis()
