"""
Radio-frequency lines of ultrasound
===================================

An ultrasound scanner can store what its transducer received: lines that oscillate with the
carrier, of which the B-scan shows the amplitude only. Give the lines themselves. They tell axial
motion several times better, and the estimate takes care that no period is skipped.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import hilbert

import eofm

# %%
# A phantom of point scatterers, pressed by 3 % from below, with a lesion that is twice as stiff and
# echoes less. Each scatterer is drawn where it is, before and after, as an echo of a few periods:
# nothing is interpolated. 320 samples along 72 lines; real ones have some thousand.
depth, lines, period = 320, 72, 5.0
random = np.random.default_rng(1)
scatterers = random.uniform([-8, -30], [lines + 8, depth + 30], (25000, 2)).T


def motion(x):
    lesion = np.exp(-(((x[0] - 36) / 14) ** 2) - ((x[1] - 150) / 45) ** 2)
    return np.stack([0.012 * (x[0] - 36), -0.03 * x[1] + 0.015 * lesion * (x[1] - 150)])


inside = ((scatterers[0] - 36) / 14) ** 2 + ((scatterers[1] - 150) / 45) ** 2 < 1
strengths = random.normal(size=scatterers.shape[1]) * np.where(inside, 0.4, 1.0)


def received(x):
    image = np.zeros((depth + 100, lines + 40))
    first = np.round(x).astype(int)
    for across in range(-4, 5):
        for along in range(-13, 14):
            k = first + np.array([[across], [along]])
            d = k - x
            wave = np.cos(2 * np.pi * d[1] / period)
            echo = strengths * wave * np.exp(-((d[0] / 1.8) ** 2) - (d[1] / 5.0) ** 2)
            np.add.at(image, (k[1] + 50, k[0] + 20), echo)
    return image[50:-50, 20:-20]


x = np.stack(np.meshgrid(np.arange(lines), np.arange(depth))).astype(float)
# Where the material at x was moved to: I2(x + u) = I1(x).
before, after, u = received(scatterers), received(scatterers + motion(scatterers)), motion(x)
before, after = (
    I + 0.05 * I.std() * np.random.default_rng(k).normal(size=I.shape)
    for k, I in enumerate((before, after))
)

# %%
# The B-scan is the logarithm of the lines' envelope.
bscans = [np.log(np.abs(hilbert(I, axis=0)) + 0.05 * I.std()) for I in (before, after)]
by_lines = eofm.estimate_displacement(before, after)
by_bscans = eofm.estimate_displacement(*bscans)
for name, found in {"lines": by_lines, "B-scans": by_bscans}.items():
    lateral, axial = np.abs(found.u - u).mean(axis=(1, 2))
    print(f"{name}: axial error {axial:.4f} px, lateral {lateral:.4f} px; {found.trust.verdict}")

# %%
# The axial strain, what elastography shows. The lesion strains half as much.
fig, axes = plt.subplots(1, 4, figsize=(9, 5), layout="constrained")
axes[0].imshow(bscans[0], cmap="gray", aspect="auto")
axes[0].set_title("B-scan")
fields = {"truth": u, "from lines": by_lines.u, "from B-scans": by_bscans.u}
for ax, (name, field) in zip(axes[1:], fields.items(), strict=True):
    strain = 100 * np.gradient(field[1], axis=0)
    shown = ax.imshow(strain, cmap="viridis", vmin=-4, vmax=-1, aspect="auto")
    ax.set_title(name)
for ax in axes:
    ax.set_xlabel("line")
axes[0].set_ylabel("depth, samples")
fig.colorbar(shown, ax=axes, label="axial strain, %", shrink=0.7)

# %%
# What the carrier costs: an image that oscillates looks nearly the same after a motion of one
# period, here 5 px, and on coarse scales it is grey. Where both images have such a carrier, the
# motion of their amplitude is estimated first, and the finest scales of the lines start from it as
# well; what leaves less of the lines is kept. In a table of samples the sides of a pixel are the
# pitch of the lines, and axially half of the sound's speed over the sampling rate.
