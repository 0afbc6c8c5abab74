"""
A volume
========

A sample that is pressed bulges out of the plane of a picture as well. With volumes before and
after, all three components of the motion are seen, by the same functions: two or three dimensions
follow from the arrays.
"""

import matplotlib.pyplot as plt

import eofm

# %%
# A box of 24 slices with a stiff sphere. The axes of a volume are (elevational, axial, lateral),
# components of u are in the other order: u1 lateral, u2 axial, u3 elevational, from slice to slice.
sphere = eofm.Inclusion(x1=20, x2=16, x3=12, radius=7, stiffness=5)
sample = eofm.Sample(depth=24, height=28, width=40, compression=1.2, inclusions=(sphere,))
truth = eofm.true_field(sample, eofm.Forward(true_cell=3))
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=1500, seed=1))
print(f"volumes of shape {before.shape}, {before.dtype}")

# %%
found = eofm.estimate_displacement(before, after)
errors = eofm.relative_errors(found.u, truth)
print(f"u has shape {found.u.shape}; relative error {errors['e_rel']:.1f} %")
print(f"verdict: {found.trust.verdict}")

# %%
# The middle slice of the sphere, and the elevational motion that no picture of it would show.
fig, axes = plt.subplots(2, 3, figsize=(8, 3.8), sharex=True, sharey=True)
for column, name in enumerate(("u1, lateral", "u2, axial", "u3, elevational")):
    limit = abs(truth[column]).max()
    for row, u in enumerate((found.u, truth)):
        shown = axes[row, column].imshow(u[column, 6], cmap="RdBu_r", vmin=-limit, vmax=limit)
    axes[0, column].set_title(f"{name}, px")
    fig.colorbar(shown, ax=axes[:, column], shrink=0.7)
axes[0, 0].set_ylabel("estimate")
axes[1, 0].set_ylabel("truth")
