"""
A pair of images
================

Two images of a soft sample, before and after it was pressed from below by 3 px. Where did each of
its points go? Nothing is told to :func:`eofm.estimate_displacement` but the two images.
"""

import matplotlib.pyplot as plt

import eofm

# %%
# A sample whose motion is known: a block with a stiff inclusion, clamped on top. Its images show
# bright bubbles on black, which move with the material.
inclusion = eofm.Inclusion(x1=75, x2=50, radius=18, stiffness=5)
sample = eofm.Sample(height=80, width=120, compression=3, inclusions=(inclusion,))
truth = eofm.true_field(sample)
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=400, seed=1))

# %%
# The estimate. ``found.u[0]`` is the lateral motion u1 (to the right), ``found.u[1]`` the axial
# motion u2 (down), in pixels: what was at x before is at x + u(x) after. Up is negative, so u2 is
# negative here: the bottom was moved up.
found = eofm.estimate_displacement(before, after)
errors = eofm.relative_errors(found.u, truth)
print(f"relative error {errors['e_rel']:.1f} %, verdict: {found.trust.verdict}")

# %%
fig, axes = plt.subplots(2, 3, figsize=(9, 3.8), sharex=True, sharey=True)
for ax, image, title in zip(axes[:, 0], (before, after), ("before", "after"), strict=True):
    ax.imshow(image, cmap="gray")
    ax.set_title(title)
for row, name in enumerate(("u1, to the right", "u2, down")):
    shown = axes[row, 1].imshow(found.u[row], cmap="viridis")
    axes[row, 1].set_title(f"{name}, px")
    fig.colorbar(shown, ax=axes[row, 1], shrink=0.8)
    shown = axes[row, 2].imshow(abs(found.u - truth)[row], cmap="magma", vmin=0, vmax=0.3)
    axes[row, 2].set_title(f"error of u{row + 1}, px")
    fig.colorbar(shown, ax=axes[row, 2], shrink=0.8)

# %%
# The error is largest at the edges, of which the images say least: a point near an edge has data on
# one side only. :ref:`sphx_glr_gallery_plot_02_edges.py` shows what helps.
