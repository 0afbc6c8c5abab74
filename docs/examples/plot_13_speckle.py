"""
Sparse bubbles and dense speckle
================================

The same motion, seen in three kinds of images: a few bright bubbles on black; speckle that fills
the image; and the log-compressed tomogram of a virtual OCT scanner, whose speckle is
interference.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

inclusion = eofm.Inclusion(x1=60, x2=40, radius=14, stiffness=4)
sample = eofm.Sample(height=70, width=100, compression=2, inclusions=(inclusion,))
truth, background = eofm.true_field(sample), eofm.background_field(sample)

# %%
# In speckle a pixel shows the sum of many scatterers. Where the sample strains, those inside of one
# resolution cell change their phases against each other, and the pattern changes: it decorrelates.
# In the tomograms this comes with the physics, for echoes are added with their phases.
sparse = *eofm.make_phantom(truth, eofm.Phantom(count=90, seed=1))[:2], truth
dense = *eofm.make_phantom(truth, eofm.Phantom(count=4000, seed=1))[:2], truth
scanner = eofm.VirtualOct(scale=1.5, reflectors=600, display=(-10, 30), seed=1)
oct_images = eofm.make_tomograms(truth, background, scanner)[:3]

# %%
fig, axes = plt.subplots(2, 3, figsize=(9, 4.2))
kinds = {"90 bubbles": sparse, "4000 bubbles": dense, "virtual OCT": oct_images}
for column, (name, (I1, I2, u)) in enumerate(kinds.items()):
    found = eofm.estimate_displacement(I1, I2)
    error = np.hypot(*(found.u - u))
    axes[0, column].imshow(I1, cmap="gray")
    axes[0, column].set_title(name)
    shown = axes[1, column].imshow(error, cmap="magma", vmin=0, vmax=0.5)
    axes[1, column].set_title(f"error, mean {error.mean():.3f} px; {found.trust.verdict}")
    relative = eofm.relative_errors(found.u, u)["e_rel"]
    agree = found.trust.correlation
    print(f"{name}: {relative:.1f} %; after the motion the images correlate by {agree:.2f}")
fig.colorbar(shown, ax=axes[1], label="px", shrink=0.8)

# %%
# Between sparse bubbles nothing is seen, and smoothness fills the gaps: error bars are long there.
# Dense speckle tells the motion everywhere. In tomograms the speckle's own change is the noise.
