"""
Strain in micrometres
=====================

Strain is the derivative of the displacement, and derivatives amplify noise. How wide a window to
take is a choice between noise and detail, and pixels that are not square have to be known.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

inclusion = eofm.Inclusion(x1=75, x2=45, radius=18, stiffness=5)
sample = eofm.Sample(height=80, width=120, compression=3, inclusions=(inclusion,))
truth = eofm.true_field(sample)
phantom = eofm.Phantom(count=900, noise=0.05, seed=7)
before, after, _ = eofm.make_phantom(truth, phantom)

# %%
# A scanner with pixels of 5 um to the side and 4 um in depth. The window is the standard deviation
# of the Gaussian weights of a line that is fitted around each pixel.
moved = np.array([[0.0], [-3.0]])
known = eofm.Known(edges={"top": np.zeros((2, 1)), "bottom": moved}, pixel_size=(5.0, 4.0))
windows = (4.0, 13.0, 40.0)
strains = {}
for window in windows:
    measures = eofm.Measures(strain_window=window, error_bars=0)
    results = eofm.analyse(before, after, known=known, measures=measures)
    strains[window] = results.strain

# %%
# ``strain[1]`` is the axial strain e22, negative where the sample is shortened. The inclusion, five
# times as stiff, is strained less. Strain has no unit; 0.01 is one percent.
fig, axes = plt.subplots(1, 3, figsize=(9.5, 2.4), sharex=True, sharey=True)
extent = (0, 120 * 5.0, 80 * 4.0, 0)
for ax, (window, strain) in zip(axes, strains.items(), strict=True):
    shown = ax.imshow(100 * strain[1], extent=extent, vmin=-8, vmax=0, cmap="magma")
    ax.set_title(f"e22, window {window:g} um")
    ax.set_xlabel("x1, um")
axes[0].set_ylabel("x2, um")
fig.colorbar(shown, ax=axes, label="%", shrink=0.8)

# %%
# Nearly incompressible samples keep their volume: e11 + e22 is near 0 in the plane, bar the layers
# at the clamped plates, though each of them is several percent.
middle = np.s_[25:55, 20:100]
lateral, axial = (strains[13.0][k][middle].mean() for k in (0, 1))
print(f"e11 {100 * lateral:.2f} %, e22 {100 * axial:.2f} %, sum {100 * (lateral + axial):.2f} %")
