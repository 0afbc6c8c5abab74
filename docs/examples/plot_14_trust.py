"""
When not to trust an estimate
=============================

A minimiser always returns something. Three ways in which images say nothing of a motion, and how
that shows: each estimate carries a verdict, ``found.trust``, with its reasons and a map.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

shape = 96, 128
truth = eofm.background_field(eofm.Sample(height=96, width=128, compression=3))


def speckle(u, seed=1):
    """Images before and after a motion."""
    return eofm.make_phantom(u, eofm.Phantom(count=3000, seed=seed, noise=0.1))[:2]


# %%
# *Decorrelation*: the speckle after has little in common with that before. *Too large*: everything
# moves by more than half of the image. *No structure*: a hole without signal, and noise everywhere.
good = speckle(truth)
other = speckle(truth, seed=2)[1]
decorrelated = good[0], 0.35 * good[1] + 0.65 * other
far = speckle(truth + np.array([70.0, 0.0]).reshape(2, 1, 1))
hole = np.arange(128) > 50
rng = np.random.default_rng(1)
empty = tuple(np.where(hole, rng.normal(0.5, 0.2, shape), image) for image in good)

# %%
cases = {
    "as it should be": good,
    "decorrelated": decorrelated,
    "too large": far,
    "no structure": empty,
}
fig, axes = plt.subplots(3, 4, figsize=(10, 5.2), sharex=True, sharey=True)
for column, (name, pair) in enumerate(cases.items()):
    found = eofm.estimate_displacement(*pair)
    axes[0, column].imshow(pair[0], cmap="gray")
    axes[0, column].set_title(f"{name}: {found.trust.verdict}")
    motion = axes[1, column].imshow(found.u[1], vmin=-3.2, vmax=0)
    shown = axes[2, column].imshow(found.trust.map, cmap="cividis", vmin=0, vmax=1)
    print(f"{name}: {found.trust.verdict}")
    for reason in found.trust.reasons:
        print(f"    {reason}")
for ax, name in zip(axes[:, 0], ("before", "u2", "trust"), strict=True):
    ax.set_ylabel(name)
fig.colorbar(motion, ax=axes[1], label="px", shrink=0.8)
fig.colorbar(shown, ax=axes[2], label="correlation", shrink=0.8)

# %%
# The map is the correlation of small windows after the motion. The command prints the reasons, and
# ends with status 3 where an estimate has failed, so that a script can stop there.
