"""
What is known of the edges
==========================

The plate below the sample was moved by a known amount, and the glass above it stood still. Saying
so costs one line and is worth most where images say least: at the edges, and between sparse
bubbles.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

inclusion = eofm.Inclusion(x1=75, x2=50, radius=18, stiffness=5)
sample = eofm.Sample(height=80, width=120, compression=3, inclusions=(inclusion,))
truth = eofm.true_field(sample)
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=250, seed=1))

# %%
# An edge is a column (u1, u2) for each of its pixels, or one column for all of them. Here the top
# is fixed and the bottom moved up by 3 px. Edges that are not named are free: there, the estimate
# has natural boundary conditions, eq. (bdc_natural) of the paper. A component that is not known is
# ``np.nan``: ``[[np.nan], [-3.0]]`` is a plate along which the sample slides.
fixed, moved = np.zeros((2, 1)), np.array([[0.0], [-3.0]])
known = {
    "nothing": eofm.Known(),
    "top and bottom": eofm.Known(edges={"top": fixed, "bottom": moved}),
    "a wrong bottom": eofm.Known(edges={"top": fixed, "bottom": 2 * moved}),
}

# %%
# A motion that is stated wrongly, here twice too large, is imposed all the same, and the field next
# to it suffers. The verdict turns doubtful.
fig, axes = plt.subplots(2, 3, figsize=(9, 4), sharex=True, sharey=True)
for column, (name, what) in enumerate(known.items()):
    found = eofm.estimate_displacement(before, after, known=what)
    error = eofm.relative_errors(found.u, truth)["e_rel"]
    print(f"{name}: {error:.1f} %, {found.trust.verdict} {' '.join(found.trust.reasons)}")
    motion = axes[0, column].imshow(found.u[1], vmin=-3.2, vmax=0)
    axes[0, column].set_title(f"u2, knowing {name}")
    difference = np.hypot(*(found.u - truth))
    shown = axes[1, column].imshow(difference, cmap="magma", vmin=0, vmax=0.5)
    axes[1, column].set_title(f"error, {error:.1f} % in all")
fig.colorbar(motion, ax=axes[0], label="px", shrink=0.8)
fig.colorbar(shown, ax=axes[1], label="px", shrink=0.8)
