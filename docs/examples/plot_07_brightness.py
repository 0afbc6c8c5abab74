"""
Brightness that changes
=======================

Optical flow assumes that a point keeps its brightness. Scanners do not: gain drifts, the focus
moves, a shadow falls below a structure. The preset follows such changes from place to place by
itself.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

truth = eofm.true_field(eofm.Sample(height=80, width=120, compression=3))
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=1500, seed=5))
rng = np.random.default_rng(0)
before, after = (image + rng.normal(0, 0.005, image.shape) for image in (before, after))

# %%
# Three second images: as it is; with a gain that falls along depth; with a gamma of 0.5.
x2 = np.arange(80)[:, None] / 79
seconds = {
    "nothing": after,
    "a ramp along depth": after * (1 - 0.6 * x2) + 0.1 * x2,
    "gamma 0.5": np.sqrt(np.maximum(after, 0)),
}

# %%
# ``robust=False`` switches all of that off: the fit of gain and offset, weights of residuals, and
# the search far away. ``local_window`` normalises both images beforehand instead, which is blunter.
settings = {
    "plain": eofm.Estimation(robust=False),
    "local window": eofm.Estimation(robust=False, local_window=8),
    "preset": eofm.Estimation(),
}
errors = np.array(
    [
        [
            np.hypot(*(eofm.estimate_displacement(before, second, how).u - truth)).mean()
            for how in settings.values()
        ]
        for second in seconds.values()
    ]
)

# %%
fig, axes = plt.subplots(2, 2, figsize=(7, 4.6))
for ax, (name, image) in zip(axes.flat, seconds.items(), strict=False):
    ax.imshow(image, cmap="gray")
    ax.set_title(f"after; change: {name}")
places = np.arange(3)
for k, name in enumerate(settings):
    axes[1, 1].bar(places + 0.27 * (k - 1), errors[:, k], 0.25, label=name)
axes[1, 1].set(xticks=places, xticklabels=["nothing", "ramp", "gamma"], yscale="log")
axes[1, 1].set_title("mean error, px")
axes[1, 1].yaxis.set_major_formatter("{x:g}")
axes[1, 1].yaxis.set_minor_formatter("")
axes[1, 1].legend(fontsize=7)
