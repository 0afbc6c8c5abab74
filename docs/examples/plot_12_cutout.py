"""
Stiffness of a part of a sample
===============================

A real image seldom shows the whole sample. Where its edges lie inside, nobody knows how they
moved; their motion is then sought together with the stiffness. What can be found is the modulus
relative to the median of what is seen.
"""

import matplotlib.pyplot as plt

import eofm

inclusion = eofm.Inclusion(x1=75, x2=55, radius=16, stiffness=5)
sample = eofm.Sample(height=110, width=150, compression=4, inclusions=(inclusion,))
whole = eofm.true_field(sample)

# %%
# The image: a window in the middle of the sample, away from all of its edges.
window = 20, 25, 110, 70
rows, columns = slice(20, 90), slice(25, 135)
truth = whole[:, rows, columns]
images = eofm.make_phantom(whole, eofm.Phantom(count=1400, seed=9))[:2]
before, after = (image[rows, columns] for image in images)

# %%
# ``outside`` names the edges beyond which the sample goes on.
known = eofm.Known(outside=("top", "bottom", "left", "right"))
asked = eofm.Sample(height=70, width=110, compression=0)
found = eofm.identify_stiffness(before, after, asked, known=known)
print(found.summary())
print(f"displacement off by {eofm.relative_errors(found.estimate.u, truth)['e_rel']:.2f} %")

# %%
fig, axes = plt.subplots(1, 2, figsize=(7.5, 2.7))
axes[0].imshow(images[0], cmap="gray")
axes[0].add_patch(plt.Rectangle((25, 20), 110, 70, fill=False, color="tab:red"))
axes[0].set_title("the sample, and what the image shows")
shown = axes[1].imshow(found.E, vmin=0.5, vmax=6)
axes[1].add_patch(plt.Circle((50, 35), 16, fill=False, color="tab:red"))
axes[1].set_title("E over the median's; true: 5")
fig.colorbar(shown, ax=axes[1])
print(f"in the middle of the inclusion E = {found.E[35, 50]:.2f} of 5")
