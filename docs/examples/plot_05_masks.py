"""
Dead zones
==========

A shadow, a bubble of air, the glass of the holder: parts of an image that do not move with the
sample. Marked as dead they carry no data, and the field is carried across them from around.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

truth = eofm.true_field(eofm.Sample(height=80, width=120, compression=3))
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=500, seed=2))

# %%
# Something that stands still in front of the sample: bright dirt on the window of the camera.
x1, x2 = np.meshgrid(np.arange(120), np.arange(80))
dirt = np.hypot(x1 - 45, x2 - 52) < 14
pattern = 0.25 * np.random.default_rng(0).random((80, 120))
before, after = (np.where(dirt, pattern, image) for image in (before, after))

# %%
# A mask is a picture that is not zero where dead. Take it a few pixels too large rather than too
# small.
dead = np.hypot(x1 - 45, x2 - 52) < 17
blind = eofm.estimate_displacement(before, after)
seeing = eofm.estimate_displacement(before, after, known=eofm.Known(dead=dead))

# %%
fig, axes = plt.subplots(2, 2, figsize=(7.5, 4.4), sharex=True, sharey=True)
axes[0, 0].imshow(before, cmap="gray")
axes[0, 0].contour(dead, [0.5], colors="tab:red")
axes[0, 0].set_title("before; the mask in red")
shown = axes[0, 1].imshow(seeing.trust.map, cmap="cividis", vmin=0, vmax=1)
axes[0, 1].set_title("how the images agree after the motion")
fig.colorbar(shown, ax=axes[0, 1], label="correlation", shrink=0.8)
for ax, found, name in ((axes[1, 0], blind, "without"), (axes[1, 1], seeing, "with")):
    error = np.hypot(*(found.u - truth))
    shown = ax.imshow(error, cmap="magma", vmin=0, vmax=1)
    outside = error[~dead].mean()
    ax.set_title(f"error {name} the mask: {outside:.3f} px outside of it")
    fig.colorbar(shown, ax=ax, label="px", shrink=0.8)
