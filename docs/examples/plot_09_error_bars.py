"""
Error bars and what they mean
=============================

Every estimate has a standard deviation at each pixel. Two of three true values should lie within
one deviation, and nineteen of twenty within 1.96. Do they?
"""

import matplotlib.pyplot as plt
import numpy as np

import eofm

inclusion = eofm.Inclusion(x1=75, x2=50, radius=18, stiffness=5)
sample = eofm.Sample(height=80, width=120, compression=3, inclusions=(inclusion,))
truth = eofm.true_field(sample)

# %%
# A sample half of which shows little: bubbles are faint on the right. The deviation knows.
x1 = np.arange(120)
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=500, seed=6))
rng = np.random.default_rng(6)
fade = 1 - 0.9 * x1 / 119
before, after = (image * fade + rng.normal(0, 0.01, image.shape) for image in (before, after))
found = eofm.estimate_displacement(before, after)
deviation = found.deviation(samples=32)
error = abs(found.u - truth)

# %%
# The bars are the spread of fields that agree with the images as well as this one does: noise is
# drawn from the residuals, with one sign for each block of 8 px, and carried through the estimate.
fig, axes = plt.subplots(1, 3, figsize=(9.5, 2.5), width_ratios=[1, 1, 1.1])
axes[0].imshow(before, cmap="gray")
axes[0].set_title("before")
shown = axes[1].imshow(deviation[1], cmap="cividis", vmin=0, vmax=0.2)
axes[1].set_title("deviation of u2, px")
fig.colorbar(shown, ax=axes[1], shrink=0.8)
row = 40
axes[2].fill_between(
    x1, *(found.u[1, row] + k * deviation[1, row] for k in (-1.96, 1.96)), alpha=0.3, label="95 %"
)
axes[2].plot(x1, found.u[1, row], label="estimate")
axes[2].plot(x1, truth[1, row], "k--", lw=1, label="truth")
axes[2].set_title("u2 along the row 40, px")
axes[2].legend(fontsize=7)

# %%
# Count. Where the field fails to bend as sharply as the truth, at the outline of the inclusion,
# bars are too short: they tell what noise does, and only in part what smoothing does.
for k, wanted in ((1, 0.68), (1.96, 0.95)):
    print(f"within {k} deviations: {(error <= k * deviation).mean():.2f}, wanted {wanted}")
