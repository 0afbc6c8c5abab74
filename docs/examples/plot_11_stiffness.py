"""
Stiffness
=========

How stiff is the inclusion? Images tell motion, motion tells strain, and where a sample is stiff
it is strained less. :func:`eofm.identify_stiffness` looks for the moduli whose elastic motion
fits the images best. Only ratios can be found: twice the stiffness everywhere gives the same
motion.
"""

import matplotlib.pyplot as plt

import eofm

inclusion = eofm.Inclusion(x1=75, x2=42, radius=18, stiffness=5)
sample = eofm.Sample(height=80, width=120, compression=3, inclusions=(inclusion,))
truth = eofm.true_field(sample)
before, after, _ = eofm.make_phantom(truth, eofm.Phantom(count=600, seed=8))

# %%
# It is told the size of the sample, its Poisson ratio, and how it is pressed; nothing of an
# inclusion.
asked = eofm.Sample(height=80, width=120, compression=3)
bubbles = eofm.track(before, after, prediction=eofm.background_field(asked))
found = eofm.identify_stiffness(before, after, asked, known=eofm.Known(bubbles=bubbles))
print(found.summary())

# %%
# The displacement that goes with it is more accurate than the preset's, since it obeys elasticity.
preset = eofm.estimate_displacement(before, after, known=eofm.Known(bubbles=bubbles))
for name, u in (("preset", preset.u), ("identified", found.estimate.u)):
    print(f"{name}: {eofm.relative_errors(u, truth)['e_rel']:.2f} %")

# %%
# Error bars of log E: 0.1 is about ten percent. They are widest inside of what is stiff, where a
# little strain more or less makes a large difference.
u_deviation, log_deviation = eofm.deviations(found, samples=8)
fig, axes = plt.subplots(1, 3, figsize=(9.5, 2.4), sharex=True, sharey=True)
axes[0].imshow(before, cmap="gray")
axes[0].set_title("before")
shown = axes[1].imshow(found.E, vmin=0.5, vmax=6)
fig.colorbar(shown, ax=axes[1], shrink=0.8)
axes[1].set_title("E over the background's; true: 5")
shown = axes[2].imshow(log_deviation, cmap="cividis", vmin=0, vmax=0.4)
fig.colorbar(shown, ax=axes[2], shrink=0.8)
axes[2].set_title("deviation of log E")
for ax in axes:
    ax.add_patch(plt.Circle((75, 42), 18, fill=False, color="tab:red", lw=1))
print(f"in the middle of the inclusion E = {found.E[42, 75]:.2f} of 5")
