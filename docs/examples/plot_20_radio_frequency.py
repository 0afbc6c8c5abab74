"""
Radio-frequency lines of ultrasound
===================================

A scanner can store what its transducer received: lines that oscillate with the carrier, of which
the B-scan shows the amplitude only. Give the lines: they tell axial motion several times better.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import hilbert

import eofm

# %%
# Scatterers, pressed by 3 %, with a lesion that is stiffer and echoes less. Each is drawn where it
# is, before and after, as an echo of a few periods of 5 px.
depth, width, random = 320, 72, np.random.default_rng(1)
scatterers = random.uniform([-8, -30], [width + 8, depth + 30], (25000, 2)).T
inside = ((scatterers[0] - 36) / 14) ** 2 + ((scatterers[1] - 150) / 45) ** 2 < 1
strengths = random.normal(size=inside.size) * np.where(inside, 0.4, 1.0)


def motion(x):
    lesion = np.exp(-(((x[0] - 36) / 14) ** 2) - ((x[1] - 150) / 45) ** 2)
    return np.stack([0.012 * (x[0] - 36), -0.03 * x[1] + 0.015 * lesion * (x[1] - 150)])


def received(x):
    image = np.zeros((depth + 100, width + 40))
    for step in np.ndindex(9, 27):
        k = np.round(x).astype(int) + np.reshape(step, (2, 1)) - [[4], [13]]
        d = k - x
        echo = np.cos(2 * np.pi * d[1] / 5) * np.exp(-((d[0] / 1.8) ** 2) - (d[1] / 5) ** 2)
        np.add.at(image, (k[1] + 50, k[0] + 20), strengths * echo)
    return (image + 0.05 * image.std() * random.normal(size=image.shape))[50:-50, 20:-20]


u = motion(np.stack(np.meshgrid(np.arange(width), np.arange(depth))).astype(float))
lines = [received(scatterers), received(scatterers + motion(scatterers))]
bscans = [np.log(np.abs(hilbert(I, axis=0)) + 0.05 * I.std()) for I in lines]

# %%
# The axial strain is what elastography shows.
fig, axes = plt.subplots(1, 4, figsize=(9, 5), layout="constrained", sharey=True)
axes[0].imshow(bscans[0], cmap="gray", aspect="auto")
axes[0].set(title="B-scan", ylabel="depth, px")
fields = {"truth": u} | {
    name: eofm.estimate_displacement(*images).u
    for name, images in {"from the lines": lines, "from B-scans": bscans}.items()
}
for ax, (name, field) in zip(axes[1:], fields.items(), strict=True):
    strain = 100 * np.gradient(field[1], axis=0)
    shown = ax.imshow(strain, cmap="viridis", vmin=-4, vmax=-1, aspect="auto")
    ax.set(title=name)
    if field is not u:
        ax.set_xlabel(f"axial error {np.abs(field - u)[1].mean():.3f} px")
fig.colorbar(shown, ax=axes, label="axial strain, %", shrink=0.7)
# After a motion of one period such images look nearly alike, and coarse scales show nothing of
# them: the motion of their amplitude is found first, and the finest scales start from it.
