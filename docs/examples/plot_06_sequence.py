"""
A sequence of frames
====================

A sample pressed in small steps. Each step moves little and keeps its speckle, so it is easy to
follow; :func:`eofm.analyse` estimates step by step and adds the steps up along the way of each
point.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

inclusion = eofm.Inclusion(x1=55, x2=40, radius=14, stiffness=4)
steps = (0, 1.5, 3, 4.5)
fields = [
    eofm.true_field(eofm.Sample(height=70, width=100, compression=c, inclusions=(inclusion,)))
    for c in steps
]
# The same bubbles in all frames: one seed, and motions from the first frame on.
phantom = eofm.Phantom(count=400, seed=4)
frames = [eofm.make_phantom(u, phantom)[1] for u in fields]

# %%
# The stated motion of edges is that of one step. Sides of a pixel are in micrometres.
moved = np.array([[0.0], [-1.5]])
known = eofm.Known(edges={"top": np.zeros((2, 1)), "bottom": moved}, pixel_size=(5.0, 5.0))
results = eofm.analyse(*frames, known=known, measures=eofm.Measures(error_bars=4))
print(f"steps: {results.summary['steps']}, bubbles in each: {results.summary['bubbles']}")
for number, step in enumerate(results.steps, 1):
    print(f"step {number}: {step.trust.verdict}, u2 from {step.estimate.u[1].min():.2f} px")

# %%
# The total, from the first frame to the last, lives on the first frame. Compare it with one single
# estimate across the whole motion.
at_once = eofm.estimate_displacement(frames[0], frames[-1])
fig, axes = plt.subplots(1, 3, figsize=(9, 2.4), sharex=True, sharey=True)
shown = axes[0].imshow(results.u[1])
axes[0].set_title("u2 in all, px")
fig.colorbar(shown, ax=axes[0], shrink=0.8)
for ax, u, name in ((axes[1], results.u, "steps"), (axes[2], at_once.u, "at once")):
    error = np.hypot(*(u - fields[-1]))
    shown = ax.imshow(error, cmap="magma", vmin=0, vmax=0.3)
    ax.set_title(f"error, {name}: mean {error.mean():.3f} px")
fig.colorbar(shown, ax=axes[2], label="px", shrink=0.8)

# %%
# Here bubbles keep their look, so one estimate across all of it does as well. Where speckle
# decorrelates with strain, small steps are the only way; the price is that the errors of the steps
# add up.
