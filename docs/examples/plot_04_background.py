"""
A homogeneous background
========================

How would the sample move if it had no inclusions? That follows from its shape, its Poisson ratio
and the motion of its edges alone, for a common factor of the stiffness changes nothing. The paper
takes this field for u_bg in eq. (Ansatz), and estimates only what the sample adds to it.
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

inclusion = eofm.Inclusion(x1=75, x2=50, radius=18, stiffness=5)
sample = eofm.Sample(height=80, width=120, compression=3, inclusions=(inclusion,))
truth, background = eofm.true_field(sample), eofm.background_field(sample)
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=120, seed=1))
bubbles = eofm.track(before, after, prediction=background)

# %%
# The paper's test 5 has background, bubbles, and v = 0 on top and bottom. Test 1 has bubbles only.
test5 = eofm.Estimation(method="paper", limits=(0, 1), zero_edges=("top", "bottom"))
test1 = test5.changed(zero_edges=())
preset = eofm.Estimation(limits=(0, 1), zero_edges=("top", "bottom"))
both = eofm.Known(bubbles=bubbles, background=background)
fields = {
    "the background itself": background,
    "test 1: bubbles": eofm.estimate_displacement(
        before, after, test1, eofm.Known(bubbles=bubbles)
    ).u,
    "test 5: bubbles, background": eofm.estimate_displacement(before, after, test5, both).u,
    "preset: the same": eofm.estimate_displacement(before, after, preset, both).u,
}

# %%
# The background knows the layers at the clamped plates, where a nearly incompressible sample cannot
# bulge. It does not know the inclusion; the images do.
fig, axes = plt.subplots(2, 4, figsize=(9, 3.4), sharex=True, sharey=True)
for column, (name, u) in enumerate(fields.items()):
    axes[0, column].imshow(u[0], vmin=-3, vmax=3, cmap="RdBu_r")
    axes[0, column].set_title(name)
    error = np.hypot(*(u - truth))
    shown = axes[1, column].imshow(error, cmap="magma", vmin=0, vmax=1)
    axes[1, column].set_title(f"{eofm.relative_errors(u, truth)['e_rel']:.1f} %")
axes[0, 0].set_ylabel("u1")
axes[1, 0].set_ylabel("error")
fig.colorbar(shown, ax=axes[1], label="px", shrink=0.8)
