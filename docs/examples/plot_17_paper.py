"""
The paper's five tests
======================

The table of the paper in one loop: with and without background, bubbles, and several scales. The
workflow does the same on the full phantom (``snakemake --cores 2``); here it is a smaller one.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

inclusion = eofm.Inclusion(x1=71, x2=50, radius=20, stiffness=7.5)
sample = eofm.Sample(
    height=72, width=120, compression=2.4, poisson_ratio=0.492, inclusions=(inclusion,)
)
truth, background = eofm.true_field(sample), eofm.background_field(sample)
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=100, seed=1))
bubbles = eofm.track(before, after, prediction=background)

# %%
# Alpha is 0.8 and sigma 5 px in all of them; beta is the weight of the bubbles.
paper = eofm.Estimation(method="paper", limits=(0, 1), zero_edges=("top", "bottom"))
tests = {
    "1: no background": (paper.changed(zero_edges=()), False),
    "2: no bubbles, one scale": (paper.changed(beta=0, scales=1), True),
    "3: no bubbles": (paper.changed(beta=0), True),
    "4: one scale": (paper.changed(scales=1), True),
    "5: all of it": (paper, True),
}
errors = {"the background": eofm.relative_errors(background, truth)}
for name, (settings, with_background) in tests.items():
    known = eofm.Known(bubbles=bubbles, background=background if with_background else None)
    u = eofm.estimate_displacement(before, after, settings, known).u
    errors[name] = eofm.relative_errors(u, truth)
preset = eofm.Estimation(limits=(0, 1), zero_edges=("top", "bottom"))
known = eofm.Known(bubbles=bubbles, background=background)
u = eofm.estimate_displacement(before, after, preset, known).u
errors["5b: preset"] = eofm.relative_errors(u, truth)

# %%
fig, ax = plt.subplots(figsize=(7, 3))
places = np.arange(len(errors))
for k, (key, label) in enumerate({"e_rel_u1": "u1", "e_rel": "u", "e_rel_u2": "u2"}.items()):
    ax.barh(places + 0.26 * (k - 1), [e[key] for e in errors.values()], 0.24, label=label)
ax.set(yticks=places, yticklabels=list(errors), xlabel="relative error, percent")
ax.invert_yaxis()
ax.legend()
