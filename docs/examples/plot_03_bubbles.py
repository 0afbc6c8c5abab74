"""
Following bubbles
=================

Large speckle formations, which the paper calls *bubbles*, can be followed one by one. Their
motions are sparse but hardly biased, and they enter the estimate as the term S of eq. (def_S_u).
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

sample = eofm.Sample(height=80, width=120, compression=3)
truth = eofm.true_field(sample)
phantom = eofm.Phantom(count=90, distance=6, sigma=(1.2, 2.0), seed=3)
before, after, made = eofm.make_phantom(truth, phantom)

# %%
# The tracker finds peaks above a threshold, matches them one to one by place, size and brightness,
# and registers the image in a small window around each. ``quality`` is the correlation of the two
# windows; bubbles below 0.8, and those that disagree with their neighbours, are dropped.
bubbles = eofm.track(before, after, eofm.Tracking(gate=4))
print(bubbles.head().round(2).to_string(index=False))

# %%
# How good are they? Compare each with the true field at its place.
at = tuple(bubbles[["x2", "x1"]].to_numpy().T.round().astype(int))
error = np.hypot(*(bubbles[["u1", "u2"]].to_numpy().T - truth[:, *at]))
print(f"{len(bubbles)} of {len(made)} followed, median error {np.median(error):.3f} px")

# %%
fig, ax = plt.subplots(figsize=(7, 4.2))
ax.imshow(before, cmap="gray")
# u2 points down, as the axis of the picture does, so arrows need no change of sign.
arrows = ax.quiver(
    *bubbles[["x1", "x2", "u1", "u2"]].to_numpy().T,
    error,
    angles="xy",
    scale_units="xy",
    scale=0.25,
    width=0.003,
    cmap="autumn_r",
)
fig.colorbar(arrows, label="error, px", shrink=0.7)
ax.set_title("bubbles and four times their motion")

# %%
# In the preset bubbles guide the coarse scales only; the finest one believes the images. With
# ``method="paper"`` they count on all scales, with the weight ``beta``.
for method in ("preset", "paper"):
    settings = eofm.Estimation(method=method)
    for known in (eofm.Known(), eofm.Known(bubbles=bubbles)):
        u = eofm.estimate_displacement(before, after, settings, known).u
        word = "without" if known.bubbles is None else "with"
        print(f"{method}, {word} bubbles: {eofm.relative_errors(u, truth)['e_rel']:.1f} %")
