"""
From files to results
=====================

What the command ``eofm sample`` does, in Python: read what files and words describe, analyse it,
and write fields, tables and figures to a folder.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import tifffile

import eofm

folder = Path(tempfile.mkdtemp())
sample = eofm.Sample(height=80, width=120, compression=3)
truth = eofm.true_field(sample)
for name, image in zip(("before", "after"), eofm.make_phantom(truth), strict=False):
    eofm.io.write_image(folder / f"{name}.tif", image)

# %%
# The keys are those of a row of ``samples.tsv`` and of the options of ``eofm sample``. The bottom
# moved up by 15 um, which are 3 px of 5 um; x2 points down, hence the sign.
pair = eofm.Pair(
    reference=folder / "before.tif",
    deformed=folder / "after.tif",
    lateral_size=5,
    axial_size=5,
    top="fixed",
    bottom="moved 0 -15 um",
    background="elastic",
)
scene = eofm.read_scene(pair)
results = eofm.analyse(*scene.frames, known=scene.known, sample=scene.sample, measures=pair)
for key in ("u2_range_um", "axial_strain_mean", "forward_backward_error_median_px"):
    print(f"{key}: {results.summary[key]}")

# %%
# All files appear together, or none does.
(folder / "mine").mkdir()
results.write(folder / "mine", pair.files, kinds=())
for path in sorted((folder / "mine").iterdir()):
    print(f"{path.name:28} {path.stat().st_size:8} bytes")

# %%
# Fields are float TIFFs with a page for each component, which Fiji and any TIFF reader open.
u1, u2 = tifffile.imread(folder / "mine/displacement_um.tif")
fig, ax = plt.subplots(figsize=(5.5, 3))
shown = ax.imshow(u2, extent=(0, 600, 400, 0))
ax.set(title="u2, um", xlabel="x1, um", ylabel="x2, um")
fig.colorbar(shown, shrink=0.8)
